#!/usr/bin/env bash
# Installs the Debian package in bare roots of Debian 12 and 13 and runs the program there.
#
#   tests/packaging/install.sh target/deb/stagepose_*.deb [FOLDER] [SUITE…]
#
# Needs root and mmdebstrap (.ci/setup installs it). The roots are kept below FOLDER and reused.
set -euo pipefail
deb=$(realpath "$1")
folder=${2:-target/roots}
shift $(($# < 2 ? $# : 2))
suites=("$@")
[ ${#suites[@]} -gt 0 ] || suites=(bookworm trixie)
mkdir -p "$folder"

mounted=
leave() { [ -z "$mounted" ] || umount -l "$mounted"; }
trap leave EXIT

for suite in "${suites[@]}"; do
    bare=$folder/$suite.tar
    if [ ! -e "$bare" ]; then
        # Packages are fetched as root, not as _apt, because that user cannot write to /dev/null on
        # every machine.
        mmdebstrap --variant=minbase --aptopt='APT::Sandbox::User "root"' "$suite" "$bare.new.tar" >"$folder/$suite.log" 2>&1 ||
            { tail -n 20 "$folder/$suite.log" >&2; echo "install.sh: no bare root of $suite can be made" >&2; exit 1; }
        mv "$bare.new.tar" "$bare"
    fi
    # Starts from the bare root again, whatever the last run installed.
    root=$folder/$suite
    rm -rf "$root" && mkdir "$root" && tar -C "$root" -xf "$bare"
    cp "$deb" "$root/stagepose.deb"
    [ ! -e /etc/resolv.conf ] || cp -L /etc/resolv.conf "$root/etc/resolv.conf"
    # The root uses this machine's way to packages (a proxy) too.
    apt-config dump | grep -E '^Acquire::(http|https)::' >"$root/etc/apt/apt.conf.d/00host" || true
    mount -t proc proc "$root/proc" && mounted=$root/proc
    in_root() { chroot "$root" env DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 "$@"; }
    in_root apt-get update -q >/dev/null
    in_root apt-get install -y --no-install-recommends /stagepose.deb >"$folder/$suite-install.log" 2>&1 ||
        { tail -n 20 "$folder/$suite-install.log" >&2; echo "install.sh: it does not install on $suite" >&2; exit 1; }
    in_root stagepose --version
    in_root stagepose demo --frames 20 >"$folder/$suite-demo.log" ||
        { cat "$folder/$suite-demo.log" >&2; echo "install.sh: the demo fails on $suite" >&2; exit 1; }
    tail -n 3 "$folder/$suite-demo.log"
    for file in /usr/lib/systemd/system/stagepose.service /usr/lib/udev/rules.d/60-stagepose.rules \
        /usr/share/man/man1/stagepose-replay.1.gz /usr/share/bash-completion/completions/stagepose \
        /usr/share/zsh/vendor-completions/_stagepose /usr/share/fish/vendor_completions.d/stagepose.fish \
        /usr/share/doc/stagepose/examples/stage.toml /usr/share/doc/stagepose/config/stage.toml \
        /usr/share/doc/stagepose/docs/page.md; do
        [ -s "$root$file" ] || { echo "install.sh: $file is missing on $suite" >&2; exit 1; }
    done
    in_root apt-get remove -y stagepose >>"$folder/$suite-install.log" 2>&1
    [ ! -e "$root/usr/bin/stagepose" ] || { echo "install.sh: it does not go from $suite" >&2; exit 1; }
    umount "$mounted" && mounted=
    echo "$suite: installs, runs, goes"
done
