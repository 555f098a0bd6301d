#!/usr/bin/env bash
# Cost of `run`: an MJPG clip of 1280 x 720 at 30 frames a second, paced through the live pipeline
# while it is tracked.
#   benches/live.sh [SECONDS] [JPEG QUALITY]
# The take is rendered first, at a third of a second per frame. Prints the fraction of one core in
# total and per thread, the frames tracked and dropped, and their age. A machine that is busy with
# other programs drops frames; then the milliseconds per frame say more than the fraction.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-20}
quality=${2:-85}
out=target/live-bench/$quality
mkdir -p "$out"
rm -f "$out/poses.jsonl"
program=${STAGEPOSE:-target/release/stagepose}
# One take from beginning to end: played to and fro, its shutter would run backwards half of the
# time. The spare seconds are for the start.
frames=$(((seconds + 8) * 30))
rm -rf "$out/take"
"$program" demo --frames $frames --width 1280 --height 720 --jpeg "$quality" --save "$out/take" >/dev/null
files=("$out"/take/frames/*.jpg)
cat "${files[@]}" >"$out/clip.mjpeg"
port=18090
sed "\$a [http]\nlisten = \"127.0.0.1:$port\"" "$out/take/stage.toml" >"$out/take/live.toml"
"$program" run --config "$out/take/live.toml" --play "$out/clip.mjpeg" --poses "$out/poses.jsonl" &
pid=$!
# Waits until the reference pictures are prepared and frames are tracked.
until [ "$(cat "$out/poses.jsonl" 2>/dev/null | wc -l)" -gt 30 ]; do sleep 0.2; done
ticks() { # of each thread: its name and its processor time
    local thread stat
    for thread in /proc/$pid/task/*; do
        stat=$(<"$thread/stat")
        read -ra stat <<<"${stat##*) }"
        echo "$(<"$thread/comm") $((stat[11] + stat[12]))"
    done
}
before=$(ticks) begun=$(date +%s.%N) lines=$(wc -l <"$out/poses.jsonl")
sleep "$seconds"
after=$(ticks) ended=$(date +%s.%N) now=$(wc -l <"$out/poses.jsonl")
metrics=$(curl -s "http://127.0.0.1:$port/metrics")
kill -TERM $pid
wait $pid
bytes=$(cat "${files[@]}" | wc -c)
python3 - "$before" "$after" "$begun" "$ended" "$(getconf CLK_TCK)" "$lines" "$now" "$out/poses.jsonl" "$((bytes / ${#files[@]}))" <<'PY'
import json, sys
span, tick, first, last = float(sys.argv[4]) - float(sys.argv[3]), float(sys.argv[5]), int(sys.argv[6]), int(sys.argv[7])
states = [json.loads(line)["state"] for line in open(sys.argv[8])][first:last]
used = {}
for text, sign in (sys.argv[1], -1), (sys.argv[2], 1):
    for name, ticks in (line.rsplit(" ", 1) for line in text.splitlines()):
        used[name] = used.get(name, 0) + sign * int(ticks) / tick
whole = sum(used.values())
print(f"{100 * whole / span:.1f} % of one core, {1e3 * whole / max(len(states), 1):.1f} ms a frame of {int(sys.argv[9]) / 1e3:.0f} kB, "
      f"{len(states) / span:.1f} frames/s, {100 * states.count('tracking') / max(len(states), 1):.1f} % tracking, over {span:.1f} s")
print("by thread: " + ", ".join(f"{name} {100 * s / span:.1f} %" for name, s in sorted(used.items(), key=lambda u: -u[1]) if s > 0))
PY
grep -E '^stagepose_(frames_dropped_total|frame_age_seconds_(sum|count)|stage_seconds_(sum|count))' <<<"$metrics"
