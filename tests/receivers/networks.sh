#!/usr/bin/env bash
# Broadcast, multicast and an unreachable host, in network namespaces of this script: nothing leaves
# the machine.
#   networks.sh STAGEPOSE OUT
# A veth pair joins two namespaces; the sender is in one, `stagepose listen` in the other. Skipped
# with a loud message if the system does not allow namespaces.
set -euo pipefail
stagepose=$(realpath "$1")
out=$2
mkdir -p "$out"

skip() {
    cat >&2 <<EOF

**********************************************************************************
** NOT RUN: broadcast, multicast and unreachable hosts. $1
** It needs root, ip and unshare (packages iproute2, util-linux).
**********************************************************************************
EOF
    exit 0
}

command -v ip >/dev/null && command -v unshare >/dev/null || skip "ip or unshare is missing."
if [ "${STAGEPOSE_NAMESPACE:-}" != inside ]; then
    unshare --net --mount true 2>/dev/null || skip "This user may not make network namespaces."
    # A mount namespace hides the named namespaces below from everything else; all of it ends with
    # this process.
    exec env STAGEPOSE_NAMESPACE=inside unshare --net --mount --pid --fork --kill-child "$0" "$stagepose" "$out"
fi

mount -t tmpfs none /run 2>/dev/null || skip "Mounting is not allowed here."
ip netns add stage 2>/dev/null || skip "ip netns is not allowed here."
ip link add studio0 type veth peer name stage0 netns stage || skip "veth is not there."
ip addr add 10.77.0.1/24 broadcast 10.77.0.255 dev studio0
ip link set studio0 up
ip link set lo up
ip -n stage addr add 10.77.0.2/24 broadcast 10.77.0.255 dev stage0
ip -n stage link set stage0 up
ip -n stage link set lo up
# Without duplicate address detection, IPv6 addresses are usable at once.
ip addr add fd77::1/64 dev studio0 nodad
ip -n stage addr add fd77::2/64 dev stage0 nodad
for _ in $(seq 50); do
    ping -c 1 -W 1 10.77.0.2 >/dev/null 2>&1 && break
    sleep 0.1
done

cat >"$out/networks.toml" <<'EOF'
[[output]]
kind = "freed"
name = "broadcast"
to = ["10.77.0.255:40001", "255.255.255.255:40002"]
[[output]]
kind = "psn"
name = "multicast"
to = ["236.10.10.10:56565"]
interface = "10.77.0.1"
[[output]]
kind = "opentrackio"
name = "unreachable"
to = ["10.77.0.99:55555", "192.0.2.1:55555"]
[[output]]
kind = "osc"
name = "unicast"
to = ["10.77.0.2:53000"]
[[output]]
kind = "freed"
name = "IPv6"
to = ["[fd77::2]:40006", "[ff12::77]:40007"]
interface = "studio0"
EOF

declare -A heard
listen() { # NAME PROTOCOL PORT [MORE]
    local name=$1
    shift
    timeout 60 ip netns exec stage "$stagepose" listen "$@" --count 60 >"$out/$name.txt" &
    heard[$name]=$!
}
listen directed freed 40001
listen limited freed 40002
listen multicast psn 56565 --group 236.10.10.10 --interface 10.77.0.2
listen unicast osc 53000
listen unicast6 freed 40006
listen multicast6 freed 40007 --group ff12::77 --interface stage0
sleep 0.5

# The all-ones broadcast needs a route here; a real machine has a default route.
ip route add 255.255.255.255 dev studio0 2>/dev/null || true
timeout 60 "$stagepose" send-test --config "$out/networks.toml" --seconds 4 --fps 30 --log info 2>"$out/sender.log"

failed=
for name in directed limited multicast unicast unicast6 multicast6; do
    if wait "${heard[$name]}" && [ "$(wc -l <"$out/$name.txt")" -eq 60 ] && ! grep -q ' bytes: ' "$out/$name.txt"; then
        echo "$name: 60 packets arrived: $(head -n 1 "$out/$name.txt" | cut -c 1-100)"
    else
        echo "$name: FAILED" && failed=yes
    fi
done
# Over a hundred packets could not be sent, but each of the two addresses is reported only once.
complaints=$(grep -c 'output unreachable: 1.* cannot be reached' "$out/sender.log" || true)
echo "unreachable: $complaints complaints for $(grep -o 'output unreachable: .*' "$out/sender.log" | tail -n 1)"
[ "$complaints" -ge 1 ] && [ "$complaints" -le 2 ] || failed=yes
[ -z "$failed" ]
