//! The values of a team file in layers: flag over environment over file, each with where it came from. What fields
//! there are and what they take stands here and nowhere else; what they mean for a team is in `team`.
//!
//! Pure: the file's text, the environment and the flags are handed in.

use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::config::{self, ConfigError, syntax};
use crate::deploy::MODES;
use crate::net::protocol::reliability::Reliability;
use crate::world::Sensor;

/// Where a value comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A flag, by its name.
    Flag(&'static str),
    /// A variable of the environment, by its name.
    Environment(String),
    /// This line of the team file.
    File(usize),
    /// Nobody has said anything.
    Default,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Origin::Flag(flag) => f.write_str(flag),
            Origin::Environment(name) => f.write_str(name),
            Origin::File(line) => write!(f, "line {line}"),
            Origin::Default => f.write_str("default"),
        }
    }
}

/// The value of a field.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A whole number.
    Whole(u64),
    /// A number.
    Number(f64),
    /// A text: a name, a path, one of a few words.
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

/// A value and where it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// The value.
    pub value: Value,
    /// Where it comes from.
    pub origin: Origin,
}

/// A value that a flag sets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Flag {
    /// The flag's name, for errors and as an origin.
    pub flag: &'static str,
    /// The field.
    pub key: String,
    /// What it is set to.
    pub value: String,
}

/// What a field takes.
#[derive(Clone, Copy, Debug)]
enum Takes {
    Whole(u64, u64),
    Number(f64, f64),
    Text,
    Interface,
    Choice(&'static [&'static str]),
    Address,
}

/// A field: its name, what it takes, and its default as it would be written.
type Field = (&'static str, Takes, Option<&'static str>);

/// The name of the field that stands for every link's interface in flags and in the environment.
pub const EVERY_INTERFACE: &str = "interface";

/// How a kind of message is made to arrive.
pub const RELIABILITIES: [&str; 4] = {
    let [(a, _), (b, _), (c, _), (d, _)] = Reliability::NAMED;
    [a, b, c, d]
};

/// How the states of simulated robots are measured.
const SENSORS: [&str; 2] = {
    let [(a, _), (b, _)] = Sensor::NAMED;
    [a, b]
};

/// The fields of the whole team, in the order in which they are shown.
const TEAM: [Field; 16] = [
    ("team", Takes::Whole(0, 65_535), None),
    ("key_file", Takes::Text, None),
    ("mode", Takes::Choice(&MODES), None),
    ("robots", Takes::Whole(1, 65_535), None),
    ("scenario", Takes::Text, Some("passage")),
    ("policy", Takes::Text, None),
    ("episodes", Takes::Whole(1, 1_000_000), Some("16")),
    ("seed", Takes::Whole(0, u64::MAX), Some("0")),
    ("plant", Takes::Text, None),
    ("lag_s", Takes::Number(0.0, 10.0), None),
    ("contacts", Takes::Choice(&["block", "judge"]), None),
    ("wall_radius_m", Takes::Number(1e-3, 10.0), None),
    ("sensor", Takes::Choice(&SENSORS), None),
    ("clamp", Takes::Choice(&["training", "deployed"]), Some("training")),
    ("handling", Takes::Choice(&["hold", "as-published"]), Some("hold")),
    ("estimator", Takes::Text, Some("none")),
];

/// The fields of a link, beside its tables `peers` and `reliability`.
const LINK: [Field; 4] = [
    ("transport", Takes::Choice(&["multicast", "unicast"]), Some("multicast")),
    ("interface", Takes::Interface, None),
    ("group", Takes::Address, None),
    ("receive_buffer_bytes", Takes::Whole(4096, 1 << 30), Some("4194304")),
];

/// What of the team a robot or a host may have otherwise, beside its links.
const OVERRIDES: [&str; 2] = ["key_file", "policy"];

/// Variables of the environment that are no fields.
const OTHER_VARIABLES: [&str; 1] = ["MURMURATE_LOG"];

