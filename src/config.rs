//! Reading configuration: TOML, and errors that fit on one line and name the line or the field that is wrong.

use serde::de::DeserializeOwned;

/// Why a configuration cannot be used.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// Not TOML, or a field is missing, unknown or of the wrong type.
    #[error("{0}")]
    Syntax(String),
    /// A field's value makes no sense.
    #[error("{field}: {reason}")]
    Field {
        /// Where.
        field: String,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
}

impl ConfigError {
    /// The error of a field.
    pub fn field(field: impl Into<String>, reason: impl Into<String>) -> ConfigError {
        ConfigError::Field { field: field.into(), reason: reason.into() }
    }

    /// The same error of a table inside of another.
    pub fn within(self, table: &str) -> ConfigError {
        match self {
            ConfigError::Field { field, reason } => ConfigError::field(format!("{table}.{field}"), reason),
            syntax => syntax,
        }
    }
}

/// Reads a value; the error says which line is wrong, what stands there, and why.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|error| syntax(text, &error))
}

/// The error of a text that is not as it should be: the line, what stands there, and why it is wrong.
pub fn syntax(text: &str, error: &toml::de::Error) -> ConfigError {
    let why = error.message().replace('\n', ": ");
    let Some(span) = error.span() else { return ConfigError::Syntax(why) };
    let before = &text[..span.start.min(text.len())];
    let number = before.matches('\n').count();
    let line = text.lines().nth(number).unwrap_or_default().trim();
    ConfigError::Syntax(format!("line {} ({line}): {why}", number + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn an_error_shows_the_line() {
        let error = from_toml::<BTreeMap<String, u32>>("robots = 5\nhosts = \"five\"\n").unwrap_err().to_string();
        assert!(error.starts_with("line 2 (hosts = \"five\"): invalid type"), "{error}");
        assert!(!error.contains('\n'));
    }
}
