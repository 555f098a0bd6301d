# A webcam: listed, checked, recorded with its controls held, unplugged and back under a new number,
# stalling, back on another port; then addressed by the name of a port after a reload; replayed.
# Finally, `calibrate` takes its own pictures from it.
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

exec 9</dev/video0 # a dead number that stays in use
unplug
until_line events '"event":"stale"'
until_line events '"event":"camera_waiting"'
# Long enough for a frame to be tracked, which takes seconds here.
plug stall=60
until_line events '"event":"resumed"'
more poses '"sequence"' 1

until_line events 'gave no picture'
until_line events '"again":true' 2 # it opens again, and delivers nothing
unplug
ports 3
plug
until_line events '"event":"resumed"' 2
until_line log 'is now on another port'
more poses '"sequence"' 2

# Here, consecutive frames come too far apart to confirm each other. Pairs of frames do confirm each
# other if each pair has enough time.
for pair in {1..7}; do
    kill -STOP $rig
    nap 1.8
    kill -CONT $rig
    nap .4
done

# Addresses the camera by the name of a port: a camera on another port does not match. A bad config
# changes nothing.
sed -i 's/^device/devise/' stage.toml
kill -HUP $pid
until_line events '"event":"config_refused"'
sed -i "s#^devise = .*#device = \"${by_path}4:1.0-video-index0\"#" stage.toml
kill -HUP $pid
until_line events '"event":"config_reloaded"'
until_line events '"event":"recorder_started"' 2
more poses '"sequence"' 1
unplug
ports 5
plug
until_line log 'there is no camera /dev/v4l/by-path'
unplug
ports 3
plug
until_line events '"event":"camera_opened".*"again":true' 4
more poses '"sequence"' 1
finish
cat log events
count poses '"state":"tracking"'; echo "tracked $lines"
[ "$(tail -c 2 poses)" = '}' ] && echo "flushed"
cat take/poses.jsonl take-2/poses.jsonl >recorded
cmp poses recorded && echo "recorded what was given out"
"$STAGEPOSE" replay take --config take/config/stage.toml --poses again >replayed && cmp again take/poses.jsonl && echo "replay is the same"
count rig.log 'control 2/4 = 70$'; echo "gain was set $lines times"

unplug
uvcam 320x240 5 MJPG="$MEDIA/boards.mjpeg" 2>>rig.log & rig=$!
until [ -e "$by_id" ]; do nap .1; done
"$STAGEPOSE" calibrate --device "$by_id" --size 320x240 --board 9x6 --square-mm 25 --pictures 3 --save shots --output camera.toml; echo "calibrate $?"
set -- shots/*; echo "took $# pictures"
