# Shared by the cases of trackers, receivers and ROS robots: their teams, and `doctor` beside a fake of the device.
# Sourced with MURMURATE and PYTHON set; works in the empty folder $CASE_WORK.
set -uo pipefail
here=$(dirname "$(realpath "${BASH_SOURCE[0]}")")
program=$1 python=$2
cd "${CASE_WORK:?an empty folder}"
fakes=()
trap 'for fake in "${fakes[@]}"; do kill "$fake" 2>/dev/null; done' EXIT

fail() { # WHY [OUTPUT]
    echo "$1"
    [ $# -lt 2 ] || echo "$2"
    exit 1
}

# Writes a team of one PC whose NatNet source is the fake.
natnet_team() { # PORT
    cat >team.toml <<END
team = 73
scenario = "swap"
policy = "orca"
episodes = 1
robots = 2
[deployment]
mode = "bench"
robots = 2
placement = "drive"
stepping = "seeded"
[safety]
own_state_s = 1.0
[[deployment.host]]
name = "pc"
agents = [[0], [1]]
actuates = [0, 1]
localizes = [0, 1]
state_server = true
driver = { name = "program", command = ["sh", "-c", "cat > /dev/null"] }
source = { name = "natnet", server = "127.0.0.1", interface = "lo", group = "239.255.92.7", data_port = $1, command_port = $(($1 + 1)), rate_hz = 50.0 }
END
}

# Writes a team of two robots with receivers of their own; robot 0 has the fake. MORE are further settings of its source.
gpsd_team() { # PORT MORE
    cat >team.toml <<END
team = 72
scenario = "swap"
policy = "orca"
episodes = 1
robots = 2
[link.air]
interface = "lo"
group = "239.255.92.8:$(($1 + 1))"
[safety]
own_state_s = 1.0
[deployment]
mode = "gps"
robots = 2
placement = "drive"
stepping = "seeded"
[[deployment.host]]
name = "robot-0"
agents = [[0]]
actuates = [0]
localizes = [0]
driver = { name = "program", command = ["cat"] }
source = { name = "gpsd", address = "127.0.0.1:$1", origin_latitude_deg = 52.2053, origin_longitude_deg = 0.1218, $2 }
[[deployment.host]]
name = "robot-1"
agents = [[1]]
actuates = [1]
localizes = [1]
driver = { name = "program", command = ["cat"] }
source = { name = "gpsd", origin_latitude_deg = 52.2053, origin_longitude_deg = 0.1218 }
[[deployment.host]]
name = "pc"
state_server = true
[[deployment.link]]
name = "air"
carries = ["reading", "latent", "heartbeat", "mode", "stop"]
END
}

# Starts a fake in the background.
start() { # FAKE ARGUMENT...
    local fake=$1
    shift
    "$python" "$here/$fake" "$@" 2>fake.log &
    fakes+=($!)
}

stop_fakes() {
    for fake in "${fakes[@]}"; do kill "$fake" 2>/dev/null; wait "$fake" 2>/dev/null; done
    fakes=()
}

# Runs doctor for a host; its output is in $said, its exit code in $code.
doctor() { # FLAG...
    said=$(MURMURATE_LOG=off timeout 90 "$program" doctor team.toml "$@" 2>&1 </dev/null)
    code=$?
}

# Fails unless doctor has ended with CODE and a line of its output has all of the WORDs.
expect() { # SCENE CODE WORD...
    local scene=$1 wanted=$2 lines=$said
    shift 2
    [ "$code" = "$wanted" ] || fail "$scene: doctor ended with $code instead of $wanted" "$said"
    for word in "$@"; do lines=$(grep -F -- "$word" <<<"$lines") || fail "$scene: no line says: $*" "$said"; done
}

# Runs doctor for a host beside the fakes, ends them, and looks at what it says.
check() { # SCENE FLAG NUMBER SECONDS CODE WORD...
    doctor "$2" "$3" --listen "$4"
    stop_fakes
    expect "$1" "${@:5}"
}

# Waits until a fake listens.
listens() { # ADDRESS
    for _ in $(seq 100); do (echo >"/dev/tcp/$1/$port") 2>/dev/null && break; sleep 0.05; done
}

# Plays a scene of the tracker to doctor, and looks at what it says.
natnet() { # SCENE SECONDS CODE WORD...
    start lib_natnet.py "$1" "$port" $((port + 1)) 239.255.92.7
    check "$1" --host pc "${@:2}"
}

# Plays a scene of gpsd to doctor, and looks at what it says.
gpsd() { # SCENE SECONDS CODE WORD...
    start lib_gpsd.py "$1" "$port"
    listens 127.0.0.1
    check "$1" --robot 0 "${@:2}"
}

# Writes a team of one ROS robot with the namespace /r0, which is localized by its odometry.
ros_team() {
    cat >team.toml <<END
team = 75
scenario = "swap"
policy = "orca"
episodes = 1
[link.air]
interface = "lo"
[safety]
own_state_s = 1.0
[deployment]
mode = "ros"
robots = 2
placement = "drive"
stepping = "seeded"
[[deployment.host]]
name = "robot-0"
agents = [[0]]
actuates = [0]
localizes = [0]
driver = { name = "ros2", namespace = "/r0", interface = "lo", speed_m_s = 0.3, silence_s = 2.0 }
source = { name = "odometry" }
[[deployment.host]]
name = "robot-1"
agents = [[1]]
actuates = [1]
localizes = [1]
driver = { name = "ros2", namespace = "/r1", interface = "lo", speed_m_s = 0.3, silence_s = 2.0 }
source = { name = "ros2", topic = "/r0/pose", interface = "lo" }
[[deployment.host]]
name = "pc"
state_server = true
[[deployment.link]]
name = "air"
carries = ["reading", "latent", "heartbeat", "mode", "stop"]
END
}
