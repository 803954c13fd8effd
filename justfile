# Recipes for people who work on Murmurate. `just` lists them.

default:
    @just --list

# Format, lint and fast tests (a minute once dependencies are built)
check:
    cargo fmt --check
    cargo clippy --all-targets -- -D warnings
    cargo test --lib --test graph --test tidy

# What a change in a room needs (CONTRIBUTING.md has the rooms)
test room:
    bash .ci/room {{room}}

# A commit hook: format, and the house rules
hook:
    install -m 755 .ci/hook "$(git rev-parse --git-path hooks)/pre-commit"

# Every file of the packages, with the first sentence of what it says of itself
map:
    @for file in $(git ls-files 'src/*.rs' 'crates/*/src/*.rs'); do \
        printf '%-52s %s\n' "$file" "$(head -1 "$file" | cut -c5-)"; done

# Episodes of the passage in a preset mode (seconds)
sim mode="offboard" *flags:
    cargo run --release -- sim --mode {{mode}} {{flags}}

# Episodes with faults drawn from a seed (seconds)
faults seed mode="onboard-adhoc" *flags:
    cargo run --release -- sim --mode {{mode}} --seed {{seed}} --episodes 5 --repeats 1 --faults {{seed}} {{flags}}

# The emergency stop against every team file, at 20 % loss, 200 stops; relays, wrong clocks (40 minutes, root, apt: nftables faketime)
full-stop:
    TESTS_MUST="namespaces nft faketime" MURMURATE_STOPS=20 cargo test --release --test live stop:: -- --nocapture

# Links that choose: share and airtime beside fixed ways, 3 to 20 robots, and 10 minutes of changes (15 minutes)
full-auto:
    AUTO_FULL=1 cargo test --release --test link auto:: -- --nocapture --test-threads 2

# The safety filter under random and hostile policies: a million steps, 1000 episodes of each policy (5 minutes)
full-safety:
    MURMURATE_FILTER_STEPS=1000000 MURMURATE_FILTER_EPISODES=1000 cargo test --release --test graph filter:: -- --nocapture
    MURMURATE_LIAR_TRIALS=50 cargo test --release --test graph liars:: -- --nocapture

# A hundred kills of processes under `launch`, each started again (8 minutes)
full-kills:
    MURMURATE_RESTARTS=100 cargo test --release --test live restarts:: -- --nocapture

# One policy step, and whole trials (a minute)
bench:
    cargo bench

# Junk of every kind at a running team, at 30 000 and 100 000 datagrams a second (two minutes, wants an idle machine)
full-abuse:
    MURMURATE_JUNK=full cargo test --release --test live flooded:: -- --nocapture

# Hostile files and datagrams: 20 000 mutations of each kind, then every reader under fuzzing guided by coverage (40 minutes)
full-hostile:
    MURMURATE_MUTATIONS=20000 cargo test --release --test hostile -- --nocapture
    FUZZ_FEATURES="train mavlink" fuzz/run 1200

# The packages as a registry would have them, each built from its own tarball (20 minutes)
full-package:
    CARGO_TARGET_DIR={{justfile_directory()}}/target cargo package --locked --workspace \
        --exclude murmurate-python --exclude stranger --exclude stranger-python

# Exported folders and teams in the Robotarium's simulator, every command of docs/robotarium.md (25 minutes, network, 200 MB)
full-robotarium:
    python3 -m venv target/robotarium
    target/robotarium/bin/pip install --quiet numpy scipy matplotlib robotarium-python-simulator
    cargo build --locked --release
    PATH="{{justfile_directory()}}/target/robotarium/bin:$PATH" bash tests/peers/robotarium/full.sh target/release/murmurate

# Lints and tests of what speaks MAVLink, DDS and Zenoh, which no other build contains (10 minutes)
full-peers:
    RUSTC_WORKSPACE_WRAPPER=clippy-driver CLIPPY_ARGS=-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__ \
        CARGO_TARGET_DIR=target/parts CARGO_PROFILE_DEV_OPT_LEVEL=0 \
        cargo test --locked --lib --package murmurate-mavlink --package murmurate-ros2 --package murmurate-zenoh \
        --features murmurate-mavlink/mavlink,murmurate-ros2/dds,murmurate-zenoh/zenoh
    cargo test --locked --package murmurate-crazyflie --features link

