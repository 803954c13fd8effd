# Machines as network namespaces on one bridge, and a team of two robots and a PC on the first three. For cases of addresses
# and interfaces; wants root and ip. Sourced with the program in $murmurate; $CASE_WORK is an empty folder. As a program it
# runs one of its functions: bash lib_network.sh TAG FUNCTION ARGUMENT...
tag=cn$$
logs=()
hosts=()

spaces_end() {
    local pid
    for pid in "${hosts[@]}"; do kill "$pid" 2>/dev/null; done
    for pid in "${hosts[@]}"; do wait "$pid" 2>/dev/null; done
    for name in 0 1 2 3 air; do ip netns del "$tag-$name" 2>/dev/null; done
}

fail() {
    echo "$*"
    for log in "${logs[@]}"; do echo "-- $log"; tail -n 5 "$log"; done
    exit 1
}

# Runs a command on machine 0, 1 or 2, such as: on 0 ip link show.
on() {
    local machine=$1
    shift
    ip netns exec "$tag-$machine" "$@"
}

machines() { # [COUNT]
    local machine
    ip netns add "$tag-air" || fail "network namespaces need root and ip"
    ip -n "$tag-air" link add bridge type bridge mcast_snooping 0
    ip -n "$tag-air" link set bridge up
    for ((machine = 0; machine < ${1:-3}; machine++)); do
        ip netns add "$tag-$machine"
        ip -n "$tag-$machine" link set lo up
    done
}

# Makes the interface w0 of a machine, down and without an address.
interface() { # MACHINE
    ip -n "$tag-$1" link add w0 type veth peer name "port$1" netns "$tag-air"
    ip -n "$tag-air" link set "port$1" master bridge up
}

address() { # MACHINE ADDRESS/PREFIX
    ip -n "$tag-$1" addr add "$2" dev w0
}

up() { # MACHINE
    ip -n "$tag-$1" link set w0 up
}

# Writes team.toml in the folder $CASE_WORK, with this table of the link as its input and $episodes, and the team's key.
team() {
    local work=$CASE_WORK
    [ -e "$work/team.key" ] || "$murmurate" key new --out "$work/team.key" >/dev/null
    {
        cat <<END
team = 74
scenario = "swap"
policy = "orca"
episodes = ${episodes:-300}
key_file = "team.key"
[link.infra]
END
        cat
        cat <<END
[deployment]
mode = "lab"
robots = 2
placement = "drive"
stepping = "seeded"
plant = "kinematic"
[[deployment.host]]
name = "robot-0"
agents = [[0]]
simulates = [0]
[[deployment.host]]
name = "robot-1"
agents = [[1]]
simulates = [1]
[[deployment.host]]
name = "pc"
state_server = true
[[deployment.link]]
name = "infra"
carries = ["reading", "latent", "heartbeat", "mode", "stop"]
END
    } >"$work/team.toml"
}

# Starts a host on a machine; its events go to NAME.out and its log to NAME.log.
host() { # MACHINE NAME
    # exec, so that a signal reaches the host itself.
    (cd "$CASE_WORK" && MURMURATE_LOG=warn exec ip netns exec "$tag-$1" "$murmurate" host team.toml --host "$2" --json \
        >"$2.out" 2>"$2.log") &
    hosts+=($!)
    logs+=("$CASE_WORK/$2.log")
}

# Waits until a command succeeds; fails after so many seconds.
within() { # SECONDS COMMAND...
    local end=$(($(date +%s%N) + $1 * 1000000000))
    shift
    until "$@" >/dev/null 2>&1; do
        [ "$(date +%s%N)" -lt $end ] || return 1
        sleep 0.05
    done
}

said() { # NAME TEXT: whether the log of a host has a text
    grep -qF "$2" "$CASE_WORK/$1.log"
}

ready() { # NAME
    grep -q '"event":"ready"' "$CASE_WORK/$1.out"
}

# Number of successful episodes so far.
successes() {
    grep '"event":"episode"' "$CASE_WORK/pc.out" | grep -c '"success"'
}

more_than() { # COUNT
    [ "$(successes)" -gt "$1" ]
}

if [ "${BASH_SOURCE[0]}" = "$0" ]; then
    tag=$1
    shift
    "$@"
else
    trap spaces_end EXIT
fi
