//! How a host's socket on each link is set up, and the mistakes that can be seen without opening one.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;

use super::layers::{Origin, place};
use super::{TeamFile, address, kebab, text, whole, whole_u16};
use crate::config::ConfigError;
use crate::deploy::Link;
use crate::deploy::Routes;
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::{KINDS, Kind};
use crate::net::protocol::reliability::Reliability;
use crate::net::transport::socket::{LOOPBACK, SocketConfig, Transport};

/// The link of the emergency stop, as an operator joins it from whatever machine it runs on.
#[derive(Clone, Debug, PartialEq)]
pub struct Post {
    /// The link.
    pub link: LinkId,
    /// The team's number on the wire.
    pub number: u16,
    /// Where its key is; `None` for a team without one.
    pub key_file: Option<PathBuf>,
    /// The ways onto the link: one for each interface that a host has on it, or a single one that addresses each host.
    pub sockets: Vec<SocketConfig>,
}

/// The port of the default groups.
const PORT: u16 = 7700;

impl TeamFile {
    /// The socket of a host on its link at this place.
    pub(super) fn socket(&self, host: HostId, at: usize) -> Result<SocketConfig, ConfigError> {
        let link = &self.deployment.links[at];
        let scopes = self.scopes(Some(host));
        let key = |field: &str| format!("link.{}.{field}", link.name);
        let find = |field: &str| self.layers.find(&scopes, &key(field));
        let Some(interface) = find("interface") else {
            let why = format!(
                "missing, so link '{}' cannot be set up on host '{}'; name the network interface, such as \"wlan0\"",
                link.name,
                self.deployment.hosts[usize::from(host.0)].name
            );
            return Err(ConfigError::field(key("interface"), why));
        };
        let transport = find("transport").expect("it has a default");
        let transport = match text(&transport) {
            "unicast" => self.unicast(host, link, &scopes)?,
            _ => self.multicast(at, &scopes, text(&interface))?,
        };
        let reliability = KINDS.iter().filter_map(|&kind| {
            let entry = find(&format!("reliability.{}", kebab(kind)))?;
            let named = Reliability::NAMED.iter().find(|(name, _)| *name == text(&entry));
            Some((kind, named.expect("the fields let only reliabilities through").1))
        });
        Ok(SocketConfig {
            transport,
            interface: text(&interface).to_owned(),
            receive_buffer_bytes: usize::try_from(whole(&find("receive_buffer_bytes").expect("it has a default")))
                .expect("its range is smaller"),
            reliability: reliability.collect(),
        })
    }

    fn multicast(&self, at: usize, scopes: &[String], interface: &str) -> Result<Transport, ConfigError> {
        let key = format!("link.{}.group", self.deployment.links[at].name);
        let Some(entry) = self.layers.find(scopes, &key) else {
            return Ok(Transport::Multicast { group: default_group(at) });
        };
        let group = address(&entry);
        let wrong = |why: String| Err(ConfigError::field(place(&key, &entry.origin), why));
        if !group.ip().is_multicast() {
            return wrong(format!("{} is no multicast group, such as 239.255.77.1 or ff02::4d75", group.ip()));
        }
        if group.is_ipv6() && interface == LOOPBACK {
            return wrong(format!("an IPv6 group never arrives on '{LOOPBACK}'; take an IPv4 group there"));
        }
        Ok(Transport::Multicast { group })
    }