# What is simulated, trained, studied, recorded and called from Python compiles for macOS (2 minutes, rustup)
full-mac:
    rustup target add aarch64-apple-darwin
    cargo check --locked --target aarch64-apple-darwin --package murmurate-cli --package murmurate-python

# Licences, advisories, versions and sources of all dependencies, by deny.toml (a minute, network, cargo install cargo-deny)
full-deny:
    cargo deny --locked --workspace check

# Licences of all that programs and wheel contain, as files to publish beside them (seconds, python3)
third-party:
    packaging/third-party murmurate-cli target/release/THIRD-PARTY.txt
    packaging/third-party murmurate-robot target/robot/THIRD-PARTY.txt --features program
    packaging/third-party murmurate-python python/murmurate/THIRD-PARTY.txt

# All artefacts of a release, dry without --go: docs/release.md (an hour; pip: ziglang cargo-zigbuild maturin, apt: dpkg-dev)
release version *flags:
    packaging/release {{version}} {{flags}}

# The robot's program, and how large it is (two minutes)
robot:
    cargo build --package murmurate-robot --features program --profile robot
    ls -l target/robot/murmurate-robot

# The same for 64-bit ARM, linked statically: runs on any Linux there (three minutes, rustup)
robot-arm:
    rustup target add aarch64-unknown-linux-musl
    CARGO_TARGET_AARCH64_UNKNOWN_LINUX_MUSL_LINKER=rust-lld cargo build --locked --package murmurate-robot --features program \
        --profile robot --target aarch64-unknown-linux-musl
    ls -l target/aarch64-unknown-linux-musl/robot/murmurate-robot

# Four traces of `sim` in a static program for ARM, by an emulator, beside those of this machine (20 minutes, most of it to build,
# rustup, apt: qemu-user-static)
full-arm:
    packaging/arm-traces

# The link beside raw multicast and Cyclone DDS; NETPEERS names the harness's folder (15 minutes, wants an idle machine)
full-network:
    bash netpeer/compare.sh

# The same for 3 to 50 hosts with few messages, data alone; with keys of members up to 23 hosts (30 minutes, wants an idle machine)
full-network-many:
    NP_ROBOT=0 SENDER=1 CASES="3:20 5:20 10:20 25:20 25:60 50:20" bash netpeer/compare.sh

# Robots and trackers of other programs: five of rclpy in the passage, what they apply after a host, a tracker or gpsd has died,
# and the team as ROS messages. PYTHON has rclpy (docs/ros2.md) (30 minutes, root, apt: gpsd, wants an idle machine)
full-robots python="python3":
    cargo build --release --features ros2
    bash tests/peers/ros2/full.sh {{python}} target/release/murmurate

# The fake Crazyflie before cflib, six of them flown by the program, with hosts that die, lost packets and faults, and the commands
# of docs/crazyflie.md. PYTHON has cflib, mcap and msgpack (25 minutes, and 10 to build)
full-crazyflie python="python3":
    cargo test --package murmurate-crazyflie --features link
    cargo build --release --package murmurate-crazyflie --features link --example fake_crazyflie
    cargo build --release --package murmurate --example natnet_server
    cargo build --release --features crazyflie
    bash tests/peers/crazyflie/full.sh {{python}} target/release/examples target/release/murmurate

# Exactly what the gate runs (under 30 minutes on 2 cores)
ci:
    bash .ci/run

# Records of real teams, replayed host by host: four modes, kills, stops, clocks in namespaces. PYTHON has mcap and
# mcap-protobuf-support (10 minutes, root, apt: faketime)
full-record python="python3":
    cargo build --release
    bash tests/peers/record/full.sh {{python}} target/release/murmurate

# Records damaged at 10 000 random places, and 20 000 mutations that are meant to do harm (15 minutes)
full-damage:
    MURMURATE_DAMAGE=10000 MURMURATE_MUTATIONS=20000 cargo test --release --test record -- damage:: hostile::

