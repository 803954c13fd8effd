#!/usr/bin/env bash
# Builds the peers of the messaging harness, and installs ROS 2 and Zenoh for participant.py, into $BUILD.
#
#   NETPEERS=/path/to/harness BUILD=/tmp/netpeers netpeer/peers.sh     5 minutes, 350 MB; a C++ compiler, Python 3.11
#
# Debian's packages for the harness: libfastrtps-dev libfastcdr-dev cyclonedds-dev cyclonedds-tools.
# Without NETPEERS only ROS 2 and Zenoh are installed. ROS is its version: jazzy (Fast DDS 2.14) or kilted (3.2).
# With BYTES=12000 (or several sizes) the harness's peers are built for messages of that size, too: $BUILD/bytes-12000.
# With ZENOH=1 the harness's Zenoh peer in Rust is built, too (15 minutes of processor time).
set -euo pipefail
build=${BUILD:-${NETPEERS:?names the folder of the harness, or BUILD where to install}/.build}
mkdir -p "$build"

venv() { # NAME PACKAGE...
    local folder=$build/$1
    shift
    [ -x "$folder/bin/pip" ] || python3 -m venv "$folder"
    "$folder/bin/pip" install --quiet "$@"
}

case ${ROS:-jazzy} in
jazzy) venv ros "ros-rclpy[fastrtps]==7.1.6" ros-std-msgs==5.3.6 ;;
kilted) venv ros "ros-rclpy[fastrtps]==9.1.2" ros-std-msgs==5.5.1 ;;
*) echo "ROS is jazzy or kilted" && exit 1 ;;
esac
venv zenoh eclipse-zenoh==1.10.2
# From 1.9 on, three peers of one multicast group send declarations to each other without end (zenoh#2802).
venv zenoh-mc eclipse-zenoh==1.7.2
if [ -n "${NETPEERS:-}" ]; then
    BUILD=$build "$NETPEERS/build.sh"
    for bytes in ${BYTES:-}; do
        source=$(mktemp -d)
        cp "$NETPEERS"/*.{c,cpp,h,idl,sh} "$source"
        chmod -R u+w "$source"
        # Sender, sequence number, timestamp and position have 24 bytes; the rest are floats.
        sed -i "s/float data\[32\]/float data[$(((bytes - 24) / 4))]/" "$source/np.h" "$source/np_msg.idl"
        BUILD=$build/bytes-$bytes "$source/build.sh"
        rm -r "$source"
    done
    if [ "${ZENOH:-0}" = 1 ]; then
        # The harness may be read-only, and Cargo writes its lock file.
        source=$(mktemp -d)
        cp -r "$NETPEERS/np.rs" "$NETPEERS/zenoh_peer" "$source"
        (cd "$source/zenoh_peer" && CARGO_TARGET_DIR=$build/zenoh-target cargo build --release)
        cp "$build/zenoh-target/release/np_zenoh" "$build/"
        rm -r "$source"
    fi
fi
