//! Fields that are read one by one from a file, the environment or a flag: their types and values.

use std::fmt;
use std::net::SocketAddr;

use toml::de::DeValue;

use super::is_key;

/// Value of a field.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A whole number.
    Whole(u64),
    /// A number.
    Number(f64),
    /// A text: a name, a path, one of several words.
    Text(String),
    /// An address with its port.
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
    /// The text.
    ///
    /// # Panics
    /// If the field has another type; likewise below.
    pub fn text(&self) -> &str {
        let Value::Text(text) = self else { panic!("the field lets only texts through") };
        text
    }

    /// The whole number.
    pub fn whole(&self) -> u64 {
        let Value::Whole(whole) = self else { panic!("the field lets only whole numbers through") };
        *whole
    }

    /// The number.
    pub fn number(&self) -> f64 {
        let Value::Number(number) = self else { panic!("the field lets only numbers through") };
        *number
    }

    /// The address.
    pub fn address(&self) -> SocketAddr {
        let Value::Address(address) = self else { panic!("the field lets only addresses through") };
        *address
    }
}

/// Type of a field, with its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldType {
    /// A whole number in this range, both ends included.
    Whole(u64, u64),
    /// A number in this range, both ends included.
    Number(f64, f64),
    /// A text that is neither empty nor a key.
    Text,
    /// The name of a network interface.
    Interface,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// An address with its port.
    Address,
}

impl FieldType {
    /// Reads a value; an error describes the fault.
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
            FieldType::Text if text.is_empty() => Err("it is empty; leave it out or fill it in".to_owned()),
            FieldType::Text if is_key(text.as_bytes()) => {
                Err("it is a key itself, where a name or path belongs: keep it in a file and give its path".to_owned())
            }
            FieldType::Text => Ok(Value::Text(text.to_owned())),
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

    /// Reads a value from TOML, where numbers are numbers and texts have quotes.
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
