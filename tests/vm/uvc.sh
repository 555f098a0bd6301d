# A webcam: listed, checked, recorded with its controls held, unplugged and back under a new number, stalling, replaced, replayed.
. "$SCENARIOS/guest.sh"
links &
plug
until [ -e "$by_id" ]; do nap .1; done
set -- /dev/video*; echo "nodes $#"
"$STAGEPOSE" devices
"$STAGEPOSE" devices --json >listed; count listed '"node"'; echo "listed $lines"
config "device = \"$by_id\"\nformat = \"mjpeg\"\ncontrols = { auto_exposure = 1, exposure_time_absolute = 83, gain = 70, focus_automatic_continuous = false, zoom = 3 }"
"$STAGEPOSE" check --config stage.toml; echo "check $?"
start record take
more poses '"sequence"' 3

exec 9</dev/video0 # a dead number that stays taken
kill $rig
until_line events '"event":"stale"'
until_line events '"event":"camera_waiting"'
plug stall=15
until_line events '"event":"resumed"'
more poses '"sequence"' 2

until_line events 'gave no picture'
until_line events '"again":true' 2 # it opens again, and gives nothing
kill $rig
plug
until_line events '"event":"resumed"' 2
more poses '"sequence"' 2
finish
cat log events
count poses '"state":"tracking"'; echo "tracked $lines"
[ "$(tail -c 2 poses)" = '}' ] && echo "flushed"
cmp poses take/poses.jsonl && echo "recorded what was given out"
"$STAGEPOSE" replay take --config take/config/stage.toml --poses again >replayed && cmp again take/poses.jsonl && echo "replay is the same"
count rig.log 'control 2/4 = 70$'; echo "gain was set $lines times"