# Records under 20 000 datagrams a second of junk, and of copies, for half a minute each (3 minutes)
full-record-junk:
    MURMURATE_RECORD_JUNK="20000 4" cargo test --release --test record -- junk:: --nocapture

# Metrics, every query of the Grafana dashboard, and the alert rules against a real Prometheus (two minutes, apt: prometheus curl)
full-metrics:
    cargo build --release
    bash tests/peers/metrics/full.sh target/release/murmurate
    bash tests/peers/metrics/alerts.sh target/release/murmurate

# The pages as a site, target/site/index.html. PYTHON has the wheel, pdoc, nbconvert (10 minutes, cargo install --locked mdbook)
site python="python3":
    cargo doc --locked --no-deps --lib
    {{python}} packaging/site/build.py target/site --rust target/doc --python

# The site built anew: links, search, phones, pictures in target/site-pictures (20 minutes, network, apt: chromium-headless-shell)
full-site:
    python3 -m venv target/site-python
    target/site-python/bin/pip install --quiet pdoc nbconvert playwright gymnasium pettingzoo ./python
    just site target/site-python/bin/python
    target/site-python/bin/python packaging/site/links.py target/site
    target/site-python/bin/python packaging/site/browser.py target/site target/site-pictures

# The layouts of packaging/foxglove beside records and a live connection, by Foxglove's SDK of Python (a minute, network)
full-foxglove:
    python3 -m venv target/foxglove
    target/foxglove/bin/pip install --quiet mcap mcap-protobuf-support foxglove-sdk websockets
    cargo build --locked --release
    target/foxglove/bin/python tests/peers/foxglove/check.py target/release/murmurate

# The Python package, as a user installs it, with TorchRL, BenchMARL, PyTorch Geometric, RLlib, Stable-Baselines3 and SuperSuit, and
# its rates; an absent package is a failure (30 minutes and 8 GB, most of it torch)
full-python:
    python3 -m venv target/python
    target/python/bin/pip install --quiet ./python benchmarl torchrl torch_geometric "ray[rllib]" pettingzoo gymnasium mpe2 vmas pytest \
        matplotlib nbclient nbformat ipykernel supersuit stable-baselines3 cloudpickle onnx onnxscript onnxruntime
    # The largest wheel that is handed on [bytes]: the engine of ONNX and all studies are in it. The index of Python takes 100 MB.
    MATURIN_PEP517_ARGS="--compression-level 9" target/python/bin/pip wheel --quiet --no-deps --wheel-dir target/wheels ./python
    test "$(stat --format=%s target/wheels/murmurate-*.whl)" -le 17000000
    FULL_TESTS=1 target/python/bin/python -m pytest python/tests --ignore python/tests/test_parts.py
    target/python/bin/python python/tests/rates.py
    target/python/bin/pip install --quiet ./tests/stranger/python
    FULL_TESTS=1 target/python/bin/python -m pytest python/tests/test_parts.py

# Policies of format 3 by the library onnxruntime of PyPI beside the program's own engine: checks, runs, and wrong libraries (4 minutes)
full-onnxruntime:
    python3 -m venv target/onnxruntime
    target/onnxruntime/bin/pip install --quiet onnxruntime
    cargo build --locked --release --features onnxruntime
    bash tests/peers/python/onnxruntime.sh target/onnxruntime target/release/murmurate

# Policies in Python on five robots: times of their steps, and processes that are killed, halted or take memory, 20 times each (20
# minutes, wants an idle machine)
full-python-robots python="python3":
    cargo build --locked --release
    {{python}} tests/peers/python/robots.py target/release/murmurate

# The radio channel beside tables of ns-3 in MURMURATE_RADIO_DATA, or ../shared/radio/data (1 minute)
full-radio:
    cargo test --locked --release --test ns3 -- --nocapture

# Stops and soft state across hops under virtual time: 500 stops, a minute of soft state in each of ten fields (5 min)
full-mesh:
    MESH_STOPS=500 MESH_SECONDS=60 cargo test --locked --release --test link mesh:: hops:: -- --nocapture

