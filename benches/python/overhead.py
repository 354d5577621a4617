"""What `segment` takes from Python more than the same stages of the program: on one scene, in turns.

    python benches/python/overhead.py SCENE [RUNS]
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import scenesplat


def main():
    scene, runs = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 5
    opened, network = scenesplat.Scene.open(scene), scenesplat.Network.load()
    scenesplat.segment(opened, network)
    ours, theirs = [], []
    # What the program does besides: reading, weights, files, pictures, checksums.
    besides = ("read", "weights", "write", "picture", "fingerprint", "other")
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(runs):
            began = time.perf_counter()
            scenesplat.segment(opened, network)
            ours.append(time.perf_counter() - began)
            words = [sys.executable, "-m", "scenesplat", "segment", scene, "--out", folder, "--quiet"]
            subprocess.run(words, check=True, capture_output=True)
            stages = json.loads((Path(folder) / "receipt.json").read_text())["stages"]
            theirs.append(sum(s["seconds"] for s in stages if "/" not in s["name"] and s["name"] not in besides))
    a, b = median(ours), median(theirs)
    print(f"{len(opened)} Gaussians: from Python {a:.3f} s, stages of the program {b:.3f} s: {100 * (a / b - 1):+.1f} %")


if __name__ == "__main__":
    main()
