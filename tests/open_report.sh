#!/usr/bin/env bash
# Opens a report in headless Chromium and looks for its tables and figures.
#
#     tests/open_report.sh REPORT.html [ID...]
#
# Exits with 1 if the page has no such id, a figure has no size, or the browser reports an error.
set -euo pipefail
page=$(realpath "$1")
shift
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
browse() {
    chromium --headless --no-sandbox --disable-gpu --disable-quic --no-first-run \
        --disable-background-networking --disable-component-update --disable-sync \
        --user-data-dir="$work/profile" --enable-logging=stderr "$@" 2>"$work/log"
}
browse --dump-dom "file://$page" >"$work/dom"
if grep -E 'CONSOLE.*(error|Error|SEVERE)' "$work/log"; then
    echo "the browser reports an error" >&2
    exit 1
fi
for id in "$@"; do
    grep -q "id=\"$id\"" "$work/dom" || { echo "no $id on the page" >&2; exit 1; }
done
browse --window-size=1100,1600 --screenshot="$work/page.png" "file://$page"
bytes=$(stat -c %s "$work/page.png")
# An empty page of this size has about five thousand bytes.
((bytes > 50000)) || { echo "the page looks empty: $bytes bytes" >&2; exit 1; }
echo "$(grep -c '<svg' "$work/dom") lines with figures, screenshot of $bytes bytes"
