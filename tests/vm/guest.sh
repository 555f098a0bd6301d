# What every scenario in the guest begins with. $STAGEPOSE, $RIG (folder of the rig's programs) and $MEDIA are given.
set -u
cd /run
PATH=$RIG:$PATH
cp "$MEDIA"/{stage.toml,camera.toml,backdrop.png,flat.png} .
# The guest is slow, and frames more than half a second apart do not confirm each other.
printf '\n[tracker]\nfeatures = 150\n' >>stage.toml

# As udev would: keeps the by-id link on the camera, under whatever number it has.
links() {
    mkdir -p /dev/v4l/by-id
    while sleep .1; do
        for class in /sys/class/video4linux/video*; do
            [ "$(cat "$class/index" 2>/dev/null)" = 0 ] || continue
            [ -c "/dev/${class##*/}" ] && ln -sfn "../../${class##*/}" /dev/v4l/by-id/usb-Replay_camera-video-index0
        done
    done
}

plug() { uvcam 320x180 5 MJPG="$MEDIA/still.mjpeg" YUYV="$MEDIA/still.yuyv" "$@" 2>>rig.log & rig=$!; }

# until_line FILE PATTERN [COUNT]: waits for so many lines (1); the scenario ends where they do not come.
until_line() {
    local n=0
    until [ "$(cat "$1" 2>/dev/null | grep -cE "$2")" -ge "${3:-1}" ]; do
        n=$((n + 1))
        [ $n -lt 400 ] || { echo "NEVER CAME: $2 in $1"; tail -n 20 "$1" log; exit 9; }
        sleep .2
    done
}

config() { sed -i "s#^calibration.*#&\n$1#" stage.toml; }

# start COMMAND…: stagepose in the background with its events and records.
start() { "$STAGEPOSE" "$@" --config stage.toml --events events --poses poses --log info 2>>log & pid=$!; }

# finish: ends it as a service manager does.
finish() { kill -TERM $pid; wait $pid; echo "exit $?"; grep -c panicked log | sed 's/^/panics /'; }
