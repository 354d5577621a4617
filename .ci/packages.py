"""Checks that each crate can be packaged: what it builds in, its licenses and its README lie in its own package.

`cargo package` itself compiles every package from what it packed, which takes as long as a release build; this takes
seconds and sees what differs between the repository and a package.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

# The registry refuses more than 10 MB compressed. Weights do not get smaller, texts get four times smaller.
LARGEST = 12_000_000
INCLUDED = re.compile(r'include(?:_str|_bytes)?!\(\s*"([^"]+)"')
TEST_MODULE = re.compile(r"^#\[cfg\(test\)\]\n(?:pub\(crate\) )?mod \w+ \{", re.M)
TESTS = re.compile(r"(^|/)(tests?|benches|examples|by_hand)(/|\.rs$)")


def cargo(*arguments):
    return subprocess.run(["cargo", *arguments], check=True, capture_output=True, text=True).stdout


def packages():
    members = json.loads(cargo("metadata", "--no-deps", "--format-version=1", "--locked"))["packages"]
    return [package for package in members if package["publish"] is None]


def problems(package):
    root = Path(package["manifest_path"]).parent
    listed = cargo("package", "--list", "--allow-dirty", "--locked", "--offline", "-p", package["name"])
    files = {line.strip() for line in listed.splitlines()}
    for name in ["LICENSE-APACHE", "LICENSE-MIT", "README.md"]:
        if name not in files or not (root / name).is_file():
            yield f"{name} is missing"
    for name in sorted(files):
        if not name.endswith(".rs") or TESTS.search(name):
            continue
        # What only tests build in may lie outside: packages are built, not tested.
        text = TEST_MODULE.split((root / name).read_text())[0]
        for included in INCLUDED.findall(text):
            target = (root / name).parent / included
            try:
                inside = target.resolve().relative_to(root.resolve()).as_posix()
            except ValueError:
                yield f"{name} builds in {included}, which is in no package"
                continue
            if inside not in files:
                yield f"{name} builds in {inside}, which its package leaves out"
    size = sum((root / name).stat().st_size for name in files if (root / name).is_file())
    if size > LARGEST:
        yield f"{size / 1e6:.1f} MB, {LARGEST / 1e6:.0f} at most"
    for dependency in package["dependencies"]:
        # A path alone is left out of a package: only what tests need may be named so.
        if dependency.get("path") and dependency["req"] == "*" and dependency["kind"] != "dev":
            yield f"{dependency['name']} has no version"


def main():
    bad = 0
    for package in packages():
        for problem in problems(package):
            print(f"{package['name']}: {problem}")
            bad += 1
    sys.exit(bad > 0)


main()
