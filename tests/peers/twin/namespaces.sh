# Network namespaces for the hosts of a team, joined by a relay. Sourced; needs root and `ip`.
#
# tw_build HOST...      makes a namespace tw-HOST for each, with an interface tw0, and tw-air for the relay
# tw_relay DELAY LOSS   starts the relay, in milliseconds and as a share of 1
# tw_remove             ends the relay and removes everything

tw_hosts=() tw_relay_id=

tw_build() {
    local host number=0
    ip netns add tw-air
    for host in "$@"; do
        number=$((number + 1))
        tw_hosts+=("$host")
        ip netns add "tw-$host"
        ip -n "tw-$host" link set lo up
        ip -n "tw-$host" link add tw0 type veth peer name "tw$number" netns tw-air
        ip -n "tw-$host" addr add "10.81.0.$((9 + number))/24" dev tw0
        ip -n "tw-$host" link set tw0 up
        ip -n "tw-$host" route add 224.0.0.0/4 dev tw0
        ip -n tw-air link set "tw$number" up promisc on
    done
}

tw_relay() { # DELAY_MS LOSS
    local ports=() number folder ready
    for number in $(seq ${#tw_hosts[@]}); do ports+=("tw$number"); done
    folder=$(dirname "${BASH_SOURCE[0]}")
    coproc tw_relay_process { exec nice -n -15 ip netns exec tw-air python3 "$folder/relay.py" "$1" "$2" 7 "${ports[@]}"; }
    tw_relay_id=$tw_relay_process_PID
    read -r ready <&"${tw_relay_process[0]}"
    [ "$ready" = ready ]
}

tw_remove() {
    local host
    [ -z "$tw_relay_id" ] || kill "$tw_relay_id" 2>/dev/null || true
    for host in air "${tw_hosts[@]}"; do ip netns del "tw-$host" 2>/dev/null || true; done
    tw_hosts=() tw_relay_id=
}
