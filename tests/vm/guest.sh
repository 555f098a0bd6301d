# Every scenario in the guest starts with this. $STAGEPOSE, $RIG (folder of the rig's programs) and
# $MEDIA are set.
set -u
cd /run
mkfifo never
exec 8<>never
# Waiting and polling use shell builtins: in the guest, a new process costs as much as a frame.
nap() { read -rt "$1" -u 8; }
PATH=$RIG:$PATH
cp "$MEDIA"/{stage.toml,camera.toml,backdrop.png,flat.png} .
# The guest is slow, and frames more than half a second apart do not confirm each other.
printf '\n[tracker]\nfeatures = 150\n' >>stage.toml

# Like udev, keeps the by-id link and the by-path link on the camera, whatever number it has.
links() {
    local class index node link path pass=0
    mkdir -p /dev/v4l/by-{id,path}
    while true; do
        echo $((pass += 1)) >/run/pass
        nap .1
        for class in /sys/class/video4linux/video*; do
            node=/dev/${class##*/}
            { read -r index <"$class/index"; } 2>/dev/null && [ "$index" = 0 ] && [ -c "$node" ] || continue
            cd -P "$class/device" 2>/dev/null || continue
            path=$by_path${PWD##*-}-video-index0
            for link in /dev/v4l/by-path/*; do
                [ "$link" = "$path" ] || [ ! "$link" -ef "$node" ] || rm "$link"
            done
            for link in "$by_id" "$path"; do
                [ "$link" -ef "$node" ] || ln -sfn "../../${node##*/}" "$link"
            done
        done
    done
}
by_id=/dev/v4l/by-id/usb-Replay_camera-video-index0
by_path=/dev/v4l/by-path/platform-vhci_hcd.0-usb-0:

# ports FREE…: from now on, only these ports (from 0) accept a camera.
ports() {
    local kind number state rest
    umount "$ports" 2>/dev/null
    while read -r kind number state rest; do
        [[ $kind != hs || " $* " == *" $((10#$number)) "* ]] || state=006
        echo "$kind $number $state $rest"
    done <"$ports" >ports
    mount --bind ports "$ports"
}
ports=/sys/devices/platform/vhci_hcd.0/status

plug() { uvcam 192x108 5 MJPG="$MEDIA/slow.mjpeg" YUYV="$MEDIA/slow.yuyv" "$@" 2>>rig.log & rig=$!; }

# Unplugs the camera and, like udev, removes its links before another camera can take the number.
# The pass that is under way may have seen the camera and create its links again, which would lead
# to the next camera; only the pass after it certainly has not.
unplug() {
    local before now
    kill $rig
    while [ -e "$by_id" ]; do nap .1; done
    until read -r before </run/pass; do :; done
    until read -r now </run/pass && [ "$now" -gt "$before" ]; do nap .1; done
    rm -f /dev/v4l/by-{id,path}/*
}

count() { # count FILE PATTERN: counts its lines that match this extended regular expression
    local line
    lines=0
    [ ! -e "$1" ] || while read -r line; do [[ $line =~ $2 ]] && lines=$((lines + 1)); done <"$1"
}

# until_line FILE PATTERN [MORE]: waits for this many matching lines (1); ends the scenario if they
# do not come.
until_line() {
    local deadline=$((SECONDS + 90))
    until count "$1" "$2"; [ "$lines" -ge "${3:-1}" ]; do
        [ $SECONDS -lt $deadline ] || { echo "NEVER CAME: $2 in $1"; cat log events; exit 9; }
        nap .3
    done
    echo "+ $SECONDS s: $2"
}

# more FILE PATTERN N: waits for N more matching lines than there are now.
more() { count "$1" "$2"; until_line "$1" "$2" $((lines + $3)); }

config() { sed -i "s#^calibration.*#&\n$1#" stage.toml; }

# start COMMAND…: runs stagepose in the background with its events and records.
start() { "$STAGEPOSE" "$@" --config stage.toml --events events --poses poses --log info 2>>log & pid=$!; }

# finish: ends it as a service manager does.
finish() {
    local begun=$SECONDS
    kill -TERM $pid
    wait $pid
    echo "exit $? after $((SECONDS - begun)) s"
    count log panicked
    echo "panics $lines"
}
