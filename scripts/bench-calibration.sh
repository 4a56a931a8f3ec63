#!/usr/bin/env bash
# Calibrates lenses from the same corners with mirrorball-calib and, where they are installed, OpenCV and mrcal; prints tables.
#
# usage: scripts/bench-calibration.sh
#   SEEDS       synthetic cameras per case (5)
#   SIGMA_PX    noise of the corners (0.05)
#   PHOTOS      folder of pictures of the fisheye chessboard of 9 x 6 inner corners, to be calibrated too
#   PYTHON      a Python with numpy (python3); OpenCV is taken from there, mrcal from its program
set -euo pipefail
cd "$(dirname "$0")/.."

cargo build --release --locked -p mirrorball-calib --bins
bin=${CARGO_TARGET_DIR:-target}/release
exec "${PYTHON:-python3}" scripts/bench_calibration.py --program "$bin/mirrorball-calib" --seeds "${SEEDS:-5}" \
    --sigma "${SIGMA_PX:-0.05}" ${PHOTOS:+--photos "$PHOTOS"}
