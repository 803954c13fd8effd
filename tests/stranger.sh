#!/usr/bin/env bash
# Builds the crate in tests/stranger/, which uses this one from outside, and runs what it adds through the command line.
#
#   bash tests/stranger.sh            a release build, in the same target folder
#   bash tests/stranger.sh dev        one without optimising, which shares what the tests have built
set -euo pipefail
cd "$(dirname "$0")/.."
profile=${1:-release}
folder=${profile/dev/debug}

cargo build --locked --profile "$profile" --quiet --package stranger
cargo test --locked --profile "$profile" --quiet --package stranger
program=${CARGO_TARGET_DIR:-target}/$folder/stranger

has() { # TEXT WORD...: refuses a text that lacks one of the words
    local text=$1 word
    shift
    for word in "$@"; do
        case $text in *"$word"*) ;; *) printf 'not there: %s\n%s\n' "$word" "$text" >&2 && exit 1 ;; esac
    done
}

has "$("$program" --help)" 'Usage: stranger'
has "$("$program" sim --help)" round spread give-way glide mpe passage orca rigid
has "$("$program" train --help)" round passage
own=(sim --mode offboard --scenario round --policy give-way --plant glide)
result=$("$program" "${own[@]}" --episodes 2 --repeats 1 --quiet --json)
has "$result" '"scenario":"round"' '"policy":"give-way"' '"successes":2'
# Each also with entries of this crate.
has "$("$program" sim --scenario round --episodes 1 --repeats 1 --quiet)" 'policy orca' '1 of 1'
has "$("$program" sim --plant glide --policy give-way --robots 3 --episodes 1 --repeats 1 --quiet)" 'scenario passage'
# A wrong name is refused with a list of all names.
has "$("$program" sim --scenario square --quiet 2>&1 || true)" square round passage

# JaxMARL's recurrent team, whose robots have ids: docs/others.md has its return.
spread=(sim --mode sim --scenario spread --plant mpe --policy examples/others/jaxmarl/spread.policy.toml)
has "$("$program" "${spread[@]}" --episodes 100 --repeats 1 --quiet --json)" 'lack of reward' '"completed":100'
has "$("$program" sim --scenario swap --policy examples/others/jaxmarl/spread.policy.toml --quiet 2>&1 || true)" \
    "its input 'id' tells 3 robots apart, and the team has 8"

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
# A policy of format 3 takes the channel of the crate's scenario, which no other scenario has.
cp tests/onnx/data/field-*.onnx "$folder"
sed 's/"goal-minus-position"/"chord"/' tests/onnx/data/field.policy.toml >"$folder/chord.policy.toml"
has "$("$program" sim --scenario round --policy "$folder/chord.policy.toml" --episodes 1 --repeats 1 --quiet)" '1 of 1'
has "$("$program" sim --policy "$folder/chord.policy.toml" --quiet 2>&1 || true)" "there is no channel 'chord' here"
# A policy takes the crate's sense, and another kind of sense is refused with a list of all.
printf '[senses.crowd]\nkind = "crowd"\nradius_m = 1.0\n' >"$folder/senses.toml"
has "$("$program" sim --senses "$folder/senses.toml" --policy give-way --episodes 1 --repeats 1 --quiet)" 'of 1'
has "$("$program" sim --senses "$folder/senses.toml" --policy tests/onnx/data/lidar.policy.toml --quiet 2>&1 || true)" \
    "there is no channel 'lidar' here" crowd
printf '[senses.crowd]\nkind = "nose"\n' >"$folder/senses.toml"
has "$("$program" sim --senses "$folder/senses.toml" --quiet 2>&1 || true)" "no kind of sense 'nose'" lidar program crowd
cat >"$folder/team.toml" <<'TOML'
team = 77
mode = "centralized"
scenario = "round"
policy = "give-way"
plant = "glide"
robots = 3
episodes = 1
TOML
team=("$folder/team.toml" --interface lo)
has "$("$program" config check "${team[@]}" 2>/dev/null)" valid
has "$("$program" launch "${team[@]}" --json --quiet 2>/dev/null)" '"scenario":"round"' '"successes":1'

# One robot that is not simulated, on one host, with the driver and the source of the crate. Two episodes that time out
# would take 50 s.
cat >"$folder/robot.toml" <<'TOML'
team = 78
scenario = "round"
policy = "give-way"
episodes = 2

[deployment]
mode = "bench"
robots = 1
placement = "drive"
stepping = "seeded"

[[deployment.host]]
name = "robot"
agents = [[0]]
actuates = [0]
localizes = [0]
state_server = true
driver = { name = "datagrams", robot = "127.0.0.1:7781" }
source = { name = "bench", listens = "127.0.0.1:7781", begins = [0.5, 0.5] }
TOML
has "$("$program" config check "$folder/robot.toml")" 'mode bench'
# No World simulates it, so its verdicts come from readings.
has "$(timeout 40 "$program" host "$folder/robot.toml" --host robot --json)" '"event":"finished"' \
    '"event":"episode"' '"episode":1' '"verdict":"success"' '"judged":"readings"' '"oldest_command_s":null'

"$program" study delay --scenario round --policy give-way --layouts 1 --repeats 1 --delays-ms 0 --losses 0 \
    --out "$folder/study" --quiet >/dev/null
"$program" train round --steps 20000 --out "$folder/trained" --quiet >/dev/null
has "$("$program" sim --scenario round --policy "$folder/trained/policy.safetensors" --episodes 1 --repeats 1 --quiet)" \
    'scenario round'
echo "a scenario, a policy, a plant, a driver and a source from another crate: sim, launch, host, study and train have them"
