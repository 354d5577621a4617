#!/usr/bin/env python3
"""Links of the Markdown files: every relative target and every #heading must exist. Standard library and git only.

Run in the root of the repository. Exit code 1 if a link leads nowhere.
"""
import re
import subprocess
import sys
from pathlib import Path


def text_of(path):
    """Without code, where brackets are no links."""
    text = path.read_text()
    text = re.sub(r"^(```|~~~).*?^\1", "", text, flags=re.S | re.M)
    return re.sub(r"`[^`\n]*`", "code", text)


def anchors(path):
    """Headings as mdBook and code hosts make ids of them."""
    found, counts = set(), {}
    text = re.sub(r"^(```|~~~).*?^\1", "", path.read_text(), flags=re.S | re.M)
    for heading in re.findall(r"^#{1,6} +(.*?) *$", text, flags=re.M):
        heading = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        name = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        found.add(name if name not in counts else f"{name}-{counts[name]}")
        counts[name] = counts.get(name, 0) + 1
    return found


def main():
    broken = 0
    files = [Path(f) for f in subprocess.check_output(["git", "ls-files", "*.md"], text=True).split()]
    for file in files:
        for target in re.findall(r"!?\[[^\]]*\]\(([^)\s]*)\)", text_of(file)):
            if re.match(r"[a-z]+:", target) or not target:
                continue
            path, _, anchor = target.partition("#")
            to = (file.parent / path) if path else file
            if not to.exists():
                print(f"{file}: {target}: there is no such file")
            elif anchor and to.suffix == ".md" and anchor not in anchors(to):
                print(f"{file}: {target}: there is no such heading")
            else:
                continue
            broken += 1
    summary = Path("docs/SUMMARY.md")
    if summary.exists():
        listed = set(re.findall(r"\(([^)]+\.md)\)", summary.read_text()))
        for page in sorted({f.name for f in files if f.parent == Path("docs")} - listed - {"SUMMARY.md"}):
            print(f"docs/{page}: not in docs/SUMMARY.md")
            broken += 1
    print(f"{len(files)} files, {broken} broken links")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
