#!/usr/bin/env bash
# The page of `scenesplat app` and the npm package, against the program that SCENESPLAT_PROGRAM names: page/test/app.sh FOLDER
# Takes some minutes. FOLDER gets the page, pictures of it, the package and labels.
set -euo pipefail
program=$(realpath "$SCENESPLAT_PROGRAM")
page=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
cd "$1"
export SCENESPLAT_ISA=portable
"$program" app --out app.html
"$program" demo --out demo >/dev/null 2>&1
"$program" convert demo/room.ply room.spz
"$program" convert demo/room.ply room.sog
for scene in demo/room.ply room.spz room.sog; do
  "$program" segment "$scene" --instances --out "labels-${scene##*.}" >/dev/null 2>&1
  node "$page/test/engine.mjs" app.html "$scene" "labels-${scene##*.}"
done
node "$page/test/app.mjs" app.html shots demo/room.ply labels-ply room.spz labels-spz room.sog labels-sog
node "$page/npm/pack.mjs" app.html package
(cd package && npm pack --silent)
rm -rf fresh && mkdir fresh
(cd fresh && npm init -y >/dev/null && npm install --silent --no-audit --no-fund ../package/scenesplat-*.tgz &&
  node node_modules/scenesplat/examples/node.mjs ../demo/room.ply)
