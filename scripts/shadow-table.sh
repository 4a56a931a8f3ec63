#!/usr/bin/env bash
# Every shadow method in the camera's picture, on recordings with truth: PSNR in dB of the region that virtual objects darken,
# all reference frames of a recording, with the measured light and with the true map of the first virtual object.
#
# usage: scripts/shadow-table.sh SEQUENCE...     (folders with recording/, scene/ and truth/)
#   METHODS     which methods (all but those that take minutes a frame without a GPU)
#   OUT         where the pictures go (out/shadow-table)
set -euo pipefail
cd "$(dirname "$0")/.."

bin=${CARGO_TARGET_DIR:-target}/release
out=${OUT:-out/shadow-table}
methods=${METHODS:-none blob planar soft-planar volume-zpass volume-zfail haller map pcf9 pcf25 pcf49 pcss
    attenuation-maps dome16 dome64 dome256 hand dome-improved base-brightness ambient-occlusion stable}
# Where this is not set (a container, say), Mesa prints an error that is none.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp}

cargo build --release --locked --quiet -p mirrorball-render -p mirrorball-tests --bins

# The name of the first virtual object of a scene file.
first_virtual() {
    awk -F'"' '/^name/ { name = $2 } /^kind/ && $2 == "virtual" { print name; exit }' "$1"
}

# The shadow region's figures, one per reference frame.
shadow_db() {
    local sequence=$1 folder=$2
    shift 2
    "$bin/mirrorball-render" --recording "$sequence/recording" --scene "$sequence/scene/scene.toml" \
        --out "$folder" "$@" 2>"$folder.log" || { tail -n 1 "$folder.log" >&2; echo '–'; return; }
    "$bin/score" "$folder" "$sequence/truth" | awk '$1 == "shadow" && NF == 6 { printf "%s%s", sep, $3; sep = ", " }'
}

mkdir -p "$out"
echo '| sequence | method | true map | own light |'
echo '| --- | --- | --- | --- |'
for sequence in "$@"; do
    map=
    for file in "$sequence"/truth/env/*_"$(first_virtual "$sequence/scene/scene.toml")".exr; do
        [ -e "$file" ] && { map=$file; break; }
    done
    for method in $methods; do
        folder=$out/$(basename "$sequence")-$method
        given='–'
        [ -n "$map" ] && given=$(shadow_db "$sequence" "$folder-map" --shadow "$method" --environment-in "$map")
        own=$(shadow_db "$sequence" "$folder" --shadow "$method")
        echo "| $(basename "$sequence") | \`$method\` | $given | $own |"
    done
done
