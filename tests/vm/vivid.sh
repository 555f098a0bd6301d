# The test driver: held by another program, a fatal driver error, removed and returned. Then
# v4l2loopback, into which another program writes YUYV from a file.
. "$SCENARIOS/guest.sh"
config 'device = "0"\nwidth = 320\nheight = 180'
camprobe grab 0 320x180 NV12 25 100000 >/dev/null & grab=$!
nap 2
start run
until_line log 'in use by camprobe'
kill $grab
until_line events '"event":"camera_opened"'
more poses '"sequence"' 2
camprobe raw-set 0 f0f046 1 # fatal error
until_line events '"event":"camera_lost"'
until_line events '"again":true'
more poses '"sequence"' 2
echo vivid.0 >/sys/bus/platform/drivers/vivid/unbind
until_line events '"event":"camera_waiting".*not plugged in'
echo vivid.0 >/sys/bus/platform/drivers/vivid/bind
until_line events '"again":true' 2
more poses '"sequence"' 2
finish
cat log events
rm poses events log

loopfeed /dev/video9 192x108 YUYV 5 100000 "$MEDIA/slow.yuyv" 2>>rig.log &
nap 1
sed -i 's/^device = .*/device = "9"/; /^width/d; /^height/d' stage.toml
start record looped
more poses '"sequence"' 3
finish
cat log events
count poses '"state":"tracking"'; echo "tracked $lines"
"$STAGEPOSE" replay looped --config looped/config/stage.toml --poses again >replayed && cmp again looped/poses.jsonl && echo "replay is the same"