/// The names of the fields of the whole team.
pub fn team_fields() -> impl Iterator<Item = &'static str> {
    TEAM.iter().map(|(name, ..)| *name)
}

/// The names of the fields of a link.
pub fn link_fields() -> impl Iterator<Item = &'static str> {
    LINK.iter().map(|(name, ..)| *name)
}

/// What a field takes and its default; `None` if there is no such field.
fn field(key: &str) -> Option<(Takes, Option<&'static str>)> {
    let named = |fields: &[Field], name: &str| {
        fields.iter().find(|(field, ..)| *field == name).map(|(_, takes, default)| (*takes, *default))
    };
    match key.split('.').collect::<Vec<_>>()[..] {
        [name] => named(&TEAM, name),
        ["link", _, name] => named(&LINK, name),
        ["link", _, "peers", _] => Some((Takes::Address, None)),
        ["link", _, "reliability", _] => Some((Takes::Choice(&RELIABILITIES), None)),
        ["robot" | "host", _, name] if OVERRIDES.contains(&name) => named(&TEAM, name),
        // What senders and receivers must agree on is of the whole team.
        ["robot" | "host", _, "link", _, "reliability", ..] => None,
        ["robot" | "host", _, "link", ..] => field(key.splitn(3, '.').nth(2)?),
        _ => None,
    }
}

/// What there is where there is no such field.
fn siblings(key: &str) -> String {
    let names = match key.split('.').collect::<Vec<_>>()[..] {
        ["link", _, "reliability", ..] => return "a kind of message is followed by its reliability".to_owned(),
        ["link", name, ..] => {
            let fields: Vec<&str> = link_fields().chain(["peers", "reliability"]).collect();
            return format!("link.{name} has {}", fields.join(", "));
        }
        ["robot" | "host", name, ..] => return format!("{name} may have {}, link", OVERRIDES.join(", ")),
        _ => team_fields().chain(["deployment", "link", "robot", "host"]),
    };
    format!("there are {}", names.collect::<Vec<_>>().join(", "))
}

impl Takes {
    /// Reads a value; the error says what is wrong.
    fn read(self, text: &str) -> Result<Value, String> {
        match self {
            Takes::Whole(least, most) => match text.parse::<u64>() {
                Ok(whole) if (least..=most).contains(&whole) => Ok(Value::Whole(whole)),
                _ => Err(format!("'{text}' is no whole number of {least} to {most}")),
            },
            Takes::Number(least, most) => match text.parse::<f64>() {
                Ok(number) if (least..=most).contains(&number) => Ok(Value::Number(number)),
                _ => Err(format!("'{text}' is no number of {least} to {most}")),
            },
            Takes::Text if text.is_empty() => Err("it is empty; leave it out or fill it in".to_owned()),
            Takes::Text if config::is_key(text.as_bytes()) => {
                Err("it is a key itself, where the name of something belongs: keep it in a file and name that"
                    .to_owned())
            }
            Takes::Text => Ok(Value::Text(text.to_owned())),
            // As Linux has it: IFNAMSIZ is 16 with its end, and these characters are refused.
            Takes::Interface => {
                let fits = (1..16).contains(&text.len()) && !text.contains(|c: char| c.is_whitespace() || c == '/');
                if fits { Ok(Value::Text(text.to_owned())) } else { Err(format!("'{text}' is no interface's name")) }
            }
            Takes::Choice(names) if names.contains(&text) => Ok(Value::Text(text.to_owned())),
            Takes::Choice(names) => Err(format!("'{text}' is not one of {}", names.join(", "))),
            Takes::Address => match text.parse::<SocketAddr>() {
                Ok(address) if address.port() > 0 => Ok(Value::Address(address)),
                _ => Err(format!("'{text}' is no address with a port, such as 239.255.77.1:7700 or [ff02::4d75]:7700")),
            },
        }
    }

