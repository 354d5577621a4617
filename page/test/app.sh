#!/usr/bin/env bash
# The page of `scenesplat app` and the npm package, against the program that SCENESPLAT_PROGRAM names: page/test/app.sh FOLDER
# [SCENE]... Takes some minutes, and more for each further scene. FOLDER gets the page, pictures of it, the package and labels.
set -euo pipefail
program=$(realpath "$SCENESPLAT_PROGRAM")
page=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
scenes=(demo/room.ply room.spz room.sog room.usdz)
for scene in "${@:2}"; do scenes+=("$(realpath "$scene")"); done
cd "$1"
export SCENESPLAT_ISA=portable
"$program" app --out app.html
"$program" demo --out demo >/dev/null 2>&1
for format in spz sog usdz; do "$program" convert demo/room.ply "room.$format"; done
pairs=()
for scene in "${scenes[@]}"; do
  labels=labels-${scene##*/}
  "$program" segment "$scene" --instances --out "$labels" >/dev/null 2>&1
  node "$page/test/engine.mjs" app.html "$scene" "$labels"
  pairs+=("$scene" "$labels")
done
node "$page/test/app.mjs" app.html shots "${pairs[@]}"
node "$page/npm/pack.mjs" app.html package
(cd package && npm pack --silent)
rm -rf fresh && mkdir fresh
(cd fresh && npm init -y >/dev/null && npm install --silent --no-audit --no-fund ../package/scenesplat-*.tgz &&
  node node_modules/scenesplat/examples/node.mjs ../demo/room.ply)
cp -r "$page/node_modules/three" fresh/node_modules/
node "$page/test/three.mjs" fresh demo/room.ply shots/three.png
