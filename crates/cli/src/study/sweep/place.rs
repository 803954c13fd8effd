//! Quantity that an axis of a sweep varies, and its values.

use toml::Value;

/// Quantity that an axis varies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A flag of `sim`, without `--`.
    Flag(String),
    /// A field in the file that a flag names.
    Field {
        /// The flag, without `--`.
        flag: String,
        /// Path of the field in the file.
        field: Vec<String>,
    },
}

impl Place {
    /// Returns the quantity with this name: `FLAG`, or `FLAG.FIELD` for a field in the file of a flag. Whether there is
    /// one is not checked.
    pub fn of(name: &str) -> Place {
        match name.split_once('.') {
            None => Place::Flag(name.to_owned()),
            Some((flag, field)) => {
                Place::Field { flag: flag.to_owned(), field: field.split('.').map(str::to_owned).collect() }
            }
        }
    }
}

/// Returns a value as it would be written in a file (TOML); text needs no quotes.
pub fn toml_value(text: &str) -> Value {
    text.parse().unwrap_or_else(|_| Value::String(text.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_those_of_a_file_and_text_needs_no_quotes() {
        assert_eq!(toml_value("6"), Value::Integer(6));
        assert_eq!(toml_value("0.5"), Value::Float(0.5));
        assert_eq!(toml_value("ofdm-6"), Value::String("ofdm-6".to_owned()));
        assert_eq!(toml_value("\"6\""), Value::String("6".to_owned()));
        assert_eq!(toml_value("[1, 2]").as_array().map(Vec::len), Some(2));
    }
}
