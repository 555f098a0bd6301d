#!/usr/bin/env bash
# What `run` costs: an MJPG clip of 1280 x 720 at 30 frames a second, paced through the live pipeline while it tracks.
#   benches/live.sh [SECONDS]      prints the share of one core, the frames tracked and dropped, and their age
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-20}
out=target/live-bench
program=target/release/stagepose
[ -d "$out/take" ] || "$program" demo --frames 150 --width 1280 --height 720 --jpeg 85 --save "$out/take" >/dev/null
if [ ! -e "$out/clip.mjpeg" ]; then
    # To and fro, so that it has no cut.
    files=("$out"/take/frames/*.jpg)
    for round in {1..8}; do
        cat "${files[@]}"
        for ((k = ${#files[@]} - 2; k > 0; k--)); do cat "${files[k]}"; done
    done >"$out/clip.mjpeg"
fi
port=18090
sed "\$a [http]\nlisten = \"127.0.0.1:$port\"" "$out/take/stage.toml" >"$out/take/live.toml"
"$program" run --config "$out/take/live.toml" --play "$out/clip.mjpeg" --poses "$out/poses.jsonl" &
pid=$!
sleep 4 # the reference pictures are prepared once
ticks() {
    local stat
    read -ra stat <"/proc/$pid/stat"
    echo $((stat[13] + stat[14]))
}
before=$(ticks) begun=$(date +%s.%N) lines=$(wc -l <"$out/poses.jsonl")
sleep "$seconds"
after=$(ticks) ended=$(date +%s.%N) now=$(wc -l <"$out/poses.jsonl")
metrics=$(curl -s "http://127.0.0.1:$port/metrics")
kill -TERM $pid
wait $pid
python3 - "$before" "$after" "$begun" "$ended" "$(getconf CLK_TCK)" "$lines" "$now" "$out/poses.jsonl" <<'PY'
import json, sys
before, after, begun, ended, tick = map(float, sys.argv[1:6])
first, last = int(sys.argv[6]), int(sys.argv[7])
states = [json.loads(line)["state"] for line in open(sys.argv[8])][first:last]
span = ended - begun
print(f"{100 * (after - before) / tick / span:.1f} % of one core, {len(states) / span:.1f} frames/s, "
      f"{100 * states.count('tracking') / max(len(states), 1):.1f} % tracking, over {span:.1f} s")
PY
grep -E '^stagepose_(frames_dropped_total|frame_age_seconds_(sum|count)|stage_seconds_(sum|count))' <<<"$metrics"
