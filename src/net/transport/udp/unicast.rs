//! Unicast: to each host of a link by itself, at the address that the team file has for it.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use super::socket::{INTERFACE, RECEIVE_BUFFER, SocketConfig, Whom, bound};
use crate::config::ConfigError;
use crate::config::fields::FieldType;
use crate::messages::ids::HostId;
use crate::net::transport::{Entry, Field, Given, Way};

/// The transport.
pub const ENTRY: Entry = Entry {
    name: "unicast",
    about: "UDP to each host by itself",
    fields: &[INTERFACE, RECEIVE_BUFFER, Field { by_host: true, ..Field::new("peers", FieldType::Address) }],
    read,
};

fn read(given: &Given) -> Result<Arc<dyn Way>, ConfigError> {
    let (interface, receive_buffer_bytes) = bound(given)?;
    let mut peers: BTreeMap<HostId, SocketAddr> = BTreeMap::new();
    for (id, name) in (0..).map(HostId).zip(&given.hosts) {
        let field = format!("peers.{name}");
        let advice = || format!("; say where host '{name}' listens, with its port");
        let listens = given.need(&field, advice)?.address();
        if listens.ip().is_multicast() || listens.ip().is_unspecified() {
            return Err(given.wrong(&field, format!("{} is no address of one host", listens.ip())));
        }
        if let Some((HostId(twin), _)) = peers.iter().find(|(_, peer)| **peer == listens) {
            let twin = given.hosts[usize::from(*twin)];
            let why = format!("{listens} is where host '{twin}' listens; give each its own");
            return Err(given.wrong(&field, why));
        }
        peers.insert(id, listens);
    }
    let listen = peers.remove(&given.host).expect("every host has its address");
    if let Some(other) = peers.values().find(|other| other.is_ipv4() != listen.is_ipv4()) {
        return Err(given.wrong("peers", format!("{listen} and {other} are of two families; take one, IPv4 or IPv6")));
    }
    Ok(Arc::new(SocketConfig { whom: Whom::Each { listen, peers }, interface, receive_buffer_bytes }))
}
