#!/usr/bin/env bash
# Opens a page of `replay --html` in headless Chromium, and looks at its slice: it draws, and it moves.
#
#     tests/open_slice.sh PAGE.html
#
# Exits with 1 if the browser reports an error, the slice has too few colours, two frames look the same, or playing does
# not advance the frame.
set -euo pipefail
page=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# The page as it is, with a script at its end that looks at the canvas from outside.
{
    cat "$page"
    cat <<'PROBE'
<script>
(() => {
  const slice = document.getElementById("slice");
  const part = (name) => slice.querySelector(`[data-part=${name}]`);
  const look = () => {
    const canvas = part("canvas");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const pixels = new Uint32Array(data.buffer);
    let sum = 0;
    for (const pixel of pixels) sum = (Math.imul(sum, 31) + pixel) >>> 0;
    return { colours: new Set(pixels).size, sum };
  };
  const show = (frame) => {
    part("slider").value = frame;
    part("slider").dispatchEvent(new Event("input"));
    return look();
  };
  const first = show(0), last = show(Number(part("slider").max));
  show(0);
  part("play").click();
  setTimeout(() => {
    const found = { colours: last.colours, differ: first.sum !== last.sum, played: Number(slice.dataset.frame) > 1 };
    const answer = document.createElement("pre");
    answer.id = "probe";
    answer.textContent = JSON.stringify(found);
    document.body.append(answer);
  }, 1500);
})();
</script>
PROBE
} >"$work/page.html"
chromium --headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking \
    --disable-component-update --disable-sync --user-data-dir="$work/profile" --enable-logging=stderr \
    --virtual-time-budget=4000 --dump-dom "file://$work/page.html" >"$work/dom" 2>"$work/log"
if grep -E 'CONSOLE.*(error|Error|SEVERE)' "$work/log"; then
    echo "the browser reports an error" >&2
    exit 1
fi
found=$(grep -o '<pre id="probe">[^<]*' "$work/dom" | cut -d'>' -f2) || { echo "no answer from the page" >&2; exit 1; }
python3 - "$found" <<'CHECK'
import json, sys
found = json.loads(sys.argv[1])
assert found["colours"] > 200, found
assert found["differ"], "the first and the last frame look the same"
assert found["played"], "playing does not advance the frame"
print(f"the slice moves, in {found['colours']} colours")
CHECK
