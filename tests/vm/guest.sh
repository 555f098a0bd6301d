# What every scenario in the guest begins with. $STAGEPOSE, $RIG (folder of the rig's programs) and $MEDIA are given.
set -u
cd /run
mkfifo never
exec 8<>never
# Waits and looks are the shell's own: in here a new process costs as much as a frame.
nap() { read -rt "$1" -u 8; }
PATH=$RIG:$PATH
cp "$MEDIA"/{stage.toml,camera.toml,backdrop.png,flat.png} .
# The guest is slow, and frames more than half a second apart do not confirm each other.
printf '\n[tracker]\nfeatures = 150\n' >>stage.toml

# As udev would: keeps the by-id link on the camera, under whatever number it has.
links() {
    local class index
    mkdir -p /dev/v4l/by-id
    while true; do
        nap .1
        for class in /sys/class/video4linux/video*; do
            { read -r index <"$class/index"; } 2>/dev/null && [ "$index" = 0 ] && [ -c "/dev/${class##*/}" ] || continue
            [ "$by_id" -ef "/dev/${class##*/}" ] || ln -sfn "../../${class##*/}" "$by_id"
        done
    done
}
by_id=/dev/v4l/by-id/usb-Replay_camera-video-index0

plug() { uvcam 320x180 5 MJPG="$MEDIA/slow.mjpeg" YUYV="$MEDIA/slow.yuyv" "$@" 2>>rig.log & rig=$!; }

count() { # count FILE PATTERN: its lines with this pattern (an extended regular expression)
    local line
    lines=0
    [ ! -e "$1" ] || while read -r line; do [[ $line =~ $2 ]] && lines=$((lines + 1)); done <"$1"
}

# until_line FILE PATTERN [MORE]: waits for so many lines (1); the scenario ends where they do not come.
until_line() {
    local deadline=$((SECONDS + 90))
    until count "$1" "$2"; [ "$lines" -ge "${3:-1}" ]; do
        [ $SECONDS -lt $deadline ] || { echo "NEVER CAME: $2 in $1"; cat log events; exit 9; }
        nap .3
    done
    echo "+ $SECONDS s: $2"
}

# more FILE PATTERN N: waits for N more of these lines than there are now.
more() { count "$1" "$2"; until_line "$1" "$2" $((lines + $3)); }

config() { sed -i "s#^calibration.*#&\n$1#" stage.toml; }

# start COMMAND…: stagepose in the background with its events and records.
start() { "$STAGEPOSE" "$@" --config stage.toml --events events --poses poses --log info 2>>log & pid=$!; }

# finish: ends it as a service manager does.
finish() { kill -TERM $pid; wait $pid; echo "exit $?"; count log panicked; echo "panics $lines"; }
