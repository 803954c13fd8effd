//! Unicast transport: sends to each host of a link at its address in the team file.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use super::peers::PeerAddress;
use super::socket::{Addressing, INTERFACE, RECEIVE_BUFFER, SocketConfig, bound};
use crate::config::ConfigError;
use crate::config::fields::FieldType;
use crate::messages::ids::HostId;
use crate::net::transport::{Endpoint, Entry, Field, LinkSettings};

/// Registry entry of the transport `unicast`, which sends to each host of a link at its own UDP address.
pub(crate) const ENTRY: Entry = Entry {
    name: "unicast",
    about: "UDP to each host by itself",
    fields: &[INTERFACE, RECEIVE_BUFFER, Field { by_host: true, ..Field::new("peers", FieldType::HostAddress) }],
    read,
};

fn read(settings: &LinkSettings) -> Result<Arc<dyn Endpoint>, ConfigError> {
    let (interface, receive_buffer_bytes) = bound(settings)?;
    let mut peers: BTreeMap<HostId, PeerAddress> = BTreeMap::new();
    for (id, name) in (0..).map(HostId).zip(&settings.hosts) {
        let field = format!("peers.{name}");
        let advice = || format!("; say where host '{name}' listens, with its port");
        let listens = PeerAddress::of(settings.need(&field, advice)?);
        if let Some(at) = listens.fixed().filter(|at| at.ip().is_multicast() || at.ip().is_unspecified()) {
            return Err(settings.wrong(&field, format!("{} is no address of one host", at.ip())));
        }
        if let Some((HostId(other_host), _)) = peers.iter().find(|(_, peer)| **peer == listens) {
            let other_host = settings.hosts[usize::from(*other_host)];
            let why = format!("{listens} is where host '{other_host}' listens; give each its own");
            return Err(settings.wrong(&field, why));
        }
        peers.insert(id, listens);
    }
    let listen = peers.remove(&settings.host).expect("every host has its address");
    let fixed: Vec<SocketAddr> = peers.values().chain([&listen]).filter_map(PeerAddress::fixed).collect();
    if let Some(other) = fixed.iter().find(|other| other.is_ipv4() != fixed[0].is_ipv4()) {
        let why = format!("{} and {other} are of two families; take one, IPv4 or IPv6", fixed[0]);
        return Err(settings.wrong("peers", why));
    }
    Ok(Arc::new(SocketConfig { addressing: Addressing::Unicast { listen, peers }, interface, receive_buffer_bytes }))
}

/// Returns the endpoint of a host that listens at `listen`, with the addresses of all other hosts in `peers`, on the
/// named network interface, without a team file. `receive_buffer_bytes` is the size of the receive buffer that is
/// requested from the kernel.
pub fn endpoint(
    listen: SocketAddr,
    peers: BTreeMap<HostId, SocketAddr>,
    interface: &str,
    receive_buffer_bytes: usize,
) -> Arc<dyn Endpoint> {
    let interface = interface.to_owned();
    let peers = peers.into_iter().map(|(host, at)| (host, PeerAddress::At(at))).collect();
    let addressing = Addressing::Unicast { listen: PeerAddress::At(listen), peers };
    Arc::new(SocketConfig { addressing, interface, receive_buffer_bytes })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::fields::Value;
    use crate::net::transport::settings::FieldValue;

    /// Reads the endpoint of the first of these hosts, which are at these addresses or names.
    fn endpoint_at(peers: &[(&'static str, &str)]) -> Result<Arc<dyn Endpoint>, String> {
        let said = |value| FieldValue { value, place: String::new() };
        let peer = |(name, at): &(&str, &str)| {
            (format!("peers.{name}"), said(FieldType::HostAddress.read(at).expect("it is an address or a name")))
        };
        let mut values: BTreeMap<String, FieldValue> = peers.iter().map(peer).collect();
        values.insert("interface".to_owned(), said(Value::Text("lo".to_owned())));
        values.insert("receive_buffer_bytes".to_owned(), said(Value::Whole(1 << 16)));
        let hosts = peers.iter().map(|(name, _)| *name).collect();
        let settings = LinkSettings { link: "air", team: None, host: HostId(0), hosts, values };
        read(&settings).map_err(|error| error.to_string())
    }

    #[test]
    fn hosts_may_be_given_by_names_which_may_lead_off_this_machine() {
        let named = endpoint_at(&[("a", "robot-0.local:7700"), ("b", "10.0.0.2:7700")]).unwrap();
        assert_eq!((named.claim().what, named.is_local()), ("robot-0.local:7700".to_owned(), false));
        assert!(endpoint_at(&[("a", "127.0.0.1:7700"), ("b", "localhost:7701")]).unwrap().is_local());
        let guest = named.for_guest(HostId(0));
        assert_eq!(guest.claim().what, "robot-0.local:7700, 10.0.0.2:7700");
    }

    #[test]
    fn two_hosts_at_one_place_or_of_two_families_are_refused() {
        let error = |peers: &[(&'static str, &str)]| endpoint_at(peers).expect_err("it is refused");
        assert!(error(&[("a", "10.0.0.1:7"), ("b", "10.0.0.1:7")]).contains("where host 'a' listens"));
        assert!(error(&[("a", "robot.local:7"), ("b", "robot.local:7")]).contains("where host 'a' listens"));
        assert!(error(&[("a", "10.0.0.1:7"), ("c", "robot:7"), ("b", "[fe80::1]:7")]).contains("two families"));
        assert!(error(&[("a", "10.0.0.1:7"), ("b", "239.0.0.1:7")]).contains("no address of one host"));
    }
}