    fn unicast(&self, host: HostId, link: &Link, scopes: &[String]) -> Result<Transport, ConfigError> {
        let mut peers = BTreeMap::new();
        for (id, other) in self.hosts().zip(&self.deployment.hosts) {
            let key = format!("link.{}.peers.{}", link.name, other.name);
            let entry = self.layers.find(scopes, &key);
            let entry = entry.ok_or_else(|| {
                ConfigError::field(&key, format!("missing; say where host '{}' listens, with its port", other.name))
            })?;
            let listens = address(&entry);
            let wrong = |why: String| Err(ConfigError::field(place(&key, &entry.origin), why));
            if listens.ip().is_multicast() || listens.ip().is_unspecified() {
                return wrong(format!("{} is no address of one host", listens.ip()));
            }
            if let Some((HostId(twin), _)) = peers.iter().find(|(_, peer)| **peer == listens) {
                let twin = &self.deployment.hosts[usize::from(*twin)].name;
                return wrong(format!("{listens} is where host '{twin}' listens; give each its own"));
            }
            peers.insert(id, listens);
        }
        let listen = peers.remove(&host).expect("every host has its address");
        if let Some(other) = peers.values().find(|other| other.is_ipv4() != listen.is_ipv4()) {
            let why = format!("{listen} and {other} are of two families; take one, IPv4 or IPv6");
            return Err(ConfigError::field(format!("link.{}.peers", link.name), why));
        }
        Ok(Transport::Unicast { listen, peers })
    }

    /// Where an operator joins the team: on the link that carries the emergency stop, and on no other.
    pub fn post(&self) -> Result<Post, ConfigError> {
        let carries = |link: &Link| link.carries.contains(&Kind::Stop);
        let at = self.deployment.links.iter().position(carries).ok_or_else(|| {
            ConfigError::field("deployment.link.carries", "no link carries 'stop': this team runs in one process")
        })?;
        let routes = Routes::of(&self.deployment);
        let hosts: Vec<HostId> = self.hosts().filter(|&host| routes.exchanges(host, Kind::Stop)).collect();
        let mut sockets: Vec<SocketConfig> = Vec::new();
        for &host in &hosts {
            let socket = self.socket(host, at)?.of_guest(host);
            let twin = |other: &SocketConfig| match socket.transport {
                Transport::Multicast { .. } => {
                    (&other.transport, &other.interface) == (&socket.transport, &socket.interface)
                }
                Transport::Unicast { .. } => other.transport == socket.transport,
            };
            if !sockets.iter().any(twin) {
                sockets.push(socket);
            }
        }
        let number = self.layers.find(&self.scopes(None), "team");
        let number = number.ok_or_else(|| ConfigError::field("team", "missing; give the team a number"))?;
        let mut scopes = std::iter::once(None).chain(hosts.into_iter().map(Some));
        let key_file = scopes.find_map(|host| self.layers.find(&self.scopes(host), "key_file"));
        Ok(Post {
            link: LinkId(u16::try_from(at).expect("links are counted in u16")),
            number: whole_u16(&number),
            key_file: key_file.map(|entry| self.path(&entry)),
            sockets,
        })
    }

    /// Two links of a host that hear each other's frames are a mistake.
    pub(super) fn check_apart(&self, host: HostId, links: &[Option<SocketConfig>]) -> Result<(), ConfigError> {
        let scopes = self.scopes(Some(host));
        let mut seen: BTreeMap<(SocketAddr, &str), &str> = BTreeMap::new();
        for (link, socket) in self.deployment.links.iter().zip(links) {
            let Some(socket) = socket else { continue };
            let (field, heard) = match &socket.transport {
                Transport::Multicast { group } => ("group".to_owned(), (*group, socket.interface.as_str())),
                Transport::Unicast { listen, .. } => {
                    let name = &self.deployment.hosts[usize::from(host.0)].name;
                    (format!("peers.{name}"), (*listen, ""))
                }
            };
            if let Some(twin) = seen.insert(heard, &link.name) {
                let key = format!("link.{}.{field}", link.name);
                let origin = self.layers.find(&scopes, &key).map_or(Origin::Default, |entry| entry.origin);
                let why = format!("{} is link '{twin}' already; give each its own group or port", heard.0);
                return Err(ConfigError::field(place(&key, &origin), why));
            }
        }
        Ok(())
    }
}

/// The group of a link that names none: one for each link.
pub(super) fn default_group(at: usize) -> SocketAddr {
    let last = u8::try_from(at % 254).expect("it is below 254") + 1;
    SocketAddr::new(IpAddr::from([239, 255, 77, last]), PORT)
}
