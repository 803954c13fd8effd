//! Types and values of configuration fields that are read one by one from a file, the environment or a command-line
//! flag.

use std::fmt;
use std::net::SocketAddr;

use toml::de::DeValue;

use super::is_key;

/// Value of a configuration field, read from a file, the environment or a command-line flag.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A whole number, zero or above.
    Whole(u64),
    /// A number, with or without decimals.
    Number(f64),
    /// A text: a name, a path, or one of several permitted words.
    Text(String),
    /// A network address (IP address and port).
    Address(SocketAddr),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Whole(whole) => write!(f, "{whole}"),
            Value::Number(number) => write!(f, "{number}"),
            Value::Text(text) => f.write_str(text),
            Value::Address(address) => write!(f, "{address}"),
        }
    }
}

impl Value {
    /// Returns the text of a value whose field has a text type.
    ///
    /// # Panics
    /// If the value is not a text.
    pub fn text(&self) -> &str {
        let Value::Text(text) = self else { panic!("the field lets only texts through") };
        text
    }

    /// Returns the whole number of a value whose field has the type `Whole`.
    ///
    /// # Panics
    /// If the value is not a whole number.
    pub fn whole(&self) -> u64 {
        let Value::Whole(whole) = self else { panic!("the field lets only whole numbers through") };
        *whole
    }

    /// Returns the number of a value whose field has the type `Number`.
    ///
    /// # Panics
    /// If the value is not a `Number`; a whole number does not count as one.
    pub fn number(&self) -> f64 {
        let Value::Number(number) = self else { panic!("the field lets only numbers through") };
        *number
    }

    /// Returns the network address of a value whose field has the type `Address`.
    ///
    /// # Panics
    /// If the value is not an address.
    pub fn address(&self) -> SocketAddr {
        let Value::Address(address) = self else { panic!("the field lets only addresses through") };
        *address
    }
}

/// Type of a configuration field, with the values that it permits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldType {
    /// A whole number from the first to the second value, both included.
    Whole(u64, u64),
    /// A number from the first to the second value, both included.
    Number(f64, f64),
    /// A text that is not empty and not a team key (the team's secret of 64 hexadecimal digits).
    Text,
    /// The path of a file: a text; in a file it is relative to the file's folder.
    Path,
    /// The name of a network interface, such as `wlan0`.
    Interface,
    /// One of the words in this list.
    Choice(&'static [&'static str]),
    /// A network address: an IP address with a port above zero.
    Address,
}

impl FieldType {
    /// Reads a value of this type from `text`, as in a command-line flag. An error describes the fault.
    pub fn read(self, text: &str) -> Result<Value, String> {
        match self {
            FieldType::Whole(least, most) => match text.parse::<u64>() {
                Ok(whole) if (least..=most).contains(&whole) => Ok(Value::Whole(whole)),
                _ => Err(format!("'{text}' is not a whole number of {least} to {most}")),
            },
            FieldType::Number(least, most) => match text.parse::<f64>() {
                Ok(number) if (least..=most).contains(&number) => Ok(Value::Number(number)),
                _ => Err(format!("'{text}' is not a number of {least} to {most}")),
            },
            FieldType::Text | FieldType::Path if text.is_empty() => {
                Err("it is empty; leave it out or fill it in".to_owned())
            }
            FieldType::Text | FieldType::Path if is_key(text.as_bytes()) => {
                Err("it is a key itself, where a name or path belongs: keep it in a file and give its path".to_owned())
            }
            FieldType::Text | FieldType::Path => Ok(Value::Text(text.to_owned())),
            // As in Linux: IFNAMSIZ is 16 with the terminating zero, and these characters are refused.
            FieldType::Interface => {
                let fits = (1..16).contains(&text.len()) && !text.contains(|c: char| c.is_whitespace() || c == '/');
                let name = || Value::Text(text.to_owned());
                fits.then(name).ok_or_else(|| format!("'{text}' is not an interface's name"))
            }
            FieldType::Choice(names) if names.contains(&text) => Ok(Value::Text(text.to_owned())),
            FieldType::Choice(names) => Err(format!("'{text}' is not one of {}", names.join(", "))),
            FieldType::Address => match text.parse::<SocketAddr>() {
                Ok(address) if address.port() > 0 => Ok(Value::Address(address)),
                _ => Err(format!(
                    "'{text}' is not an address with a port, such as 239.255.77.1:7700 or [ff02::4d75]:7700"
                )),
            },
        }
    }

    /// Reads a value of this type from a parsed TOML value, in which texts have quotes and numbers have none. An error
    /// describes the fault.
    pub fn read_toml(self, value: &DeValue<'_>) -> Result<Value, String> {
        let wanted = match self {
            FieldType::Whole(..) => "a whole number",
            FieldType::Number(..) => "a number",
            _ => "a text in quotes",
        };
        match (self, value) {
            (FieldType::Whole(..), DeValue::Integer(whole)) => {
                let read = u64::from_str_radix(whole.as_str().trim_start_matches('+'), whole.radix());
                self.read(&read.map_or_else(|_| whole.as_str().to_owned(), |whole| whole.to_string()))
            }
            (FieldType::Number(..), DeValue::Integer(number)) => self.read(number.as_str()),
            (FieldType::Number(..), DeValue::Float(number)) => self.read(number.as_str()),
            (FieldType::Whole(..) | FieldType::Number(..), _) => {
                Err(format!("a {} where {wanted} belongs", value.type_str()))
            }
            (_, DeValue::String(text)) => self.read(text),
            _ => Err(format!("a {} where {wanted} belongs", value.type_str())),
        }
    }
}
