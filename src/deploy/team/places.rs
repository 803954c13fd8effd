//! Resolves the place of a host on each link from a team file: the endpoint (such as an address and interface) that the
//! link's transport reads, and reliability modes. Includes the checks that need no open socket.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::fields::EVERY_INTERFACE;
use super::layers::{LayerValue, Origin, place};
use super::{TeamFile, kebab, text, whole_u16};
use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::deploy::Link;
use crate::deploy::Routes;
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::{KINDS, Kind};
use crate::net::protocol::reliability::Reliability;
use crate::net::transport;
use crate::net::transport::settings::FieldValue;
use crate::net::transport::{Field, LinkSettings, Place};

/// Settings with which an operator joins the link that carries emergency stop messages, from any machine.
#[derive(Clone, Debug)]
pub struct OperatorAccess {
    /// Link that carries emergency stop messages (`Stop`).
    pub link: LinkId,
    /// Team number in every datagram, which keeps teams on one network apart.
    pub number: u16,
    /// Path of the team's key file; `None` for a team without a key.
    pub key_file: Option<PathBuf>,
    /// Whether the team's datagrams are encrypted; only with a key.
    pub confidential: bool,
    /// Endpoints of the operator on the link: one for each network interface that hosts of the team use, or a single
    /// one if the transport sends to each host's address.
    pub places: Vec<Place>,
}

impl TeamFile {
    /// Returns the transport that the team file chooses for a link. `scopes` are the prefixes of one host's keys, such
    /// as `host.pc.`, the narrowest first.
    pub(super) fn transport(&self, scopes: &[String], link: &Link) -> &transport::Entry {
        let name = self.layers.find(scopes, &format!("link.{}.transport", link.name)).expect("it has a default");
        self.registry.transport(text(&name)).expect("its name was checked when the file was read")
    }

    /// Returns the names that `field` has in its link's table: its own name, or `name.host` for every host if it has a
    /// value for each host.
    pub(super) fn names_of(&self, field: &Field) -> Vec<String> {
        let hosts = self.deployment.hosts.iter().filter(|_| field.by_host);
        let names: Vec<String> = hosts.map(|host| format!("{}.{}", field.name, host.name)).collect();
        if field.by_host { names } else { vec![field.name.to_owned()] }
    }

    /// Returns the value of a field of the transport of the link with index `at`; `None` if it is not set and has no
    /// default. The field is given with its name in the link's table. `scopes` are the prefixes of one host's keys, the
    /// narrowest first.
    pub(super) fn of_link(&self, scopes: &[String], at: usize, (field, name): (&Field, &str)) -> Option<LayerValue> {
        let key = format!("link.{}.{name}", self.deployment.links[at].name);
        self.layers.find(scopes, &key).or_else(|| {
            let value = field.takes.read(&field.default?(at)).expect("defaults are sound");
            Some(LayerValue { value, origin: Origin::Default })
        })
    }

    /// Returns how a host takes part in the link with index `at`: its endpoint, and the reliability mode of each kind
    /// of message. An error names the wrong field.
    pub(super) fn place(&self, host: HostId, at: usize) -> Result<Place, ConfigError> {
        let link = &self.deployment.links[at];
        let scopes = self.scopes(Some(host));
        let transport = self.transport(&scopes, link);
        self.check_own_fields(&scopes, link, transport)?;
        let mut values = BTreeMap::new();
        for (field, name) in
            transport.fields.iter().flat_map(|field| self.names_of(field).into_iter().map(move |n| (field, n)))
        {
            let Some(entry) = self.of_link(&scopes, at, (field, &name)) else { continue };
            let place = place(&format!("link.{}.{name}", link.name), &entry.origin);
            let value = match field.takes {
                FieldType::Path => Value::Text(self.path(&entry).to_string_lossy().into_owned()),
                _ => entry.value,
            };
            let value = FieldValue { value, place };
            values.insert(name, value);
        }
        let hosts = self.deployment.hosts.iter().map(|host| host.name.as_str()).collect();
        let team = self.layers.find(&scopes, "team").as_ref().map(whole_u16);
        let endpoint = (transport.read)(&LinkSettings { link: &link.name, team, host, hosts, values })?;
        let reliability = KINDS.iter().filter_map(|&kind| {
            let entry = self.layers.find(&scopes, &format!("link.{}.reliability.{}", link.name, kebab(kind)))?;
            let named = Reliability::NAMED.iter().find(|(name, _)| *name == text(&entry));
            Some((kind, named.expect("the fields let only reliabilities through").1))
        });
        Ok(Place { endpoint, reliability: reliability.collect() })
    }

