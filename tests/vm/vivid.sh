# The test driver: a fatal driver error, a camera taken away and given back, one that another program holds.
. "$SCENARIOS/guest.sh"
sed -i 's/^width = .*/width = 640/; s/^height = .*/height = 360/' camera.toml
config 'device = "0"'
start run
until_line events '"event":"camera_opened"'
until_line poses '"sequence"' 2
camprobe raw-set 0 f0f046 1               # fatal error
until_line events '"again":true'
until_line poses '"sequence"' 4
cd /sys/bus/platform/drivers/vivid; echo vivid.0 >unbind; cd /run
until_line events '"event":"camera_waiting"'
echo vivid.0 >/sys/bus/platform/drivers/vivid/bind
until_line events '"again":true' 2
finish
camprobe grab 0 640x360 YUYV 25 100000 >/dev/null & grab=$!
sleep 2
start run
until_line log 'in use by camprobe'
kill $grab
until_line events '"event":"camera_opened"'
finish
cat log events