    /// Reads a value of the file, where numbers are numbers and texts have quotes.
    fn read_toml(self, value: &DeValue<'_>) -> Result<Value, String> {
        let wanted = match self {
            Takes::Whole(..) => "a whole number",
            Takes::Number(..) => "a number",
            _ => "a text in quotes",
        };
        match (self, value) {
            (Takes::Whole(..), DeValue::Integer(whole)) => {
                let read = u64::from_str_radix(whole.as_str().trim_start_matches('+'), whole.radix());
                self.read(&read.map_or_else(|_| whole.as_str().to_owned(), |whole| whole.to_string()))
            }
            (Takes::Number(..), DeValue::Integer(number)) => self.read(number.as_str()),
            (Takes::Number(..), DeValue::Float(number)) => self.read(number.as_str()),
            (Takes::Whole(..) | Takes::Number(..), _) => Err(format!("a {} where {wanted} belongs", value.type_str())),
            (_, DeValue::String(text)) => self.read(text),
            _ => Err(format!("a {} where {wanted} belongs", value.type_str())),
        }
    }
}

/// How errors name a field.
pub fn place(key: &str, origin: &Origin) -> String {
    match origin {
        Origin::Default => key.to_owned(),
        Origin::Flag(flag) if *flag != "--set" => (*flag).to_owned(),
        _ => format!("{key} ({origin})"),
    }
}

/// The layers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layers {
    flags: BTreeMap<String, Entry>,
    environment: BTreeMap<String, Entry>,
    file: BTreeMap<String, Entry>,
    /// The lines on which the file's tables begin that are read as a whole, and those of their fields.
    tables: BTreeMap<String, usize>,
}

impl Layers {
    /// Reads the file and the flags; the environment's `MURMURATE_…` follow once the links are known. The tables in
    /// `whole` are left to others.
    pub fn read(text: &str, flags: &[Flag], whole: &[&str]) -> Result<Layers, ConfigError> {
        let mut layers = Layers::default();
        let table = DeTable::parse(text).map_err(|error| syntax(text, &error))?;
        layers.flatten(text, "", table.get_ref(), whole)?;
        for Flag { flag, key, value } in flags {
            let origin = Origin::Flag(flag);
            let takes = if key == EVERY_INTERFACE { Some((Takes::Interface, None)) } else { field(key) };
            let (takes, _) = takes.ok_or_else(|| unknown(key, &origin))?;
            let value = takes.read(value).map_err(|why| ConfigError::field(place(key, &origin), why))?;
            layers.flags.insert(key.clone(), Entry { value, origin });
        }
        Ok(layers)
    }

