#!/usr/bin/env python3
"""Source files of a Rust workspace that use each other in a circle.

Standard library and git only. Run in the root of the clone. Reads `use` lines and `crate::`/`super::` paths of
non-test code; module files (lib.rs, mod.rs) do not count as ends. Exit code 1 if there are more circles than the argument says (0).
"""
import collections
import re
import subprocess
import sys

FILES = [f for f in subprocess.check_output(["git", "ls-files"], text=True).split()
         if f.endswith(".rs") and re.match(r"^((crates/)?[a-z-]+/)?src/", f) and not f.endswith("tests.rs") and "/tests/" not in f]


def module_of(file):
    crate, path = re.match(r"^(?:(?:crates/)?([a-z-]+)/)?src/(.*)\.rs$", file).groups()
    parts = path.split("/")
    return (crate or "root",) + tuple(parts[:-1] if parts[-1] in ("mod", "lib", "main") else parts)


MODULES = {module_of(f): f for f in FILES}


def expand(text, before=""):
    """`a::{b, c::{d}}` as single paths."""
    text = text.strip()
    found = re.match(r"^(.*?)\{(.*)\}$", text, re.S)
    if not found:
        return [before + text]
    out, depth, part = [], 0, ""
    for c in found.group(2) + ",":
        depth += (c == "{") - (c == "}")
        if c == "," and depth == 0:
            if part.strip():
                out += expand(part, before + found.group(1))
            part = ""
        else:
            part += c
    return out


def uses(module, file):
    text = open(file).read()
    test = text.find("#[cfg(test)]\nmod")
    text = re.sub(r"//[^\n]*", "", text if test < 0 else text[:test])
    for use in re.findall(r"\buse ([^;]+);", text) + re.findall(r"\b((?:crate|super)(?:::\w+)+)", text):
        for path in expand(use):
            part = path.split(" as ")[0].strip().split("::")
            if part[0] == "crate":
                part = [module[0]] + part[1:]
            elif part[0] == "super":
                base = list(module)
                while part and part[0] == "super":
                    base, part = base[:-1], part[1:]
                part = base + part
            else:
                continue
            for k in range(len(part), 0, -1):
                target = MODULES.get(tuple(part[:k]))
                if target:
                    if target != file and not target.endswith(("lib.rs", "mod.rs")):
                        yield target
                    break


def circles(edges):
    """Strongly connected components of more than one file (Tarjan)."""
    sys.setrecursionlimit(10_000)
    order, low, stack, on, found = {}, {}, [], set(), []

    def visit(v):
        order[v] = low[v] = len(order)
        stack.append(v)
        on.add(v)
        for w in edges[v]:
            if w not in order:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in on:
                low[v] = min(low[v], order[w])
        if low[v] == order[v]:
            part = []
            while True:
                w = stack.pop()
                on.discard(w)
                part.append(w)
                if w == v:
                    break
            if len(part) > 1:
                found.append(sorted(part))

    for v in sorted(edges):
        if v not in order:
            visit(v)
    return sorted(found)


def main():
    edges = collections.defaultdict(set)
    for module, file in MODULES.items():
        edges[file] |= set(uses(module, file))
    for targets in list(edges.values()):
        for t in targets:
            edges.setdefault(t, set())
    found = circles(edges)
    for part in found:
        print(" <-> ".join(part))
    print(f"{len(FILES)} files, {len(found)} circles")
    most = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    return 1 if len(found) > most else 0


if __name__ == "__main__":
    sys.exit(main())
