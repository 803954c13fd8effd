# Shared by the cases of records: a team's records, and one of them damaged by damage.py of this folder.
program=$1 python=$2 here=$(cd "$(dirname "$0")" && pwd)
cd "${CASE_WORK:?}"

fail() { echo "$*"; exit 1; }

# Runs a command, with its output in $said and its exit code in $code.
try() { code=0; said=$("$@" 2>&1) || code=$?; }

# Records of a team of its own on loopback: one episode, into the folder `team`. NUMBER keeps cases apart.
record() { # NUMBER
    printf 'team = 4%s\nmode = "offboard"\nrobots = 3\nepisodes = 1\n' "$1" >team.toml
    for link in loopback:1 infra:2; do
        printf '[link.%s]\ninterface = "lo"\ngroup = "239.255.94.%s:4%s"\n' "${link%:*}" "${link#*:}" "$1" >>team.toml
    done
    try "$program" launch team.toml --quiet --record team
    [ $code = 0 ] || fail "launch: $said"
    world=$(ls team/world-*.mcap)
}

damage() { "$python" "$here/lib_damage.py" "$@" || fail "lib_damage.py $*"; }
