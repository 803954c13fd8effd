//! Settings of a transport: its fields in a team file, and their values for one host.

use std::collections::BTreeMap;

use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::messages::ids::HostId;

/// Field of a link in a team file that a transport reads. Transports with a field of the same name share it.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Name of the field, such as `group`.
    pub(crate) name: &'static str,
    /// Type of the values that the field takes.
    pub(crate) takes: FieldType,
    /// Function that returns the default, as written in a team file, for the link with the given index; `None` for no
    /// default.
    pub(crate) default: Option<fn(usize) -> String>,
    /// Whether the field is a table with a value for each host of the team, by the host's name.
    pub(crate) by_host: bool,
}

impl Field {
    /// Returns a field that takes one value of the type `takes` for all hosts and has no default.
    pub const fn new(name: &'static str, takes: FieldType) -> Field {
        Field { name, takes, default: None, by_host: false }
    }

    /// Whether two fields have the same name and type, as fields that share a name must.
    pub(crate) fn agrees(&self, other: &Field) -> bool {
        (self.name, self.by_host, self.takes) == (other.name, other.by_host, other.takes)
    }
}

/// Value of a field of a team file, with the field's name for errors.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldValue {
    /// Value of the field of the team file.
    pub value: Value,
    /// Name of the field for errors, with the line, flag or variable that set it.
    pub place: String,
}

/// Settings of one link for one host of the team.
#[derive(Clone, Debug)]
pub struct LinkSettings<'a> {
    /// Name of the link.
    pub link: &'a str,
    /// Number of the team; `None` if the file has none, which is refused elsewhere.
    pub team: Option<u16>,
    /// Id of the host that the settings are for.
    pub host: HostId,
    /// Names of all hosts, indexed by id.
    pub hosts: Vec<&'a str>,
    /// Values of the transport's fields; those of a table by host have keys such as `peers.robot-0`. Fields that are
    /// not set and have no default are left out.
    pub values: BTreeMap<String, FieldValue>,
}

impl LinkSettings<'_> {
    /// Returns the value of a field of the link; `None` if it is not set and has no default.
    pub fn find(&self, field: &str) -> Option<&Value> {
        self.values.get(field).map(|field| &field.value)
    }

    /// Returns the value of a field that must be set. If it is missing, the error names it and ends with `advice`.
    pub fn need(&self, field: &str, advice: impl FnOnce() -> String) -> Result<&Value, ConfigError> {
        self.find(field).ok_or_else(|| self.wrong(field, format!("missing{}", advice())))
    }

    /// Returns an error that names the field `field` and gives the reason `why`.
    pub fn wrong(&self, field: &str, why: impl Into<String>) -> ConfigError {
        let place = self.values.get(field).map(|field| field.place.clone());
        ConfigError::field(place.unwrap_or_else(|| format!("link.{}.{field}", self.link)), why)
    }

    /// Returns the name of the host that the settings are for.
    pub(crate) fn host_name(&self) -> &str {
        self.hosts[usize::from(self.host.0)]
    }
}
