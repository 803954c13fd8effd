//! Settings of a transport: the fields of a link that belong to it, and their values for one host.

use std::collections::BTreeMap;

use crate::config::ConfigError;
use crate::config::fields::{Takes, Value};
use crate::messages::ids::HostId;

/// A field of `[link.NAME]` that a transport reads. Transports with a field of the same name share it.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// Values that it takes.
    pub takes: Takes,
    /// Default as it would be written, for the link with this index in the deployment.
    pub default: Option<fn(usize) -> String>,
    /// Whether it is a table with a value for each host of the team, by the host's name.
    pub by_host: bool,
}

impl Field {
    /// Returns a field with one value and no default.
    pub const fn new(name: &'static str, takes: Takes) -> Field {
        Field { name, takes, default: None, by_host: false }
    }

    /// Whether both take the same values, as fields of one name must.
    pub fn agrees(&self, other: &Field) -> bool {
        (self.name, self.by_host, self.takes) == (other.name, other.by_host, other.takes)
    }
}

/// A value, and the name of its field for errors: with the line, the flag or the variable that set it.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldValue {
    /// The value.
    pub value: Value,
    /// Name of its field for errors.
    pub place: String,
}

/// Settings of one link for one host of the team.
#[derive(Clone, Debug)]
pub struct LinkSettings<'a> {
    /// The link's name.
    pub link: &'a str,
    /// The host.
    pub host: HostId,
    /// Names of all hosts, by number.
    pub hosts: Vec<&'a str>,
    /// Values of the transport's fields; those of a table by host as `peers.robot-0`. Fields that are not set and have
    /// no default are left out.
    pub values: BTreeMap<String, FieldValue>,
}

impl LinkSettings<'_> {
    /// Returns the value of a field, if it has one.
    pub fn find(&self, field: &str) -> Option<&Value> {
        self.values.get(field).map(|field| &field.value)
    }

    /// Returns the value of a required field; the error says that it is missing, and `advice`.
    pub fn need(&self, field: &str, advice: impl FnOnce() -> String) -> Result<&Value, ConfigError> {
        self.find(field).ok_or_else(|| self.wrong(field, format!("missing{}", advice())))
    }

    /// Returns an error about a field.
    pub fn wrong(&self, field: &str, why: impl Into<String>) -> ConfigError {
        let place = self.values.get(field).map(|field| field.place.clone());
        ConfigError::field(place.unwrap_or_else(|| format!("link.{}.{field}", self.link)), why)
    }

    /// Name of this host.
    pub fn host_name(&self) -> &str {
        self.hosts[usize::from(self.host.0)]
    }
}
