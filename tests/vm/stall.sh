# A webcam that stays plugged in and sends nothing more; then it is replaced.
. "$SCENARIOS/guest.sh"
links &
plug stall=25
until [ -e /dev/v4l/by-id/usb-Replay_camera-video-index0 ]; do sleep .1; done
config 'device = "/dev/v4l/by-id/usb-Replay_camera-video-index0"'
start run
until_line events '"event":"stale"'
until_line events 'gave no picture'
until_line events '"again":true' 2
kill $rig; sleep 1; plug
until_line events '"event":"resumed"'
until_line poses '"sequence"' $(($(wc -l <poses) + 2))
finish
cat log events
