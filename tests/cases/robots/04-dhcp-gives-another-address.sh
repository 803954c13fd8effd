#!/usr/bin/env bash
# The address of a robot's interface changes while its team runs, or the interface goes and comes again, as with a USB Wi-Fi
# adapter. Expected: its links are opened again, it says so, and the team has further successful episodes, by multicast and by
# unicast.
#
#   bash 04-dhcp-gives-another-address.sh MURMURATE PYTHON
set -uo pipefail
murmurate=$1
source "$(dirname "${BASH_SOURCE[0]}")/lib_network.sh"
cd "$CASE_WORK" || exit 1
machines
for machine in 0 1 2; do
    interface $machine
    address $machine 10.77.0.1$machine/24
    up $machine
done

another_address() {
    ip -n "$tag-0" addr flush dev w0
    sleep 2
    address 0 10.77.0.55/24
}

at_once() {
    ip -n "$tag-0" addr flush dev w0
    address 0 10.77.0.66/24
}

replugged() {
    ip -n "$tag-0" link del w0
    sleep 3
    interface 0
    address 0 10.77.0.10/24
    up 0
}

# Runs the team, changes the interface, and checks that episodes succeed after it.
survives() { # TRANSPORT CHANGE
    local pid
    rm -f ./*.out ./*.log
    logs=()
    for name in robot-0 robot-1 pc; do host "$((${#logs[@]}))" "$name"; done
    within 60 more_than 0 || fail "$1: no episode succeeds"
    "$2"
    within 10 said robot-0 "the link is open again" || fail "$1, $2: it does not say that its link is open again"
    within 5 grep -q '"event":"link","link":"infra","open":true' robot-0.out || fail "$1, $2: there is no event"
    within 90 more_than $(($(successes) + 1)) || fail "$1, $2: no further episode succeeds"
    for pid in "${hosts[@]}"; do kill "$pid" 2>/dev/null; wait "$pid"; done
    hosts=()
}

team <<<'interface = "w0"'
survives multicast another_address
survives multicast at_once
survives multicast replugged
team <<'END'
interface = "w0"
transport = "unicast"
[link.infra.peers]
robot-0 = "10.77.0.10:7700"
robot-1 = "10.77.0.11:7700"
pc = "10.77.0.12:7700"
END
survives unicast another_address
# From here on, robot 0 starts at another address than the team's file has for it.
survives unicast at_once
survives unicast replugged
echo "all teams go on"