    /// Checks that no field of another transport is set on a link, where it would have no effect, except `interface`,
    /// which a flag sets on every link. What stands below the layer that chooses the transport is let through: a flag
    /// can choose another transport than the file, but cannot take the file's fields away. An error names the field.
    fn check_own_fields(&self, scopes: &[String], link: &Link, own: &transport::Entry) -> Result<(), ConfigError> {
        let foreign =
            |field: &&Field| field.name != EVERY_INTERFACE && own.fields.iter().all(|other| other.name != field.name);
        let chosen = self.layers.find(scopes, &format!("link.{}.transport", link.name));
        let chosen = chosen.map_or(0, |entry| entry.origin.layer());
        for field in self.registry.transports().iter().flat_map(|entry| entry.fields).filter(foreign) {
            for name in self.names_of(field) {
                let key = format!("link.{}.{name}", link.name);
                let set = self.layers.find(scopes, &key).filter(|entry| entry.origin.layer() >= chosen);
                let Some(LayerValue { origin, .. }) = set else { continue };
                let why = format!("transport '{}' has no such field; leave it out, or choose another one", own.name);
                return Err(ConfigError::field(place(&key, &origin), why));
            }
        }
        Ok(())
    }

    /// Returns the settings with which an operator joins the link that carries the emergency stop. An operator opens no
    /// other link. An error names the field, such as `carries` if no link carries `stop`.
    pub fn operator_access(&self) -> Result<OperatorAccess, ConfigError> {
        let carries = |link: &Link| link.carries.contains(&Kind::Stop);
        let at = self.deployment.links.iter().position(carries).ok_or_else(|| {
            ConfigError::field("deployment.link.carries", "no link carries 'stop': this team runs in one process")
        })?;
        let routes = Routes::of(&self.deployment);
        let hosts: Vec<HostId> = self.hosts().filter(|&host| routes.exchanges(host, Kind::Stop)).collect();
        let mut places: Vec<Place> = Vec::new();
        for &host in &hosts {
            let place = self.place(host, at)?.for_guest(host);
            if places.iter().all(|other| other.endpoint.claim() != place.endpoint.claim()) {
                places.push(place);
            }
        }
        let number = self.layers.find(&self.scopes(None), "team");
        let number = number.ok_or_else(|| ConfigError::field("team", "missing; give the team a number"))?;
        let mut scopes = std::iter::once(None).chain(hosts.into_iter().map(Some));
        let key_file = scopes.find_map(|host| self.layers.find(&self.scopes(host), "key_file"));
        let key_file = key_file.map(|entry| self.path(&entry));
        Ok(OperatorAccess {
            link: LinkId(u16::try_from(at).expect("links are counted in u16")),
            number: whole_u16(&number),
            confidential: self.is_confidential(key_file.as_deref())?,
            key_file,
            places,
        })
    }

    /// Checks that no two links of a host would receive each other's frames. `places` has the host's endpoint on each
    /// link. An error names the field.
    pub(super) fn check_apart(&self, host: HostId, places: &[Option<Place>]) -> Result<(), ConfigError> {
        let scopes = self.scopes(Some(host));
        let mut seen: BTreeMap<(String, String), &str> = BTreeMap::new();
        for (link, place_on) in self.deployment.links.iter().zip(places) {
            let Some(place_on) = place_on else { continue };
            let claim = place_on.endpoint.claim();
            let Some(other) = seen.insert((claim.what.clone(), claim.on), &link.name) else { continue };
            let fields = self.transport(&scopes, link).fields;
            let by_host = fields.iter().any(|field| field.name == claim.field && field.by_host);
            let own = &self.deployment.hosts[usize::from(host.0)].name;
            let name = if by_host { format!("{}.{own}", claim.field) } else { claim.field.to_owned() };
            let key = format!("link.{}.{name}", link.name);
            let origin = self.layers.find(&scopes, &key).map_or(Origin::Default, |entry| entry.origin);
            let why = format!("{} is link '{other}' already; give each its own {}", claim.what, claim.field);
            return Err(ConfigError::field(place(&key, &origin), why));
        }
        Ok(())
    }
}
