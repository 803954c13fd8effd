# Shared by cases with robots of rclpy: a network of their own, with multicast on its loopback interface.

# Runs the case again inside a network of its own, unless it is there already.
own_network() {
    [ -n "${OWN_NETWORK:-}" ] || OWN_NETWORK=1 exec unshare -n bash "$0" "$@"
    ip link set lo up
    ip link set lo multicast on
    ip route add 224.0.0.0/4 dev lo 2>/dev/null || true
}
