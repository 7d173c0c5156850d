#!/bin/sh
# Makes docs/mission.png: a mission at 60 % of its time, as its review page shows it. Run from the repository's root.
# CHROMIUM and GATAR name the programs where they are not called so.
set -eu
picture=${1:-docs/mission.png}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${GATAR:-gatar}" sim --team 3A3G --seed 1 --out "$work"
"${CHROMIUM:-chromium}" --headless --no-sandbox --disable-gpu --hide-scrollbars --user-data-dir="$work/profile" \
  --window-size=1400,900 --virtual-time-budget=4000 --screenshot="$work/mission.png" "file://$work/report.html#t=25.2" 2>/dev/null
mv "$work/mission.png" "$picture"
