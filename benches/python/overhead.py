"""What `segment` takes from Python more than the same work of the program: on one scene, in turns.

    python benches/python/overhead.py SCENE [RUNS]
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import scenesplat


def main():
    scene, runs = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 5
    opened, network = scenesplat.Scene.open(scene), scenesplat.Network.load()
    scenesplat.segment(opened, network)
    ours, theirs = [], []
    # What the program does besides: reading, weights, files, pictures, checksums.
    besides = ("read", "weights", "write", "picture")
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(runs):
            began = time.perf_counter()
            scenesplat.segment(opened, network)
            ours.append(time.perf_counter() - began)
            words = [sys.executable, "-m", "scenesplat", "segment", scene, "--out", folder, "--quiet"]
            subprocess.run(words, check=True, capture_output=True)
            receipt = json.loads((Path(folder) / "receipt.json").read_text())
            spent = sum(s["seconds"] for s in receipt["stages"] if s["name"] in besides)
            theirs.append(receipt["wall_seconds"] - spent)
    # The best of each: other programs of the machine only ever add.
    a, b = min(ours), min(theirs)
    print(f"{len(opened)} Gaussians: from Python {a:.3f} s, the program without files and pictures {b:.3f} s: {100 * (a / b - 1):+.1f} %")


if __name__ == "__main__":
    main()
