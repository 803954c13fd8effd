//! Transport that has both ways: to a group that all hosts of a link join, and to each host at the address from which
//! it is heard. The link layer chooses.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use super::multicast;
use super::socket::{Addressing, INTERFACE, RECEIVE_BUFFER};
use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::messages::ids::HostId;
use crate::net::protocol::link::{Guest, Standing};
use crate::net::transport::{Endpoint, Entry, Field, LinkSettings};

/// UDP port of the default group of the first link; each link has its own, as datagrams to one host tell no group.
const PORT: u16 = 7750;
/// Largest number of hosts of which the address is kept.
const MOST: usize = 1024;

/// Registry entry of the transport `auto`, which sends to a group or to single hosts.
pub(crate) const ENTRY: Entry = Entry {
    name: "auto",
    about: "UDP to a group or to each host by itself, as the link measures",
    fields: &[
        INTERFACE,
        Field { default: Some(default_group), ..Field::new("group", FieldType::Address) },
        RECEIVE_BUFFER,
    ],
    read,
};

/// Returns the default group of the link with index `at`, unless the link names its own: that of `multicast`, with a
/// port of the link.
fn default_group(at: usize) -> String {
    multicast::group(at, PORT + u16::try_from(at % 254).expect("it is below 254")).to_string()
}

fn read(settings: &LinkSettings) -> Result<Arc<dyn Endpoint>, ConfigError> {
    let group = settings.find("group").map(Value::address).expect("it has a default");
    if group.is_ipv6() {
        return Err(settings.wrong("group", format!("{} is of IPv6; this transport takes a group of IPv4", group.ip())));
    }
    multicast::read_with(settings, Addressing::Both)
}

/// Addresses from which the hosts of a link are heard.
#[derive(Debug, Default)]
pub(super) struct Hosts(BTreeMap<HostId, IpAddr>);

impl Hosts {
    /// Takes note of where an accepted host is.
    pub(super) fn admit(&mut self, guest: Guest) {
        if guest.standing == Standing::Accepted && (self.0.len() < MOST || self.0.contains_key(&guest.host)) {
            self.0.insert(guest.host, guest.at.ip());
        }
    }

    /// Returns the address of a host that receives at `port`; `None` if it is unknown, or also that of another host or
    /// of this one, `own`: the kernel would give a datagram to any of them.
    pub(super) fn of(&self, host: HostId, port: u16, own: IpAddr) -> Option<SocketAddr> {
        let ip = *self.0.get(&host)?;
        let shared = ip == own || self.0.iter().any(|(other, at)| *other != host && *at == ip);
        (!shared).then(|| SocketAddr::new(ip, port))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_with_an_address_of_its_own_is_sent_to_by_itself_and_no_other() {
        let (mut hosts, own) = (Hosts::default(), IpAddr::from([10, 0, 0, 9]));
        let mut admit = |host, last, standing| {
            hosts.admit(Guest { host: HostId(host), at: SocketAddr::from(([10, 0, 0, last], 4000)), standing });
        };
        admit(1, 1, Standing::Accepted);
        admit(2, 2, Standing::Candidate);
        (3..5).for_each(|host| admit(host, 3, Standing::Accepted));
        admit(5, 9, Standing::Accepted);
        let to = |host| hosts.of(HostId(host), 7750, own);
        assert_eq!(to(1), Some(SocketAddr::from(([10, 0, 0, 1], 7750))));
        assert_eq!((2..7).filter_map(to).count(), 0, "unproven, two of one machine, this machine, unknown");
    }
}
