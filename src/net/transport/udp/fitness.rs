//! Checks of this machine for a link's UDP sockets: interface, packet size, address, receive buffer.

use std::net::ToSocketAddrs;

use super::open::OpenError;
use super::peers::PeerAddress;
use super::socket::{Addressing, SocketConfig};
use super::{Filter, Udp};
use crate::fitness::{Finding, Fitness};
use crate::messages::ids::HostId;
use crate::net::protocol::codec::MAX_FRAME_BYTES;
use crate::net::transport::interface;

/// Opens the sockets of `host` on the link named `link` for a check, and returns the findings. `mtu` returns the
/// largest packet of the interface with the given name \[bytes\]; `None` if that is unknown.
pub(super) fn check(
    config: &SocketConfig,
    (host, link): (HostId, &str),
    mtu: &dyn Fn(&str) -> Option<usize>,
) -> Vec<Finding> {
    let v6 = config.addressing.is_ipv6();
    let found = interface::interfaces().and_then(|all| interface::find(&all, &config.interface, v6, None));
    let found = match found {
        Ok(found) => found,
        Err(error) => {
            let advice = format!("bring it up, or name another as link.{link}.interface");
            return vec![finding(Fitness::Fail, "interface", error.to_string(), advice)];
        }
    };
    let mut all = vec![Finding::ok("interface", format!("'{}' is up", found.name))];
    all.push(packet_size(&found.name, MAX_FRAME_BYTES + if v6 { 48 } else { 28 }, mtu));
    all.extend(sockets(config, host, link));
    all.extend(names(config, link));
    all
}

fn finding(fitness: Fitness, what: &'static str, found: String, advice: String) -> Finding {
    Finding { fitness, what, found, advice }
}

/// Returns whether packets of up to `needed` bytes leave an interface in one piece.
fn packet_size(interface: &str, needed: usize, mtu: &dyn Fn(&str) -> Option<usize>) -> Finding {
    match mtu(interface) {
        Some(mtu) if mtu >= needed => Finding::ok("MTU", format!("{mtu} bytes; a packet has at most {needed}")),
        Some(mtu) => finding(
            Fitness::Warn,
            "MTU",
            format!("{mtu} bytes, and a packet may have {needed}: large ones go in pieces and are lost more often"),
            format!("ip link set {interface} mtu {needed}"),
        ),
        None => finding(Fitness::Warn, "MTU", "unknown".to_owned(), format!("see that it is {needed} bytes or more")),
    }
}

/// Opens the sockets, and returns what was found of their address and their receive buffer.
fn sockets(config: &SocketConfig, host: HostId, link: &str) -> Vec<Finding> {
    let (what, said) = match &config.addressing {
        Addressing::Multicast(group) | Addressing::Both(group) => ("group", format!("{group} joined")),
        Addressing::Unicast { listen, .. } => ("address", format!("port {} free", listen.port())),
        Addressing::Guest { .. } => ("address", "any".to_owned()),
    };
    let udp = match Udp::open(host, config, Filter::All) {
        Ok(udp) => udp,
        Err(error) => {
            let busy = matches!(&error, OpenError::Socket { error, .. }
                if error.kind() == std::io::ErrorKind::AddrInUse);
            let advice = if busy { "stop what listens there; is this host running already?" } else { "" };
            return vec![finding(Fitness::Fail, what, error.to_string(), advice.to_owned())];
        }
    };
    let address = match udp.ends.as_ref().and_then(|ends| Some((ends, ends.is_elsewhere(config)?))) {
        Some((ends, listen)) => finding(
            Fitness::Warn,
            what,
            format!("'{}' has {} and not {}: the host would listen there", ends.name, ends.at.ip(), listen.ip()),
            format!("mend link.{link}.peers, or give names there"),
        ),
        None => Finding::ok(what, said),
    };
    // The kernel doubles the requested size for its own bookkeeping and reports the double.
    vec![address, receive_buffer(udp.granted_bytes() / 2, config.receive_buffer_bytes)]
}

/// Returns whether the kernel grants the receive buffer that is wanted \[bytes\].
fn receive_buffer(granted: usize, wanted: usize) -> Finding {
    if granted >= wanted {
        return Finding::ok("receive buffer", format!("{granted} bytes"));
    }
    let advice = format!("sysctl -w net.core.rmem_max={wanted}, and the same in /etc/sysctl.d");
    let found = format!("the kernel grants {granted} of {wanted} bytes: bursts may be lost");
    finding(Fitness::Warn, "receive buffer", found, advice)
}

/// Resolves the names of the other hosts.
fn names(config: &SocketConfig, link: &str) -> Vec<Finding> {
    let (Addressing::Unicast { peers, .. } | Addressing::Guest { peers }) = &config.addressing else {
        return Vec::new();
    };
    let v6 = config.addressing.is_ipv6();
    let family = if v6 { "IPv6" } else { "IPv4" };
    let resolved = |at: &PeerAddress| {
        let PeerAddress::Named(name, port) = at else { return None };
        let found = (name.as_str(), *port).to_socket_addrs().map(|mut all| all.find(|at| at.is_ipv6() == v6));
        let why = match found {
            Ok(Some(at)) => return Some(Finding::ok("name", format!("'{name}' is {}", at.ip()))),
            Ok(None) => format!("'{name}' has no {family} address"),
            Err(error) => format!("'{name}' has no address: {error}"),
        };
        let advice = format!("is that machine on? A host goes on trying; see link.{link}.peers");
        Some(finding(Fitness::Warn, "name", why, advice))
    };
    peers.values().filter_map(resolved).collect()
}
