"""The measurements of `device.sh run`: checks, networks, training, profile, PyTorch. Standard library and numpy."""

import argparse
import collections
import contextlib
import csv
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
CELL = 0.02
TRAINING = """
task = "semantic_segmentation"
[model]
grid_size = 0.02
num_classes = 41
[[train]]
source = {{ type = "synthetic", count = 2, seed = 1, room = {{ num_gaussians = {rows} }} }}
transforms = [{{ type = "center_shift" }}, {{ type = "grid_sample", grid_size = 0.02 }}]
repeat = {steps}
[loader]
workers = 4
batch_size = 1
mix_probability = 0.0
[[losses]]
type = "cross_entropy"
[[losses]]
type = "lovasz_softmax"
[trainer]
epochs = 1
"""


def room(count, seed):
    """`count` points on floor, ceiling, walls and boxes, 8 mm of noise: about one for each voxel of 2 cm."""
    rng = np.random.default_rng(seed)
    side = (count * CELL**2 / 4.6) ** 0.5 + 1.0
    rectangles = [((0, 0, 0), (side, 0, 0), (0, side, 0)), ((0, 0, 2.6), (side, 0, 0), (0, side, 0))]
    for x in (0.0, side):
        rectangles += [((x, 0, 0), (0, side, 0), (0, 0, 2.6)), ((0, x, 0), (side, 0, 0), (0, 0, 2.6))]
    for _ in range(int(side * side / 4)):
        x, y = rng.uniform(0, side - 1, 2)
        w, d, h = rng.uniform(0.3, 1.0, 3)
        rectangles += [((x, y, h), (w, 0, 0), (0, d, 0)), ((x, y, 0), (w, 0, 0), (0, 0, h)), ((x, y, 0), (0, d, 0), (0, 0, h))]
    origin, u, v = (np.array([r[i] for r in rectangles], dtype=np.float64) for i in range(3))
    area = np.linalg.norm(np.cross(u, v), axis=1)
    face = rng.choice(len(area), size=count, p=area / area.sum())
    a, b = rng.uniform(size=(2, count, 1))
    return (origin[face] + a * u[face] + b * v[face] + rng.normal(scale=0.008, size=(count, 3))).astype(np.float32)


def write_ply(path, points, seed):
    rng = np.random.default_rng(seed)
    n = len(points)
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.zeros((n, len(names)), dtype="<f4")
    table[:, 0:3] = points
    table[:, 5] = 1.0
    table[:, 6:9] = rng.uniform(-1, 1, (n, 3))
    table[:, 9] = rng.uniform(1, 4, n)
    table[:, 10:13] = rng.uniform(-5, -4, (n, 3))
    quat = rng.normal(size=(n, 4))
    table[:, 13:17] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    head = "ply\nformat binary_little_endian 1.0\nelement vertex %d\n" % n
    head += "".join("property float %s\n" % name for name in names) + "end_header\n"
    path.write_bytes(head.encode() + table.tobytes())


def write_voxels(start, points, seed):
    """The same room as `baseline.py --input` reads it."""
    grid = np.unique(np.floor((points - points.min(0)) / CELL).astype(np.int32), axis=0)
    np.save(f"{start}_grid_i32.npy", grid)
    np.save(f"{start}_feat11_f32.npy", np.random.default_rng(seed).uniform(-1, 1, (len(grid), 11)).astype(np.float32))


