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
    let mut all = Vec::new();
    let mut add = |fitness, what, found: String, advice: String| all.push(Finding { fitness, what, found, advice });
    let v6 = config.addressing.is_ipv6();
    let found = interface::interfaces().and_then(|all| interface::find(&all, &config.interface, v6, None));
    let found = match found {
        Ok(found) => found,
        Err(error) => {
            let advice = format!("bring it up, or name another as link.{link}.interface");
            add(Fitness::Fail, "interface", error.to_string(), advice);
            return all;
        }
    };
    add(Fitness::Ok, "interface", format!("'{}' is up", found.name), String::new());
    let needed = MAX_FRAME_BYTES + if v6 { 48 } else { 28 };
    match mtu(&found.name) {
        Some(mtu) if mtu >= needed => {
            add(Fitness::Ok, "MTU", format!("{mtu} bytes; a packet has at most {needed}"), String::new());
        }
        Some(mtu) => add(
            Fitness::Warn,
            "MTU",
            format!("{mtu} bytes, and a packet may have {needed}: large ones go in pieces and are lost more often"),
            format!("ip link set {} mtu {needed}", found.name),
        ),
        None => add(Fitness::Warn, "MTU", "unknown".to_owned(), format!("see that it is {needed} bytes or more")),
    }
    let (what, said) = match &config.addressing {
        Addressing::Multicast(group) => ("group", format!("{group} joined")),
        Addressing::Unicast { listen, .. } => ("address", format!("port {} free", listen.port())),
        Addressing::Guest { .. } => ("address", "any".to_owned()),
    };
    match Udp::open(host, config, Filter::All) {
        Ok(udp) => {
            match udp.ends.as_ref().and_then(|ends| Some((ends, ends.is_elsewhere(config)?))) {
                Some((ends, listen)) => add(
                    Fitness::Warn,
                    what,
                    format!(
                        "'{}' has {} and not {}: the host would listen there",
                        ends.name,
                        ends.at.ip(),
                        listen.ip()
                    ),
                    format!("mend link.{link}.peers, or give names there"),
                ),
                None => add(Fitness::Ok, what, said, String::new()),
            }
            // The kernel doubles the requested size for its own bookkeeping and reports the double.
            let (granted, wanted) = (udp.granted_bytes() / 2, config.receive_buffer_bytes);
            if granted >= wanted {
                add(Fitness::Ok, "receive buffer", format!("{granted} bytes"), String::new());
            } else {
                let advice = format!("sysctl -w net.core.rmem_max={wanted}, and the same in /etc/sysctl.d");
                let found = format!("the kernel grants {granted} of {wanted} bytes: bursts may be lost");
                add(Fitness::Warn, "receive buffer", found, advice);
            }
        }
        Err(error) => {
            let busy = matches!(&error, OpenError::Socket { error, .. }
                if error.kind() == std::io::ErrorKind::AddrInUse);
            let advice = if busy { "stop what listens there; is this host running already?" } else { "" };
            add(Fitness::Fail, what, error.to_string(), advice.to_owned());
        }
    }
    all.extend(names(config, link));
    all
}

/// Resolves the names of the other hosts.
fn names(config: &SocketConfig, link: &str) -> Vec<Finding> {
    let (Addressing::Unicast { peers, .. } | Addressing::Guest { peers }) = &config.addressing else {
        return Vec::new();
    };
    let v6 = config.addressing.is_ipv6();
    let family = if v6 { "IPv6" } else { "IPv4" };
    let finding = |at: &PeerAddress| {
        let PeerAddress::Named(name, port) = at else { return None };
        let found = (name.as_str(), *port).to_socket_addrs().map(|mut all| all.find(|at| at.is_ipv6() == v6));
        let why = match found {
            Ok(Some(at)) => return Some(Finding::ok("name", format!("'{name}' is {}", at.ip()))),
            Ok(None) => format!("'{name}' has no {family} address"),
            Err(error) => format!("'{name}' has no address: {error}"),
        };
        let advice = format!("is that machine on? A host goes on trying; see link.{link}.peers");
        Some(Finding { fitness: Fitness::Warn, what: "name", found: why, advice })
    };
    peers.values().filter_map(finding).collect()
}
