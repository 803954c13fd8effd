//! The settings of a driver or a source, as a deployment has them.

use serde::{Deserialize, Serialize};

use crate::config::{ConfigError, unquoted};

/// The settings of a driver or a source: which one, and a table that only it can read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Its name in the registry.
    pub name: String,
    /// What it wants to know.
    #[serde(flatten)]
    pub table: toml::Table,
}

impl Settings {
    /// The table as a type of the driver's or source's own. An error says what is wrong and quotes no value.
    pub fn read<T: for<'a> Deserialize<'a>>(&self) -> Result<T, ConfigError> {
        let wrong = |error: toml::de::Error| ConfigError::field(&self.name, unquoted(error.message()));
        toml::Value::Table(self.table.clone()).try_into().map_err(wrong)
    }
}