class Bench:
    def __init__(self, args):
        self.args, self.began, self.results = args, time.monotonic(), {}
        self.on_gpu = args.device != "cpu"
        self.out, self.work = args.out, args.work
        self.work.mkdir(parents=True, exist_ok=True)

    def left(self):
        return self.args.minutes * 60 - (time.monotonic() - self.began)

    def run(self, name, command, limit, env=None):
        """Runs a step; its output goes to a file of its name. Returns the output, or None if it failed."""
        limit = min(limit, self.left())
        if limit < 5:
            self.results[name] = {"not_run": "no time left"}
            return None
        start = time.monotonic()
        log = self.work / f"{name}.log"
        with open(log, "w") as file:
            try:
                code = subprocess.run(
                    [str(c) for c in command], stdout=file, stderr=subprocess.STDOUT, timeout=limit, env={**os.environ, **(env or {})}
                ).returncode
            except subprocess.TimeoutExpired:
                code = f"stopped after {limit:.0f} s"
        text = log.read_text(errors="replace")
        entry = {"seconds": round(time.monotonic() - start, 2), "exit": code}
        if code != 0:
            entry["end"] = text[-1500:]
        self.results[name] = entry
        print(f"{time.monotonic() - self.began:6.1f} s  {name}: {entry['seconds']} s, exit {code}", flush=True)
        self.save()
        return text if code == 0 else None

    def save(self):
        (self.out / "device.json").write_text(json.dumps(self.results, indent=1))

    # ---- Steps ----

    def card(self):
        if self.on_gpu:
            text = self.run("card", ["nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"], 30)
            self.results["card"]["name"] = (text or "").strip()
        self.results["cpu"] = {"cores": os.cpu_count()}

    def checks(self):
        for name, filters in [("kernels", []), ("networks", ["device"]), ("wgsl", [])]:
            program = self.args.built / name
            if not program.exists():
                self.results[name] = {"not_run": "no such program"}
                continue
            env = {"SCENESPLAT_TEST_DEVICE": self.args.device} if self.on_gpu else {}
            if self.args.shared:
                env["SCENESPLAT_SHARED"] = str(self.args.shared)
            text = self.run(name, [program, *filters, "--test-threads", "4", "--show-output"], 150, env)
            if text is None:
                text = (self.work / f"{name}.log").read_text(errors="replace")
            found = re.findall(r"test result: \w+\. (\d+) passed; (\d+) failed", text)
            self.results[name]["passed"] = sum(int(p) for p, _ in found)
            self.results[name]["failed"] = sum(int(f) for _, f in found)
            self.results[name]["skipped_lines"] = len(re.findall(r"^skipped", text, re.M))

    def features(self, name, scene, extra, device, limit):
        receipt = self.work / f"{name}.json"
        command = [self.args.built / "scenesplat", "features", scene, "--dtype", "f16", "--out", self.work / name, "--device", device]
        command += ["--receipt", receipt, "--quiet", *extra]
        with self.device_memory(name):
            done = self.run(name, command, limit)
        if done is None or not receipt.exists():
            return
        report = json.loads(receipt.read_text())
        self.results[name]["stages"] = {s["name"]: round(s["seconds"], 3) for s in report["stages"]}
        self.results[name]["rows"] = report["rows_in"]
        self.results[name]["host_peak_bytes"] = report["peak_memory_bytes"]
        self.results[name]["warnings"] = report["warnings"][:5]

    @contextlib.contextmanager
    def device_memory(self, name):
        """Adds the most memory of the device that was used meanwhile, asked for ten times a second."""
        if not self.on_gpu:
            yield
            return
        ask = ["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits", "-lms", "100"]
        with open(self.work / "memory.log", "w+") as log, subprocess.Popen(ask, stdout=log, stderr=subprocess.DEVNULL) as probe:
            try:
                yield
            finally:
                probe.terminate()
                log.seek(0)
                used = [int(line) for line in log.read().split() if line.isdigit()]
                self.results[name]["device_peak_mib"] = max(used, default=None)

    def networks(self):
        big = [100_000, 1_000_000, 1_500_000] if self.on_gpu else [20_000]
        for rows in big:
            scene = self.work / f"room_{rows}.ply"
            write_ply(scene, room(rows, rows), rows)
        language = ["--config", "language", "--weights", "seeded:1"]
        litept = ["--config", "litept-s", "--weights", "seeded:1"]
        first = self.work / f"room_{big[0]}.ply"
        # Compiles the kernels and fills their cache: not a measurement.
        self.features("first_start", first, language, self.args.device, 120)
        for rows in big:
            scene = self.work / f"room_{rows}.ply"
            self.features(f"language_{rows}", scene, language, self.args.device, 120)
            self.features(f"litept_{rows}", scene, litept, self.args.device, 60)
        self.features(f"language_bf16_{big[0]}", first, [*language, "--precision", "bf16"], self.args.device, 60)
        self.features(f"language_cpu_{big[0]}", first, language, "cpu", 120)
        self.compare(f"language_{big[0]}", f"language_cpu_{big[0]}")
        self.compare(f"language_bf16_{big[0]}", f"language_cpu_{big[0]}")
        self.any_maker(big, language, litept)

    def any_maker(self, big, language, litept):
        """The kernels in WGSL on the best graphics processor that Vulkan lists; software where there is no driver for it."""
        for rows in big[:2]:
            scene = self.work / f"room_{rows}.ply"
            self.features(f"wgsl_litept_{rows}", scene, litept, "gpu", 60)
            self.features(f"wgsl_language_{rows}", scene, language, "gpu", 60)
            self.features(f"wgsl_language_f16_{rows}", scene, [*language, "--precision", "f16"], "gpu", 60)
        for name in (f"wgsl_language_{big[0]}", f"wgsl_language_f16_{big[0]}"):
            self.compare(name, f"language_cpu_{big[0]}")

    def compare(self, one, other):
        paths = [self.work / name / "features.npy" for name in (one, other)]
        if not all(p.exists() for p in paths):
            return
        a, b = (np.load(p, mmap_mode="r")[::7].astype(np.float64) for p in paths)
        norm = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        cosine = (a * b).sum(1) / np.maximum(norm, 1e-30)
        self.results[one][f"cosine_with_{other}"] = {"least": float(cosine.min()), "median": float(np.median(cosine))}

    def training(self):
        rows, steps = (50_000, 10) if self.on_gpu else (4_000, 1)
        for device in dict.fromkeys([self.args.device, "cpu"]):
            name = "train_" + device.split(":")[0]
            folder = self.work / name
            file = self.work / f"{name}.toml"
            file.write_text(TRAINING.format(rows=rows, steps=steps if device != "cpu" else 2))
            command = [self.args.built / "scenesplat", "train", file, "--out", folder, "--device", device]
            text = self.run(name, command, 150 if device != "cpu" else 80)
            metrics = folder / "metrics.jsonl"
            if metrics.exists():
                lines = [json.loads(line) for line in metrics.read_text().splitlines()]
                self.results[name]["metrics"] = lines[-6:]
            if text:
                self.results[name]["end"] = text[-900:]

    def profile(self):
        """Time of each kernel in one pass, as Nsight Compute counts it."""
        scene = self.work / "room_100000.ply"
        if not self.on_gpu or not scene.exists():
            return
        command = ["ncu", "--metrics", "gpu__time_duration.sum", "--csv", "--page", "raw", "--clock-control", "none", "--log-file", self.work / "ncu.csv"]
        command += [self.args.built / "scenesplat", "features", scene, "--dtype", "f16", "--out", self.work / "profiled", "--device", self.args.device]
        self.run("profile", [*command, "--quiet", "--config", "language", "--weights", "seeded:1"], 120)
        path = self.work / "ncu.csv"
        if not path.exists():
            return
        lines = [line for line in path.read_text(errors="replace").splitlines() if line.startswith('"')]
        sums, counts = collections.Counter(), collections.Counter()
        rows = csv.DictReader(lines)
        for row in rows:
            value = row.get("gpu__time_duration.sum", "").replace(",", "")
            if re.fullmatch(r"[\d.]+", value):
                kernel = re.sub(r"[<(].*", "", row["Kernel Name"])
                sums[kernel] += float(value)
                counts[kernel] += 1
        unit = next((r.get("gpu__time_duration.sum", "") for r in csv.DictReader(lines)), "")
        table = [{"kernel": k, "launches": counts[k], "time": round(v, 1)} for k, v in sums.most_common(25)]
        self.results["profile"].update(unit=unit, launches=sum(counts.values()), time=round(sum(sums.values()), 1), kernels=table)
        self.save()

    def pytorch(self):
        sizes = [100_000, 1_000_000] if self.on_gpu else [5_000]
        for rows in sizes:
            start = self.work / f"voxels_{rows}"
            write_voxels(start, room(rows, rows), rows)
            for kind in ["f32", "bf16"] if self.on_gpu else ["f32"]:
                command = [sys.executable, HERE / "pytorch/baseline.py", "--config", "language", "--input", start]
                name = f"pytorch_{kind}_{rows}"
                text = self.run(name, [*command, "--device", self.args.device, "--precision", kind, "--runs", "3"], 90)
                if text:
                    self.results[name]["lines"] = text.strip().splitlines()[-4:]

    def table(self):
        print("\n| step | seconds | network | MiB | what |\n|---|---|---|---|---|")
        for name, entry in self.results.items():
            stages = entry.get("stages", {})
            what = entry.get("lines") or entry.get("not_run") or (f"{entry['passed']} passed, {entry['failed']} failed" if "passed" in entry else "")
            for key in entry:
                if key.startswith("cosine"):
                    what = f"cosine {entry[key]['least']:.7f} at least"
            print(f"| {name} | {entry.get('seconds', '')} | {stages.get('network', '')} | {entry.get('device_peak_mib', '')} | {what} |")
        for row in self.results.get("profile", {}).get("kernels", [])[:14]:
            print(row)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--built", type=Path, required=True, help="folder of `device.sh pack`")
    parser.add_argument("--out", type=Path, required=True, help="folder for device.json")
    parser.add_argument("--work", type=Path, help="folder for scenes and results [OUT/work]")
    parser.add_argument("--shared", type=Path, help="the shared reference data, for goldens")
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--steps", default="card,checks,networks,profile,training,pytorch")
    args = parser.parse_args()
    args.work = args.work or args.out / "work"
    args.out.mkdir(parents=True, exist_ok=True)
    bench = Bench(args)
    for step in args.steps.split(","):
        try:
            getattr(bench, step)()
        except Exception as error:  # A step that breaks must not cost the others their time on the device.
            bench.results.setdefault(step, {})["broke"] = repr(error)
            print(f"{step} broke: {error!r}", flush=True)
        bench.save()
    bench.table()


if __name__ == "__main__":
    main()
