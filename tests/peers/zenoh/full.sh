#!/usr/bin/env bash
# Teams over the transport `zenoh` through a real Zenoh router, on `udp/` and on encrypted `quic/`, beside UDP multicast at the same
# loss: whole episodes, delivery, a router that is killed for 2 s, and `stop` and `doctor` from a machine of their own. Exit code 1
# if a bar is missed.
#
#   bash tests/peers/zenoh/full.sh PYTHON MURMURATE [EPISODES]
#
# PYTHON has eclipse-zenoh and mcap, MURMURATE the feature `zenoh`. Needs root, `ip` and `nft`. On Zenoh, 20 % of all packets from
# the hosts to the router are lost; on multicast, 20 % of all packets to each host. So every message meets the same loss once.
# Everything is removed at the end, also on Ctrl-C.
set -euo pipefail
here=$(realpath "$(dirname "$0")")
python=$1 program=$(realpath "$2") episodes=${3:-16} missed=0
router_at=10.83.0.1 port=7447 quic_port=7448 loss=20
work=$(mktemp -d)
spaces=() router= launch=

end() {
    [ -z "$launch" ] || { kill "$launch" 2>/dev/null && wait "$launch" || true; }
    [ -z "$router" ] || kill -9 "$router" 2>/dev/null || true
    for space in "${spaces[@]}"; do ip netns del "zn-$space" 2>/dev/null || true; done
    rm -rf "$work"
}
trap end EXIT
trap 'exit 130' INT TERM

miss() {
    echo "MISSED: $*"
    missed=1
}

# A namespace with an interface zn0 on the bridge.
machine() { # NAME ADDRESS
    spaces+=("$1")
    ip netns add "zn-$1"
    ip -n "zn-$1" link set lo up
    ip -n "zn-$1" link add zn0 type veth peer name "zn${#spaces[@]}" netns zn-air
    ip -n zn-air link set "zn${#spaces[@]}" master bridge up
    ip -n "zn-$1" addr add "$2/24" dev zn0
    ip -n "zn-$1" link set zn0 up
    ip -n "zn-$1" route add 224.0.0.0/4 dev zn0
}

build() {
    spaces+=(air)
    ip netns add zn-air
    ip -n zn-air link add bridge type bridge mcast_snooping 0
    ip -n zn-air link set bridge up
    machine router $router_at
    local number=9 host
    for host in world robot-{0..4} agent-{0..4} laptop; do
        number=$((number + 1))
        machine "$host" "10.83.0.$number"
    done
    # The kernel reports a carrier up to a second late.
    sleep 1.5
}

# Loses so many percent of the UDP packets that come into a namespace.
lossy() { # PERCENT NAMESPACE...
    local percent=$1 space
    shift
    for space in "$@"; do
        ip netns exec "zn-$space" nft flush ruleset
        [ "$percent" = 0 ] || ip netns exec "zn-$space" nft "table netdev loss { chain in {
            type filter hook ingress device zn0 priority 0; meta l4proto udp counter
            meta l4proto udp numgen random mod 100 < $percent counter drop; }; }"
    done
}

# Says how many packets were lost in some namespaces, of how many.
losses() { # NAMESPACE...
    local space
    for space in "$@"; do ip netns exec "zn-$space" nft list ruleset; done |
        awk '$2 == "l4proto" { drop = /drop/; for (i = 1; i < NF; i++) if ($i == "packets") n[drop] += $(i + 1) }
            END { printf "%d of %d packets were lost (%.1f %%)\n", n[1], n[0], n[0] ? 100 * n[1] / n[0] : 0 }'
}

# A certificate of the router's address, signed by an authority of its own, and Zenoh's configuration files with them.
certify() {
    cd "$work"
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=authority \
        -keyout authority.key -out authority.pem
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=router -keyout router.key -out router.csr
    openssl x509 -req -in router.csr -CA authority.pem -CAkey authority.key -days 2 -out router.pem \
        -extfile <(echo "subjectAltName = IP:$router_at")
    cat >router.json5 <<END
{ transport: { link: { tls: { listen_private_key: "$work/router.key", listen_certificate: "$work/router.pem" } } } }
END
    cat >client.json5 <<END
{ transport: { link: { tls: { root_ca_certificate: "$work/authority.pem" } } } }
END
    cd - >/dev/null
}

start_router() {
    nice -n -15 ip netns exec zn-router "$python" "$here/router.py" "$work/router.json5" \
        "udp/$router_at:$port" "quic/$router_at:$quic_port?mixed_rel=1" >"$work/router.log" 2>&1 &
    router=$!
}

# A team file in a mode, by a transport.
team() { # MODE TRANSPORT LINK...
    local mode=$1 transport=$2 number=0 link
    shift 2
    echo "team = 83"
    echo 'key_file = "team.key"'
    echo "mode = \"$mode\""
    echo "seed = 7"
    for link in "$@"; do
        number=$((number + 1))
        echo "[link.$link]"
        case $transport in
        zenoh) echo 'transport = "zenoh"' && echo "connect = \"udp/$router_at:$port\"" ;;
        quic)
            echo 'transport = "zenoh"' && echo 'config = "client.json5"'
            echo "connect = \"quic/$router_at:$quic_port?mixed_rel=1\""
            ;;
        multicast) echo 'interface = "zn0"' && echo "group = \"239.255.83.$number:7783\"" ;;
        esac
    done
}

