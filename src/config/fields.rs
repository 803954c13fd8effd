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
    /// True or false.
    Truth(bool),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Whole(whole) => write!(f, "{whole}"),
            Value::Number(number) => write!(f, "{number}"),
            Value::Text(text) => f.write_str(text),
            Value::Address(address) => write!(f, "{address}"),
            Value::Truth(truth) => write!(f, "{truth}"),
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
    pub(crate) fn whole(&self) -> u64 {
        let Value::Whole(whole) = self else { panic!("the field lets only whole numbers through") };
        *whole
    }

    /// Returns the number of a value whose field has the type `Number`.
    ///
    /// # Panics
    /// If the value is not a `Number`; a whole number does not count as one.
    pub(crate) fn number(&self) -> f64 {
        let Value::Number(number) = self else { panic!("the field lets only numbers through") };
        *number
    }

    /// Returns the network address of a value whose field has the type `Address`.
    ///
    /// # Panics
    /// If the value is not an address.
    pub(crate) fn address(&self) -> SocketAddr {
        let Value::Address(address) = self else { panic!("the field lets only addresses through") };
        *address
    }

    /// Returns the truth of a value whose field has the type `Truth`.
    ///
    /// # Panics
    /// If the value is neither true nor false.
    pub(crate) fn truth(&self) -> bool {
        let Value::Truth(truth) = self else { panic!("the field lets only true and false through") };
        *truth
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
    /// A network address, or the name of a host with a port above zero, which is resolved while the program runs.
    HostAddress,
    /// True or false.
    Truth,
}

/// Longest name of a host (RFC 1035, section 2.3.4).
const LONGEST_NAME: usize = 253;

/// Splits `text` into the name of a host and a port above zero, as in `robot-2.local:7700`. An error describes the
/// fault.
pub(crate) fn host_and_port(text: &str) -> Result<(&str, u16), String> {
    let wrong = || {
        format!(
            "'{text}' is not an address or a name of a host with a port, such as 10.0.0.2:7700 or robot-2.local:7700"
        )
    };
    let (name, port) = text.rsplit_once(':').ok_or_else(wrong)?;
    let port = port.parse::<u16>().ok().filter(|port| *port > 0).ok_or_else(wrong)?;
    let is_label = |label: &str| {
        let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        (1..64).contains(&label.len()) && label.chars().all(fits) && !label.starts_with('-') && !label.ends_with('-')
    };
    let labels = name.strip_suffix('.').unwrap_or(name);
    // A mistyped IP address is no name.
    let is_number = labels.chars().all(|c| c.is_ascii_digit() || c == '.');
    let fits = labels.len() <= LONGEST_NAME && labels.split('.').all(is_label) && !is_number;
    if fits { Ok((name, port)) } else { Err(wrong()) }
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
            FieldType::HostAddress => match text.parse::<SocketAddr>() {
                Ok(address) if address.port() > 0 => Ok(Value::Address(address)),
                _ => host_and_port(text).map(|_| Value::Text(text.to_owned())),
            },
            FieldType::Truth => match text.parse() {
                Ok(truth) => Ok(Value::Truth(truth)),
                Err(_) => Err(format!("'{text}' is neither true nor false")),
            },
        }
    }

    /// Reads a value of this type from a parsed TOML value, in which texts have quotes and numbers have none. An error
    /// describes the fault.
    pub(crate) fn read_toml(self, value: &DeValue<'_>) -> Result<Value, String> {
        let wanted = match self {
            FieldType::Whole(..) => "a whole number",
            FieldType::Number(..) => "a number",
            FieldType::Truth => "true or false",
            _ => "a text in quotes",
        };
        match (self, value) {
            (FieldType::Whole(..), DeValue::Integer(whole)) => {
                let read = u64::from_str_radix(whole.as_str().trim_start_matches('+'), whole.radix());
                self.read(&read.map_or_else(|_| whole.as_str().to_owned(), |whole| whole.to_string()))
            }
            (FieldType::Number(..), DeValue::Integer(number)) => self.read(number.as_str()),
            (FieldType::Number(..), DeValue::Float(number)) => self.read(number.as_str()),
            (FieldType::Truth, DeValue::Boolean(truth)) => Ok(Value::Truth(*truth)),
            (FieldType::Whole(..) | FieldType::Number(..) | FieldType::Truth, _) => {
                Err(format!("a {} where {wanted} belongs", value.type_str()))
            }
            (_, DeValue::String(text)) => self.read(text),
            _ => Err(format!("a {} where {wanted} belongs", value.type_str())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_of_a_host_is_an_ip_address_or_a_name_with_a_port() {
        let read = |text: &str| FieldType::HostAddress.read(text);
        assert_eq!(read("10.0.0.2:7700"), Ok(Value::Address(SocketAddr::from(([10, 0, 0, 2], 7700)))));
        assert!(matches!(read("[fe80::1]:7700"), Ok(Value::Address(_))));
        for name in ["robot-2:1", "robot-2.local:7700", "a.b.c.:65535", "R2_arm.lan:9", "2fast:9"] {
            assert_eq!(read(name), Ok(Value::Text(name.to_owned())), "{name}");
        }
        let long = format!("{}:7700", ["a"; 130].join("."));
        for wrong in
            ["robot-2", "robot-2:0", "robot-2:65536", ":7700", "a..b:1", "-a:1", "a-:1", "a b:1", "10.0.0:1", &long, ""]
        {
            let why = read(wrong).expect_err(wrong);
            assert!(why.contains("robot-2.local:7700"), "{why}");
        }
        assert_eq!(host_and_port("robot-2.local:7700"), Ok(("robot-2.local", 7700)));
    }
}
