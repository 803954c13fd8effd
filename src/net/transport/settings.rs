//! What a transport takes from a team file: the fields of a link that are its own, and what one host finds in them.

use std::collections::BTreeMap;

use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::messages::ids::HostId;

/// A field of `[link.NAME]` that a transport reads. Transports that have one of the same name share it.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// What it takes.
    pub takes: FieldType,
    /// What it is where nobody says, as it would be written, for the link at this place of the deployment.
    pub default: Option<fn(usize) -> String>,
    /// Whether it is a table with a value for each host of the team, by its name.
    pub by_host: bool,
}

impl Field {
    /// A field with one value, which has no default.
    pub const fn new(name: &'static str, takes: FieldType) -> Field {
        Field { name, takes, default: None, by_host: false }
    }

    /// Whether both take the same, as those of one name must.
    pub fn agrees(&self, other: &Field) -> bool {
        (self.name, self.by_host, self.takes) == (other.name, other.by_host, other.takes)
    }
}

/// A value, and how errors name its field: with the line, the flag or the variable that set it.
#[derive(Clone, Debug, PartialEq)]
pub struct Said {
    /// The value.
    pub value: Value,
    /// The name for errors.
    pub place: String,
}

/// What a team file says of one link, as one host of the team sees it.
#[derive(Clone, Debug)]
pub struct Given<'a> {
    /// The link's name.
    pub link: &'a str,
    /// The host.
    pub host: HostId,
    /// The names of all hosts, by number.
    pub hosts: Vec<&'a str>,
    /// The values of the transport's fields; of a table by host as `peers.robot-0`. Those that nobody has set and that
    /// have no default are left out.
    pub values: BTreeMap<String, Said>,
}

impl Given<'_> {
    /// The value of a field, if it has one.
    pub fn find(&self, field: &str) -> Option<&Value> {
        self.values.get(field).map(|said| &said.value)
    }

    /// The value of a field that has to be there; the error says that it is missing, and `advice`.
    pub fn need(&self, field: &str, advice: impl FnOnce() -> String) -> Result<&Value, ConfigError> {
        self.find(field).ok_or_else(|| self.wrong(field, format!("missing{}", advice())))
    }

    /// The error of a field.
    pub fn wrong(&self, field: &str, why: impl Into<String>) -> ConfigError {
        let place = self.values.get(field).map(|said| said.place.clone());
        ConfigError::field(place.unwrap_or_else(|| format!("link.{}.{field}", self.link)), why)
    }

    /// The name of this host.
    pub fn host_name(&self) -> &str {
        self.hosts[usize::from(self.host.0)]
    }
}
