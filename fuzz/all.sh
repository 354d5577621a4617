#!/usr/bin/env bash
# Runs every target for the given number of seconds and says how it went.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-60}
failed=0
for target in $(cargo +nightly fuzz list); do
  log=$(mktemp)
  if cargo +nightly fuzz run "$target" -- -max_total_time="$seconds" -rss_limit_mb=2048 >"$log" 2>&1; then
    echo "$target: $(grep -E '^Done' "$log" | tail -1)"
  else
    echo "$target: FAILED, see $log"
    failed=1
  fi
done
exit $failed
