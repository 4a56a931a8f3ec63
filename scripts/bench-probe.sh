#!/usr/bin/env bash
# Measures the light of recordings against their truth, and the time and error of every map of light; prints tables.
#
# usage: scripts/bench-probe.sh
#   SEQUENCES   more folders with recording/, scene/ and truth/, separated by blanks
#   OUT         where the measured light goes (out/bench-probe)
set -euo pipefail
cd "$(dirname "$0")/.."

out=${OUT:-out/bench-probe}
bin=${CARGO_TARGET_DIR:-target}/release
# Where this is not set (a container, say), Mesa prints an error that is none.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp}

read -r -a more <<<"${SEQUENCES:-}"
sequences=(tests/data/*/ "${more[@]}")
sequences=("${sequences[@]%/}")

cargo build --release --locked -p mirrorball-render -p mirrorball-tests --bins
for sequence in "${sequences[@]}"; do
    echo "$sequence" >&2
    rm -rf "${out:?}/$(basename "$sequence")"
    "$bin/mirrorball-render" --recording "$sequence/recording" --scene "$sequence/scene/scene.toml" \
        --out "$out/$(basename "$sequence")" --light-only
done
"$bin/probe-table" --out "$out" "${sequences[@]}"
echo
cargo bench --locked -p mirrorball-render --bench light_maps
