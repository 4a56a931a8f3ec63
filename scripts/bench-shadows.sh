#!/usr/bin/env bash
# Measures every shadow method on this machine's graphics adapter; prints tables, writes them with plots and a contact
# sheet to a folder.
#
# usage: scripts/bench-shadows.sh [--quick] [--only maps,domes,volumes,growth,errors,sheet]
#   OUT         where the results go (out/bench-shadows)
set -euo pipefail
cd "$(dirname "$0")/.."

bin=${CARGO_TARGET_DIR:-target}/release
# Where this is not set (a container, say), Mesa prints an error that is none.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp}

cargo build --release --locked -p mirrorball-tests --bin bench-shadows
"$bin/bench-shadows" --out "${OUT:-out/bench-shadows}" "$@"