    fn flatten(&mut self, text: &str, prefix: &str, table: &DeTable<'_>, whole: &[&str]) -> Result<(), ConfigError> {
        let entries: Vec<(&Spanned<_>, &Spanned<DeValue<'_>>)> = table.iter().collect();
        for (name, value) in entries {
            let line = line_of(text, &name.span());
            let origin = Origin::File(line);
            let name: &str = name.get_ref();
            let key = if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") };
            if name.is_empty() || name.contains('.') {
                let why = "a name in a team file is not empty and has no dot; rename it in the deployment";
                return Err(ConfigError::field(place(&key, &origin), why));
            }
            if whole.contains(&key.as_str()) {
                if let DeValue::Table(inner) = value.get_ref() {
                    let fields = inner.keys().map(|field| (format!("{key}.{}", field.get_ref()), field.span()));
                    self.tables.extend(fields.map(|(field, span)| (field, line_of(text, &span))));
                }
                self.tables.insert(key, line);
                continue;
            }
            match (field(&key), value.get_ref()) {
                (Some((takes, _)), value) => {
                    let value = takes.read_toml(value).map_err(|why| ConfigError::field(place(&key, &origin), why))?;
                    self.file.insert(key, Entry { value, origin });
                }
                (None, DeValue::Table(inner)) if holds_fields(&key) => self.flatten(text, &key, inner, whole)?,
                (None, _) => return Err(unknown(&key, &origin)),
            }
        }
        Ok(())
    }

    /// Takes the fields of the whole team from the environment.
    pub fn read_environment(&mut self, variables: &[(String, String)]) -> Result<(), ConfigError> {
        let fields: Vec<String> = team_fields().map(str::to_owned).collect();
        self.take(variables, &fields)
    }

    /// Takes the fields of these links from the environment; then nothing unknown may be left in it.
    pub fn read_link_environment(
        &mut self,
        variables: &[(String, String)],
        fields: &[String],
    ) -> Result<(), ConfigError> {
        self.take(variables, fields)?;
        let known = |name: &str| {
            let mut all = self.environment.values().map(|entry| &entry.origin);
            OTHER_VARIABLES.contains(&name) || all.any(|origin| matches!(origin, Origin::Environment(n) if n == name))
        };
        match variables.iter().find(|(name, _)| name.starts_with("MURMURATE_") && !known(name)) {
            None => Ok(()),
            Some((name, _)) => Err(ConfigError::field(
                name,
                "no such variable; a field's is its name in capitals, such as MURMURATE_KEY_FILE or \
                 MURMURATE_LINK_INFRA_INTERFACE",
            )),
        }
    }

    fn take(&mut self, variables: &[(String, String)], fields: &[String]) -> Result<(), ConfigError> {
        for key in fields {
            let name = variable(key);
            let Some((_, value)) = variables.iter().find(|(other, _)| *other == name) else { continue };
            let origin = Origin::Environment(name);
            let takes = field(key).map_or(Takes::Interface, |(takes, _)| takes);
            let value = takes.read(value).map_err(|why| ConfigError::field(place(key, &origin), why))?;
            self.environment.insert(key.clone(), Entry { value, origin });
        }
        Ok(())
    }

    /// The value of a field as these scopes see it, the narrowest first (each a prefix such as `host.pc.`, the last
    /// one empty): a higher layer counts before a narrower scope, and a default last.
    pub fn find(&self, scopes: &[String], key: &str) -> Option<Entry> {
        let every = (key.starts_with("link.") && key.ends_with(".interface")).then_some(EVERY_INTERFACE);
        for layer in [&self.flags, &self.environment, &self.file] {
            let scoped = scopes.iter().find_map(|scope| layer.get(&format!("{scope}{key}")));
            if let Some(entry) = scoped.or_else(|| layer.get(every?)) {
                return Some(entry.clone());
            }
        }
        let (takes, default) = field(key)?;
        let value = takes.read(default?).expect("defaults are sound");
        Some(Entry { value, origin: Origin::Default })
    }

    /// Every field that is set below this prefix, whatever the layer.
    pub fn below<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = (&'a str, &'a Entry)> {
        let layers = [&self.flags, &self.environment, &self.file];
        layers
            .into_iter()
            .flatten()
            .filter(move |(key, _)| key.starts_with(prefix))
            .map(|(key, entry)| (key.as_str(), entry))
    }

    /// The line on which a table begins that is read as a whole, or a field of one stands, as `table.field`.
    pub fn table(&self, name: &str) -> Option<usize> {
        self.tables.get(name).copied()
    }
}

/// The variable of the environment that sets a field.
pub fn variable(key: &str) -> String {
    let name = key.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' });
    format!("MURMURATE_{}", name.collect::<String>())
}

fn line_of(text: &str, span: &Range<usize>) -> usize {
    text[..span.start].matches('\n').count() + 1
}

/// Whether a table of this name holds fields.
fn holds_fields(key: &str) -> bool {
    let parts: Vec<&str> = key.split('.').collect();
    match parts[..] {
        ["robot" | "host"] | ["robot" | "host", _] => true,
        // What senders and receivers must agree on is of the whole team.
        ["robot" | "host", _, ref link @ ..] => link.last() != Some(&"reliability") && holds_link_fields(link),
        ref link => holds_link_fields(link),
    }
}

fn holds_link_fields(parts: &[&str]) -> bool {
    matches!(parts, ["link"] | ["link", _] | ["link", _, "peers" | "reliability"])
}

fn unknown(key: &str, origin: &Origin) -> ConfigError {
    let place = format!("{key} ({origin})");
    ConfigError::field(place, format!("there is no such field; {}", siblings(key)))
}
