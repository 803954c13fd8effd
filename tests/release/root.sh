# Roots of Debian without Rust, and commands in them. Sourced by the scripts beside it; ROOTS is the folder for roots.

# The mirror that this machine's apt has.
mirror() { sed -n 's/^URIs: *\(http[^ ]*\/debian\) *$/\1/p; s/^deb \(http[^ ]*\/debian\) .*/\1/p' /etc/apt/sources.list.d/debian.sources \
    /etc/apt/sources.list 2>/dev/null | head -1; }

# Makes the root NAME once, with PACKAGES beside the smallest system: base NAME PACKAGES
base() {
    [ -e "$ROOTS/$1/made" ] && return
    rm -rf "${ROOTS:?}/$1"
    mkdir -p "$ROOTS"
    debootstrap --variant=minbase --include="$2" bookworm "$ROOTS/$1" "$(mirror)" >"$ROOTS/$1.log" 2>&1 || {
        tail -3 "$ROOTS/$1.log"
        return 1
    }
    touch "$ROOTS/$1/made"
}

# Copies the root FROM as TO, which is new: fresh FROM TO
fresh() {
    forget "$2"
    cp -a "$ROOTS/$1" "$ROOTS/$2"
    mount -t proc proc "$ROOTS/$2/proc"
}

# Ends what runs in the root and removes it.
forget() {
    for process in /proc/[0-9]*; do
        [ "$(readlink "$process/root")" != "$ROOTS/$1" ] || kill -9 "${process#/proc/}" 2>/dev/null || true
    done
    ! mountpoint -q "$ROOTS/$1/proc" || umount "$ROOTS/$1/proc"
    rm -rf "${ROOTS:?}/$1"
}

# Runs a command in the root TO, with no network but a loopback interface: in_root TO COMMAND
in_root() {
    local root=$ROOTS/$1
    shift
    ip netns exec "$SPACE" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive \
        chroot "$root" "$@"
}

fail() {
    echo "FAILED: $*" >&2
    exit 1
}
