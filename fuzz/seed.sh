#!/usr/bin/env bash
# Fills fuzz/corpus from the shared fixtures and from files that the program writes.
set -euo pipefail
cd "$(dirname "$0")/.."
shared=${SCENESPLAT_SHARED:-../shared}
real=$shared/real
corpus=fuzz/corpus
mkdir -p $corpus/{ply,ply_points,spz,splat,sog,sog_json,ksplat,gltf,usd,cameras_json,transforms_json,colmap_binary,colmap_text,npy,labels,weights,pickle,network_config,experiment,picture}
cp "$real"/fixtures/*.spz $corpus/spz/
cp "$real"/fixtures/*.splat $corpus/splat/
cp "$real"/fixtures/*.ksplat $corpus/ksplat/
cp "$real"/fixtures/*.gltf $corpus/gltf/
cp "$real"/fixtures/*.ply $corpus/ply/
cp "$real"/objects/playbot_sog2_lod/6_0/meta.json $corpus/sog_json/v2.json
cp "$real"/objects/playcanvas_logo_sog1/meta.json $corpus/sog_json/v1.json
cp "$real"/objects/playbot_sog2_lod/lod-meta.json $corpus/sog_json/lod.json
cp "$real"/scenes/arkit_brush/cameras.json $corpus/cameras_json/
find models/tests/data -name '*.safetensors' -size -64k -exec cp {} $corpus/weights/ \;
cp models/tests/data/*.pth models/tests/data/*.pt $corpus/weights/
for archive in models/tests/data/*.pth models/tests/data/*.pt; do
  unzip -p "$archive" '*data.pkl' >"$corpus/pickle/$(basename "$archive").pkl" || true
done
cp assets/embedded/config.json $corpus/network_config/embedded.json
cp models/tests/data/hub/config.json $corpus/network_config/hub.json
find configs -name '*.toml' -exec cp {} $corpus/experiment/ \;
find "$real" \( -name '*.png' -o -name '*.jpg' \) -size -64k -exec cp {} $corpus/picture/ \;
small=$(mktemp -d)
cargo run -q --release --example synthetic_room -- 7 "$small/room" 100
convert() { cargo run -q --release -- convert --quiet --overwrite "$small/room.ply" "$@" >/dev/null; }
convert "$small/a.ply" --sample 20
cp "$small/a.ply" $corpus/ply/labelled.ply
cp "$small/a.ply" $corpus/ply_points/labelled.ply
convert "$small/a.compressed.ply" --sample 20
cp "$small/a.compressed.ply" $corpus/ply/
cp "$small"/*.labels.safetensors $corpus/labels/
for version in 2 3 4; do convert "$corpus/spz/labelled-v$version.spz" --sample 20 --spz-version $version; done
convert $corpus/splat/room.splat --sample 20
convert $corpus/sog/room.sog --sample 20
convert $corpus/usd/room.usda --sample 20
convert $corpus/usd/room.usdz --sample 20
convert "$small/npy" --sample 20
cp "$small"/npy/*.npy $corpus/npy/
printf '{"w":4,"h":3,"fl_x":5.0,"frames":[{"file_path":"a.png","transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}' \
  >$corpus/transforms_json/one.json
python3 - "$corpus" <<'PY'
import struct, sys
corpus = sys.argv[1]
cameras = struct.pack("<QiiQQ4d", 1, 1, 1, 640, 480, 500, 500, 320, 240)
images = struct.pack("<Qi7di", 1, 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0" + struct.pack("<Q2dq", 1, 5, 6, 1)
points = struct.pack("<QQ3d3BdQii", 1, 1, 1, 2, 3, 9, 9, 9, 0.5, 1, 1, 0)
open(f"{corpus}/colmap_binary/one", "wb").write(struct.pack("<II", len(cameras), len(images)) + cameras + images + points)
cameras = b"1 PINHOLE 640 480 500 500 320 240\n"
images = b"1 1 0 0 0 0 0 0 1 a.png\n5 6 1\n"
points = b"1 1 2 3 9 9 9 0.5 1 0\n"
open(f"{corpus}/colmap_text/one", "wb").write(struct.pack("<II", len(cameras), len(images)) + cameras + images + points)
PY
cargo run -q --release -- inspect --quiet "$small/room.ply" --sheet "$small/sheet.png" >/dev/null || true
[ ! -f "$small/sheet.png" ] || cp "$small/sheet.png" $corpus/picture/
rm -r "$small"
find $corpus -type f | wc -l
