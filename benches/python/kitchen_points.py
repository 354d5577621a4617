"""How many of the points placed by hand on photos of the kitchen have a right label (tests/data/kitchen_points.json).

  python3 benches/python/kitchen_points.py FRAMES SCENE.ply LABELS.npy CLASSES.json

FRAMES: the folder of the kitchen (frame-N.depth.png, frame-N.pose.txt, camera-intrinsics.txt). Needs numpy and Pillow.
"""

import json
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image

POINTS = Path(__file__).resolve().parents[2] / "tests" / "data" / "kitchen_points.json"
# Gaussians that are asked, and meters within which they are.
NEIGHBORS, REACH = 5, 0.1
TYPES = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4"}


def places(path):
    """The means of a binary PLY. [N, 3]"""
    with open(path, "rb") as file:
        properties, count, element = [], 0, None
        while (line := file.readline().decode().split()) != ["end_header"]:
            if line[0] == "element":
                element = line[1]
                count = int(line[2]) if element == "vertex" else count
            elif line[0] == "property" and element == "vertex":
                properties.append((line[-1], TYPES[line[1]]))
        kind = np.dtype(properties)
        rows = np.frombuffer(file.read(count * kind.itemsize), kind)
    return np.stack([rows[axis] for axis in "xyz"], 1).astype(float)


def in_world(frames, point):
    """Where a pixel is, by the median of the depths around it; None without any."""
    lens = np.loadtxt(frames / "camera-intrinsics.txt")
    pose = np.loadtxt(frames / f"{point['frame']}.pose.txt")
    depth = np.asarray(Image.open(frames / f"{point['frame']}.depth.png")).astype(float)
    depth[depth == 65535] = 0
    x, y = point["x"], point["y"]
    for reach in (2, 4, 8, 16):
        near = depth[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
        if near.any():
            camera = np.linalg.inv(lens) @ [x, y, 1] * np.median(near[near > 0]) / 1000
            return (pose @ [*camera, 1])[:3]
    return None


def main(frames, scene, labels, classes):
    coord, labels = places(scene), np.load(labels)
    names = json.load(open(classes))
    points = json.load(open(POINTS))["points"]
    right, found, without = Counter(), {}, 0
    for point in points:
        place = in_world(Path(frames), point)
        if place is None:
            without += 1
            continue
        distance = ((coord - place) ** 2).sum(1)
        near = [i for i in np.argsort(distance)[:NEIGHBORS] if distance[i] < REACH**2]
        named = Counter(names[labels[i]] if labels[i] >= 0 else "unknown" for i in near)
        label = named.most_common(1)[0][0] if named else "nothing near"
        first = point["classes"][0]
        right[first] += label in point["classes"]
        found.setdefault(first, Counter())[label] += 1
    print(f"{sum(right.values())} of {len(points)} right, {without} without depth")
    for first, labels in found.items():
        print(f"  {first}: {right[first]} of {sum(labels.values())}, {dict(labels)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
