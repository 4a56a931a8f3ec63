#!/usr/bin/env bash
# Our composites beside those lit as phones do it and beside the path-traced references: a picture, and a table in Markdown.
#
# The phone's way is given the true map at the first virtual object where the light stands still, else the measured light.
#
# usage: scripts/gallery.sh SEQUENCE...     (folders with recording/, scene/ and truth/)
#   OUT     where the pictures go (out/gallery)
set -euo pipefail
cd "$(dirname "$0")/.."

bin=${CARGO_TARGET_DIR:-target}/release
out=${OUT:-out/gallery}
# Where this is not set (a container, say), Mesa prints an error that is none.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp}

cargo build --release --locked --quiet -p mirrorball-render -p mirrorball-tests --bins

# The name of the first virtual object of a scene file.
first_virtual() {
    awk -F'"' '/^name/ { name = $2 } /^kind/ && $2 == "virtual" { print name; exit }' "$1"
}

mkdir -p "$out"
rows=()
for sequence in "$@"; do
    name=$(basename "$sequence")
    map=$sequence/truth/env/static_$(first_virtual "$sequence/scene/scene.toml").exr
    given=()
    [ -e "$map" ] && given=(--environment-in "$map")
    common=(--recording "$sequence/recording" --scene "$sequence/scene/scene.toml")
    "$bin/mirrorball-render" "${common[@]}" --out "$out/$name"
    "$bin/mirrorball-render" "${common[@]}" --out "$out/$name-phone" \
        --config configs/peers/phone.toml "${given[@]}"
    rows+=(--row "$sequence" "$out/$name" "$out/$name-phone")
done
"$bin/gallery" "${rows[@]}" --other phone --out "$out/gallery.jpg" | tee "$out/gallery.md"
echo
echo "pictures        $out/gallery.jpg"
echo "table           $out/gallery.md"
