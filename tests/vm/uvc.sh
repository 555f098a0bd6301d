# A webcam: listed, recorded with its controls held, unplugged, back under a new number, replayed.
. "$SCENARIOS/guest.sh"
links &
plug
until [ -e /dev/v4l/by-id/usb-Replay_camera-video-index0 ]; do sleep .1; done
ls /dev/video* | wc -l | sed 's/^/nodes /'
"$STAGEPOSE" devices
"$STAGEPOSE" devices --json | grep -c '"node"' | sed 's/^/listed /'
config 'device = "/dev/v4l/by-id/usb-Replay_camera-video-index0"\nformat = "mjpeg"\ncontrols = { auto_exposure = 1, exposure_time_absolute = 83, gain = 70, focus_automatic_continuous = false, zoom = 3 }'
"$STAGEPOSE" check --config stage.toml; echo "check $?"
start record take
until_line poses '"sequence"' 3
exec 9</dev/video0                        # a dead number that stays taken
kill $rig
until_line events '"event":"stale"'
until_line events '"event":"camera_waiting"'
plug
until_line events '"again":true'
until_line poses '"sequence"' $(($(wc -l <poses) + 3))
finish
cat log events; ls /dev/video*
# For information: whether two frames come close enough in time to confirm each other is a matter of speed.
grep -c '"state":"tracking"' poses | sed 's/^/tracked /'
tail -c 2 poses | grep -c '}' | sed 's/^/flushed /'
"$STAGEPOSE" replay take --config take/config/stage.toml --poses again >/dev/null && cmp again take/poses.jsonl && echo "replay is the same"
grep '70$' rig.log | sort | uniq -c