begin() { # NAME FLAG...
    local name=$1
    shift
    "$program" launch "$work/$name.toml" --through "nice -n -15 ip netns exec zn-{host}" --record "$work/$name" --json "$@" \
        >"$work/$name.json" 2>"$work/$name.log" &
    launch=$!
}

finish() { # NAME
    local status=0
    wait "$launch" || status=$?
    launch=
    [ "$status" = 0 ] || { tail -5 "$work/$1.log"; miss "$1 ended with exit code $status"; }
}

field() { # NAME FIELD
    "$python" -c 'import json, sys; print(json.load(open(sys.argv[1]))[sys.argv[2]])' "$work/$1.json" "$2"
}

# Whole episodes of one mode on one transport. Prints why episodes were aborted.
episodes() { # MODE TRANSPORT LINK...
    local mode=$1 transport=$2
    shift 2
    local name=$mode-$transport
    team "$mode" "$transport" "$@" >"$work/$name.toml"
    local lossy=(router)
    [ "$transport" != multicast ] || lossy=(world robot-{0..4} agent-{0..4})
    lossy $loss "${lossy[@]}"
    begin "$name" --set "episodes=$episodes"
    finish "$name"
    losses "${lossy[@]}"
    lossy 0 "${lossy[@]}"
    echo "$mode over $transport, $loss % lost: $(field "$name" successes) of $episodes succeed," \
        "$(field "$name" aborted) aborted, makespan $(field "$name" makespan_median_s) s"
    grep -o 'the episode is aborted: .*' "$work/$name.log" || true
    "$python" "$here/figures.py" delivery "$program" "$work/$name" || miss "$name: no latents"
}

# Misses if more episodes of a mode were aborted on a transport than on multicast.
no_more_aborts() { # MODE TRANSPORT
    local extra=$(($(field "$1-$2" aborted) - $(field "$1-multicast" aborted)))
    [ "$extra" -le 0 ] || miss "$1: $extra more episodes aborted on $2 than on multicast"
}

# Whole episodes of one mode, on multicast and on Zenoh's `udp/`.
compare() { # MODE LINK...
    local mode=$1
    shift
    episodes "$mode" multicast "$@"
    episodes "$mode" zenoh "$@"
    no_more_aborts "$mode" zenoh
}

# Waits until a team has finished so many episodes.
results() { # NAME COUNT
    local tries=0
    until [ "$(grep -c '^episode' "$work/$1.log")" -ge "$2" ]; do
        tries=$((tries + 1))
        [ $tries -lt 600 ] || { tail -5 "$work/$1.log"; miss "$1 has no $2 results"; return 1; }
        sleep 0.1
    done
}

outage() {
    local name=outage begins ends
    team onboard-infra zenoh infra wires >"$work/$name.toml"
    begin "$name" --set episodes=4
    results $name 1 || return 0
    # A few seconds into the second episode.
    sleep 4
    kill -9 "$router"
    begins=$(date +%s.%N)
    wait "$router" 2>/dev/null || true
    sleep 2
    start_router
    ends=$(date +%s.%N)
    finish $name
    echo "router killed for 2 s: $(field $name successes) of 4 episodes succeed, $(field $name aborted) aborted"
    # Whether an episode succeeds is the policy's matter; that it ends by itself is the network's.
    [ "$(field $name aborted)" -le 1 ] || miss "the team does not go on after the router is back"
    "$python" "$here/figures.py" outage "$program" "$work/$name" "$begins" "$ends" || missed=1
}

operators() {
    local name=operators
    team onboard-infra zenoh infra wires >"$work/$name.toml"
    lossy $loss router
    begin "$name" --set episodes=100
    results $name 1 || return 0
    echo "doctor, of a laptop at $loss % loss:"
    ip netns exec zn-laptop "$program" doctor "$work/$name.toml" --robot 2 --listen 3 >"$work/doctor.log" 2>&1 ||
        miss "doctor has failed"
    grep -i "zenoh" "$work/doctor.log" || miss "doctor says nothing about Zenoh"
    [ "$(grep -c 'there and back' "$work/doctor.log")" -ge 5 ] || miss "doctor does not hear the hosts"
    local order
    for order in "stop" "stop --rearm" "resume"; do
        local before after
        before=$(date +%s%N)
        # shellcheck disable=SC2086 # Flags are words.
        ip netns exec zn-laptop "$program" $order "$work/$name.toml" --wait 15 >"$work/order.log" 2>&1 || {
            tail -3 "$work/order.log"
            miss "$order"
        }
        after=$(date +%s%N)
        echo "$order: $(((after - before) / 1000000)) ms: $(tail -1 "$work/order.log")"
    done
    kill "$launch"
    wait "$launch" || true
    launch=
    lossy 0 router
}

build
"$program" key new --out "$work/team.key" >/dev/null 2>&1
certify >"$work/certify.log" 2>&1
start_router
compare offboard loopback infra
compare onboard-infra infra wires
outage
operators
# The same, encrypted.
episodes onboard-infra quic infra wires
no_more_aborts onboard-infra quic
exit $missed
