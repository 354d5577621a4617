#!/usr/bin/env bash
# Everything that is worth knowing of a graphics processor, in one run of at most 8 minutes: kernels and goldens
# checked, networks and training timed, PyTorch beside it, kernels profiled. One JSON file and one table.
#
#   benches/device.sh pack FOLDER [release-fast]   here: builds the programs with CUDA and wgpu into FOLDER (no toolkit, no GPU needed)
#   benches/device.sh run FOLDER OUT [DEVICE]      there: DEVICE is cuda:0, or cpu to try the script without a device
#
# `run` needs what docs/devices.md lists (driver, cuBLAS, cuRAND, NVRTC; Vulkan for WGSL), python3 with numpy, and for the comparison
# PyTorch. It needs no network, no Rust and nothing of the repository but this folder.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

pack() {
  local to=$1
  mkdir -p "$to"
  to=$(cd "$to" && pwd)
  cd "$here/.."
  cargo build --locked --release -p scenesplat-cli --features cuda,wgpu
  cp "${CARGO_TARGET_DIR:-target}/release/scenesplat" "$to/scenesplat"
  # The programs of the tests that compare a device with the CPU.
  export CARGO_PROFILE_DEV_DEBUG=0
  test_program() {
    cargo test --locked --no-run --message-format=json "$@" |
      sed -n 's/.*"kind":\["test"\].*"executable":"\([^"]*\)".*/\1/p'
  }
  cp "$(test_program -p scenesplat-device --test cuda)" "$to/kernels"
  cp "$(test_program -p scenesplat-models --features cuda --test "${MODELS_TEST:-suite}")" "$to/networks"
  cp "$(test_program -p scenesplat-gpu --test suite)" "$to/wgsl"
  strip "$to"/*
  ls -l "$to"
}

run() {
  local built=$1 out=$2 device=${3:-cuda:0}
  mkdir -p "$out"
  # Libraries of CUDA that came with Python packages.
  local folders
  folders=$(python3 -c 'import site, glob; print(":".join(f for s in site.getsitepackages() for f in glob.glob(s + "/nvidia/*/lib") + glob.glob(s + "/nvidia/*/lib64")))' 2>/dev/null || true)
  export LD_LIBRARY_PATH=${LD_LIBRARY_PATH:-}${folders:+:$folders}
  exec python3 "$here/device.py" --built "$built" --out "$out" --device "$device"
}

case ${1:-} in
  pack) pack "${2:?a folder}" ;;
  run) run "${2:?the folder of pack}" "${3:?a folder for results}" "${4:-cuda:0}" ;;
  *) sed -n '2,11s/^# \{0,1\}//p' "$0"; exit 2 ;;
esac
