//! Settings of a driver or a source in a deployment.

use serde::{Deserialize, Serialize};

use crate::config::{ConfigError, unquoted};

/// Settings of a driver or a source: its name, and a table that only it interprets.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Its name in the registry.
    pub name: String,
    /// Its own settings.
    #[serde(flatten)]
    pub table: toml::Table,
}

impl Settings {
    /// Reads the table as a type of the driver or source. An error says what is wrong and quotes no value.
    pub fn read<T: for<'a> Deserialize<'a>>(&self) -> Result<T, ConfigError> {
        let wrong = |error: toml::de::Error| ConfigError::field(&self.name, unquoted(error.message()));
        toml::Value::Table(self.table.clone()).try_into().map_err(wrong)
    }
}
