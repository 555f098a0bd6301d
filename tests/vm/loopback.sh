# What another program writes into v4l2loopback: YUYV from a file.
. "$SCENARIOS/guest.sh"
loopfeed /dev/video9 320x180 YUYV 5 100000 "$MEDIA/still.yuyv" 2>>rig.log &
sleep 1
config 'device = "/dev/video9"'
start run
until_line poses '"sequence"' 3
finish
cat log events
