#!/usr/bin/env bash
# A picture of a report as Chromium shows it, to be looked at.
#
# usage: scripts/report-screenshot.sh REPORT.html PICTURE.png [WIDTH [HEIGHT]]
set -euo pipefail

fail() {
    echo "error: $1" >&2
    echo "  hint: $2" >&2
    exit 2
}

[ $# -ge 2 ] && [ $# -le 4 ] || fail "two to four arguments are needed" "scripts/report-screenshot.sh REPORT.html PICTURE.png [WIDTH [HEIGHT]]"
[ -f "$1" ] || fail "there is no page \`$1\`" "have one written with \`--report\`"
page=$(realpath "$1")
picture=$(realpath "$2")

browser=
for name in chromium chromium-browser google-chrome; do
    if command -v "$name" >/dev/null; then
        browser=$name
        break
    fi
done
[ -n "$browser" ] || fail "there is no Chromium" "install Debian's package \`chromium\`"

profile=$(mktemp --directory)
trap 'rm --recursive --force "$profile"' EXIT
"$browser" --headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking \
    --disable-component-update --disable-sync --disable-dev-shm-usage --hide-scrollbars \
    --user-data-dir="$profile" --window-size="${3:-900},${4:-3000}" --screenshot="$picture" "file://$page" \
    2>"$profile/log" || fail "$browser has failed: $(tail -n 1 "$profile/log")" "open the page by hand"
echo "$picture"