# The doctor's checks of Wi-Fi beside Linux with simulated cards in a virtual machine (2 minutes; qemu-system-x86, iw, 70 MB)
full-wifi:
    cargo build --locked --release
    bash tests/peers/wifi/full.sh target/release/murmurate

# Ages and shares of messages of `murmurate.Channel` beside runs of the actors, twelve settings, 1000 to 4000 runs each (25 minutes)
full-channel:
    MURMURATE_CHANNEL_RUNS=full cargo test --locked --package murmurate-train --test learning channel:: -- --nocapture

# The twin of a real run behind a relay between network namespaces: 64 episodes, fitted and predicted (12 minutes, root, ip)
full-twin:
    cargo build --release
    bash tests/peers/twin/full.sh target/release/murmurate

# Teams through a real Zenoh router with loss, beside multicast, with the router killed, and with a captured member. PYTHON has
# eclipse-zenoh and mcap (12 minutes and 20 more to build, root, apt: nftables)
full-zenoh python="python3":
    cargo build --release --features zenoh
    bash tests/peers/zenoh/full.sh {{python}} target/release/murmurate
    bash tests/peers/zenoh/captured.sh {{python}}

# Rovers and copters with stand-in autopilots of pymavlink, which MAVSDK accepts, and MAVSDK's own autopilot: episodes, pilots who take
# over, hosts that die, signatures, a minute of junk. PYTHON has pymavlink and mavsdk (20 minutes and 15 to build)
full-mavlink python="python3":
    cargo test --package murmurate-mavlink --features mavlink
    cargo build --release --features mavlink
    bash tests/peers/mavlink/full.sh {{python}} target/release/murmurate

# Peers of netpeer/lab.py into BUILD: those of NETPEERS, and ROS 2 and Zenoh from PyPI (5 minutes, 350 MB)
lab-peers:
    bash netpeer/peers.sh

# How soon a host is in its team after its interface is fit, and back after its address or interface has changed, 20 times each
# (18 minutes, root, ip)
full-boot:
    cargo build --release
    python3 tests/peers/boot/measure.py target/release/murmurate 20

# The same over Zenoh, too; PYTHON has eclipse-zenoh (25 minutes and 10 to build, root, ip)
full-boot-zenoh python="python3":
    cargo build --release --features zenoh
    {{python}} tests/peers/boot/measure.py target/release/murmurate 20 multicast unicast zenoh

# 500 episodes each by multicast and unicast at 20 % loss under virtual time: how many are aborted (10 minutes, most of it to build)
full-heartbeats:
    MURMURATE_LOSSY_EPISODES=500 cargo test --release --lib emulated:: -- --nocapture

# How true the lab is on this machine, and how much it carries (10 minutes, root, /dev/net/tun, wants an idle machine)
full-lab:
    cargo build --release --features lab
    TESTS_MUST=lab cargo test --release --features lab --test lab
    bash tests/peers/lab/full.sh target/release/murmurate
    bash tests/peers/lab/space.sh target/release/murmurate

# The baselines of coverage on 20 worlds of CoverageControl, beside the library's own: 2 % at the most. PYTHON is one for which
# PyPI has coverage-control 1.3.1, such as 3.11 (25 minutes, network, 200 MB)
full-coverage python="python3":
    bash tests/peers/coverage/full.sh {{python}}

# Failures from public reports, each as a script with its expected end. PYTHON is 3.11, for ROS 2 from PyPI
# (30 minutes and 8 GB, root, apt: iproute2 nftables; an absent package is a failure)
full-cases python="python3.11":
    cargo build --release --features lab,ros2,zenoh
    {{python}} -m venv target/cases
    target/cases/bin/pip install --quiet ./python mcap mcap-protobuf-support zstandard lz4 rosbags benchmarl torchrl torch_geometric \
        "ray[rllib]" pettingzoo gymnasium supersuit stable-baselines3 "ros-rclpy[fastrtps]==9.1.2" ros-nav-msgs==5.5.1 \
        ros-geometry-msgs==5.5.1 eclipse-zenoh
    bash tests/cases/full.sh target/release/murmurate target/cases/bin/python
