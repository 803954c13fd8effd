//! Values of a team file in layers. A flag overrides an environment variable, which overrides the file. Each value has
//! its origin. `fields` has the fields and their types, `team` their meaning.
//!
//! Pure: the caller passes the file's text, the environment and the flags.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::fields::{EVERY_INTERFACE, Fields, team_fields};
use crate::config::fields::{FieldType, Value};
use crate::config::{ConfigError, syntax};
use crate::net::transport;

/// Origin of the value of a field: command line flag, environment variable, team file or default.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The value was set by the command line flag with this name.
    Flag(&'static str),
    /// The value was set by the environment variable with this name.
    Environment(String),
    /// The value was set in the team file, at this line.
    File(usize),
    /// The value is the default of the field.
    Default,
}

impl Origin {
    /// Returns the layer of the value: a value of a higher layer takes precedence.
    pub fn layer(&self) -> u8 {
        match self {
            Origin::Default => 0,
            Origin::File(_) => 1,
            Origin::Environment(_) => 2,
            Origin::Flag(_) => 3,
        }
    }
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

/// Value of a field of a team file, with the origin of the value.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerValue {
    /// Value of the field of the team file.
    pub value: Value,
    /// Origin of the value: file, environment variable, flag or default.
    pub origin: Origin,
}

/// Command line flag that sets a field of the team file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Flag {
    /// Name of the flag, for errors and as the origin of the value.
    pub flag: &'static str,
    /// Key of the field that the flag sets, such as `link.radio.interface`.
    pub key: String,
    /// Value of the field as text, as written on the command line.
    pub value: String,
}

/// Environment variables with the prefix `MURMURATE_` that set no field of a team file.
const OTHER_VARIABLES: [&str; 1] = ["MURMURATE_LOG"];

/// Returns the name of a field in error texts: its key with the origin of its value, or the name of the flag that sets
/// it.
pub fn place(key: &str, origin: &Origin) -> String {
    match origin {
        Origin::Default => key.to_owned(),
        Origin::Flag(flag) if *flag != "--set" => (*flag).to_owned(),
        _ => format!("{key} ({origin})"),
    }
}

/// Values of the fields of a team file in three layers, of which a later one takes precedence: the file, the
/// environment and command line flags.
#[derive(Clone, Debug)]
pub struct Layers {
    fields: Fields,
    flags: BTreeMap<String, LayerValue>,
    environment: BTreeMap<String, LayerValue>,
    file: BTreeMap<String, LayerValue>,
    /// Line numbers in the file of the tables that the caller parses as a whole, and of their fields, by key.
    tables: BTreeMap<String, usize>,
}

impl Layers {
    /// Reads the team file `text` and the flags. An error names the line, the field or the flag. The tables named in
    /// `whole` are left to the caller, `transports` define the fields of links. Environment variables are read later,
    /// when the links are known.
    pub fn read(
        text: &str,
        flags: &[Flag],
        whole: &[&str],
        transports: &[transport::Entry],
    ) -> Result<Layers, ConfigError> {
        let mut layers = Layers {
            fields: Fields::of(transports),
            flags: BTreeMap::new(),
            environment: BTreeMap::new(),
            file: BTreeMap::new(),
            tables: BTreeMap::new(),
        };
        let table = DeTable::parse(text).map_err(|error| syntax(text, &error))?;
        layers.flatten(text, "", table.get_ref(), whole)?;
        for Flag { flag, key, value } in flags {
            let origin = Origin::Flag(flag);
            let takes =
                if key == EVERY_INTERFACE { Some((FieldType::Interface, None)) } else { layers.fields.field(key) };
            let (takes, _) = takes.ok_or_else(|| layers.unknown(key, &origin))?;
            let value = takes.read(value).map_err(|why| ConfigError::field(place(key, &origin), why))?;
            layers.flags.insert(key.clone(), LayerValue { value, origin });
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
            match (self.fields.field(&key), value.get_ref()) {
                (Some((takes, _)), value) => {
                    let value = takes.read_toml(value).map_err(|why| ConfigError::field(place(&key, &origin), why))?;
                    self.file.insert(key, LayerValue { value, origin });
                }
                (None, DeValue::Table(inner)) if self.fields.holds_fields(&key) => {
                    self.flatten(text, &key, inner, whole)?
                }
                (None, _) => return Err(self.unknown(&key, &origin)),
            }
        }
        Ok(())
    }

    /// Reads the fields of the whole team from environment variables. An error names the variable.
    pub fn read_environment(&mut self, variables: &[(String, String)]) -> Result<(), ConfigError> {
        let fields: Vec<String> = team_fields().map(str::to_owned).collect();
        self.take(variables, &fields)
    }

    /// Reads the fields of links, with the keys `fields`, from environment variables. An error names a variable with a
    /// wrong value, or an unknown one that begins with `MURMURATE_`.
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
            let takes = self.fields.field(key).map_or(FieldType::Interface, |(takes, _)| takes);
            let value = takes.read(value).map_err(|why| ConfigError::field(place(key, &origin), why))?;
            self.environment.insert(key.clone(), LayerValue { value, origin });
        }
        Ok(())
    }

    /// Returns the fields that the team file may contain.
    pub fn fields(&self) -> &Fields {
        &self.fields
    }

    fn unknown(&self, key: &str, origin: &Origin) -> ConfigError {
        let place = format!("{key} ({origin})");
        ConfigError::field(place, format!("there is no such field; {}", self.fields.siblings(key)))
    }

    /// Returns the value of a field with its origin; `None` if it is not set and has no default. `scopes` are prefixes
    /// such as `host.pc.`, the narrowest first and the empty one last. A higher layer (flag, environment, file) takes
    /// precedence over a narrower prefix. Defaults of a transport's fields are not included; they are in the
    /// transport's entry.
    pub fn find(&self, scopes: &[String], key: &str) -> Option<LayerValue> {
        let every = (key.starts_with("link.") && key.ends_with(".interface")).then_some(EVERY_INTERFACE);
        for layer in [&self.flags, &self.environment, &self.file] {
            let scoped = scopes.iter().find_map(|scope| layer.get(&format!("{scope}{key}")));
            if let Some(entry) = scoped.or_else(|| layer.get(every?)) {
                return Some(entry.clone());
            }
        }
        let (takes, default) = self.fields.field(key)?;
        let value = takes.read(default?).expect("defaults are sound");
        Some(LayerValue { value, origin: Origin::Default })
    }

    /// Returns key and value of every field whose key begins with `prefix`, once for each layer (flag, environment,
    /// file) that sets it.
    pub fn below<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = (&'a str, &'a LayerValue)> {
        let layers = [&self.flags, &self.environment, &self.file];
        layers
            .into_iter()
            .flatten()
            .filter(move |(key, _)| key.starts_with(prefix))
            .map(|(key, entry)| (key.as_str(), entry))
    }

    /// Returns the line number in the file of the table `name` (one of those left to the caller of `read`), or of its
    /// field if `name` is `table.field`; `None` if the file does not contain it.
    pub fn table(&self, name: &str) -> Option<usize> {
        self.tables.get(name).copied()
    }
}

/// Returns the name of the environment variable that sets the field `key`, such as `MURMURATE_KEY_FILE`.
pub fn variable(key: &str) -> String {
    let name = key.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' });
    format!("MURMURATE_{}", name.collect::<String>())
}

fn line_of(text: &str, span: &Range<usize>) -> usize {
    text[..span.start].matches('\n').count() + 1
}
