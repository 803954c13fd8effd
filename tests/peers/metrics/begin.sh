# The beginning of the scripts beside it, sourced with the program as $1: its path, a folder for the run, and an end that
# stops the processes in `pids`.
program=$(realpath "$1")
root=$(cd "$(dirname "$0")/../../.." && pwd)
for needed in prometheus promtool curl python3; do
    command -v "$needed" > /dev/null || { echo "$needed is missing: apt-get install prometheus curl python3" >&2; exit 2; }
done
work=$(mktemp -d)
pids=()
finish() {
    for pid in "${pids[@]}"; do kill -INT "$pid" 2> /dev/null || true; done
    wait || true
    rm -rf "$work"
}
trap finish EXIT
