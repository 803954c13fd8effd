//! Laboratory file: the stations, their addresses and motion, and the parameters of their radio channel, from TOML.
//!
//! The file is strict: an unknown or wrong field is an error that names the field and its line.

use std::net::Ipv4Addr;

use serde::Deserialize;
use toml::de::{DeTable, DeValue};

use super::path::Path;
use murmurate::config::fields::FieldType;
use murmurate::config::{self, ConfigError};
use murmurate::net::media::radio::{PRESETS, Radio};
use murmurate::time::Span;

/// Largest number of stations: the addresses of a subnet of 24 bits, with some to spare.
pub const MAX_STATIONS: u16 = 200;
/// Name of the cable's interface in each station's namespace.
pub const CABLE: &str = "eth0";
/// Longest name of a laboratory \[characters\]; with a number it names network namespaces.
const MAX_NAME: usize = 24;

/// Laboratory as data: stations with their addresses and paths, and the parameters of their radio channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Laboratory {
    /// Name, to which the number of a station is appended to name its network namespace.
    pub name: String,
    /// Number of stations; they have the numbers from zero.
    pub stations: u16,
    /// Name of the network interface in each station's namespace.
    pub interface: String,
    /// Network address of the subnet of 24 bits in which the stations have their addresses.
    pub subnet: Ipv4Addr,
    /// Network address of a second subnet of 24 bits, if there is one: a cable between all stations, beside the radio,
    /// that neither delays nor loses frames.
    pub cable: Option<Ipv4Addr>,
    /// Parameters of the radio channel.
    pub radio: Radio,
    /// Seed of all random numbers of the channel.
    pub seed: u64,
    /// Whether each station knows the hardware addresses of the others from the start, so that no address resolution
    /// (ARP) goes over the channel.
    pub static_arp: bool,
    /// Whether stations speak IPv6 as well, by addresses of their links.
    pub ipv6: bool,
    /// Lateness from which a delivery counts as late.
    pub late: Span,
    /// Priority of the thread that carries the frames, 1 to 99 (SCHED_FIFO); 0 for an ordinary one.
    pub priority: u8,
    /// Path of each station, by its number; `None` for a station without a position, which is within range of all.
    pub paths: Vec<Option<Path>>,
    /// Command of each station for `lab run`, by its number; empty for a station without one of its own.
    pub commands: Vec<Vec<String>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: Option<String>,
    stations: u16,
    interface: Option<String>,
    subnet: Option<Ipv4Addr>,
    cable: Option<Ipv4Addr>,
    preset: Option<String>,
    seed: Option<u64>,
    #[serde(default)]
    static_arp: bool,
    #[serde(default)]
    ipv6: bool,
    late_us: Option<u64>,
    priority: Option<u8>,
    /// Read for its errors, which have lines; the fields themselves come from the table, on top of the preset.
    #[serde(rename = "radio")]
    _radio: Option<Radio>,
    #[serde(default)]
    station: Vec<StationTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StationTable {
    number: u16,
    position_m: Option<[f64; 2]>,
    path: Option<Vec<[f64; 3]>>,
    #[serde(default)]
    command: Vec<String>,
}

impl Laboratory {
    /// Reads a laboratory from TOML and checks it. An error names the wrong field and its line.
    pub fn from_toml(text: &str) -> Result<Laboratory, ConfigError> {
        let file: File = config::from_toml(text)?;
        Laboratory::of(&file, text).map_err(|error| with_line(text, error))
    }

    fn of(file: &File, text: &str) -> Result<Laboratory, ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        let name = file.name.clone().unwrap_or_else(|| "lab".to_owned());
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if !(1..=MAX_NAME).contains(&name.len())
            || !name.chars().all(plain)
            || !name.ends_with(|c| plain(c) && !digit(c))
        {
            let why = format!("it has 1 to {MAX_NAME} letters, digits, '-' and '_', and no digit at its end");
            return wrong("name", why);
        }
        if !(1..=MAX_STATIONS).contains(&file.stations) {
            return wrong("stations", format!("{} is not 1 to {MAX_STATIONS}", file.stations));
        }
        let interface = file.interface.clone().unwrap_or_else(|| "wlan0".to_owned());
        FieldType::Interface.read(&interface).map_err(|why| ConfigError::field("interface", why))?;
        let subnet = file.subnet.unwrap_or(Ipv4Addr::new(10, 77, 0, 0));
        for (field, network) in [("subnet", Some(subnet)), ("cable", file.cable)] {
            let Some(network) = network else { continue };
            if !network.is_private() || network.octets()[3] != 0 {
                let why = format!("{network} is not a private network with a 0 at its end, such as 10.77.0.0");
                return wrong(field, why);
            }
        }
        if file.cable == Some(subnet) {
            return wrong("cable", "it is the subnet of the radio; choose another, such as 10.78.0.0".to_owned());
        }
        if file.cable.is_some() && interface == CABLE {
            return wrong("interface", format!("'{CABLE}' is the cable's interface"));
        }
        let priority = file.priority.unwrap_or(20);
        if priority > 99 {
            return wrong("priority", format!("{priority} is not 0 to 99"));
        }
        let late = Span::from_nanos(1000 * file.late_us.unwrap_or(500));
        if !(1..=1_000_000).contains(&(late.as_nanos() / 1000)) {
            return wrong("late_us", "it is not 1 to 1000000".to_owned());
        }
        let radio = radio_of(file, text)?;
        let Places { paths, commands } = places(file)?;
        Ok(Laboratory {
            name,
            stations: file.stations,
            interface,
            subnet,
            cable: file.cable,
            radio,
            seed: file.seed.unwrap_or(0),
            static_arp: file.static_arp,
            ipv6: file.ipv6,
            late,
            priority,
            paths,
            commands,
        })
    }

    /// Returns the IPv4 address of a station: the subnet's with the station's number plus one at its end.
    pub fn address(&self, station: u16) -> Ipv4Addr {
        address_in(self.subnet, station)
    }

    /// Returns the IPv4 address of a station on the cable; `None` if there is no cable.
    pub fn cable_address(&self, station: u16) -> Option<Ipv4Addr> {
        self.cable.map(|cable| address_in(cable, station))
    }

    /// Returns the name of the network namespace that holds the cable's bridge.
    pub fn cable_namespace(&self) -> String {
        format!("{}-cable", self.name)
    }

    /// Returns the command of each station that has one: its own, or else `common`.
    pub fn commands_or(&self, common: &[String]) -> Vec<(u16, Vec<String>)> {
        let of = |(station, own): (u16, &Vec<String>)| {
            let words = if own.is_empty() { common } else { own };
            (!words.is_empty()).then(|| (station, words.to_vec()))
        };
        (0..self.stations).zip(&self.commands).filter_map(of).collect()
    }

    /// Returns the name of a station's network namespace.
    pub fn namespace(&self, station: u16) -> String {
        format!("{}{station}", self.name)
    }
}

/// Path and command of each station, by its number.
struct Places {
    paths: Vec<Option<Path>>,
    commands: Vec<Vec<String>>,
}

/// Returns what the tables of single stations say.
fn places(file: &File) -> Result<Places, ConfigError> {
    let stations = usize::from(file.stations);
    let (mut paths, mut commands) = (vec![None; stations], vec![Vec::new(); stations]);
    for (at, table) in file.station.iter().enumerate() {
        let field = |name: &str| format!("station.{at}.{name}");
        let wrong = |name: &str, why: String| Err(ConfigError::field(field(name), why));
        let number = usize::from(table.number);
        if number >= stations {
            return wrong("number", format!("{number} is not 0 to {}", stations - 1));
        }
        if file.station[..at].iter().any(|other| other.number == table.number) {
            return wrong("number", format!("station {number} has a table already"));
        }
        paths[number] = match (&table.position_m, &table.path) {
            (Some(_), Some(_)) => return wrong("path", "it excludes 'position_m'".to_owned()),
            (Some(at), None) => Some(Path::fixed(*at).map_err(|why| ConfigError::field(field("position_m"), why))?),
            (None, Some(points)) => Some(Path::new(points).map_err(|why| ConfigError::field(field("path"), why))?),
            (None, None) => None,
        };
        commands[number].clone_from(&table.command);
    }
    Ok(Places { paths, commands })
}

fn address_in(subnet: Ipv4Addr, station: u16) -> Ipv4Addr {
    let [a, b, c, _] = subnet.octets();
    Ipv4Addr::new(a, b, c, (station + 1) as u8)
}

fn digit(c: char) -> bool {
    c.is_ascii_digit()
}

/// Returns the radio's parameters: those of the preset, and on top of them the fields of the table `radio`.
fn radio_of(file: &File, text: &str) -> Result<Radio, ConfigError> {
    let preset = file.preset.as_deref().unwrap_or("wifi");
    let preset = Radio::preset(preset).ok_or_else(|| {
        ConfigError::field("preset", format!("there is no such radio; there are {}", PRESETS.join(", ")))
    })?;
    let unreadable = |_| ConfigError::Syntax("the radio's parameters are no TOML table".to_owned());
    let mut merged = toml::Table::try_from(&preset).map_err(unreadable)?;
    let table: toml::Table = config::from_toml(text)?;
    if let Some(toml::Value::Table(fields)) = table.get("radio") {
        merged.extend(fields.clone());
    }
    let radio: Radio = config::from_table(&merged).map_err(|error| error.within("radio"))?;
    radio.check().map_err(|error| error.within("radio"))?;
    Ok(radio)
}

/// Adds the line of the wrong field to an error, if the file has the field.
fn with_line(text: &str, error: ConfigError) -> ConfigError {
    let ConfigError::Field { field, reason } = error else { return error };
    match line_of(text, &field) {
        Some(line) => ConfigError::field(format!("{field} (line {line})"), reason),
        None => ConfigError::field(field, reason),
    }
}

/// Returns the number of the line in which a field is set. Names of nested tables and indices of arrays have dots
/// between them.
fn line_of(text: &str, field: &str) -> Option<usize> {
    let table = DeTable::parse(text).ok()?;
    let mut names = field.split('.');
    let mut span = None;
    let mut inside: Option<&DeTable<'_>> = Some(table.get_ref());
    while let Some(name) = names.next() {
        let (key, value) = inside?.iter().find(|(key, _)| key.get_ref() == name)?;
        span = Some(key.span());
        inside = match value.get_ref() {
            DeValue::Table(table) => Some(table),
            DeValue::Array(all) => match names.next() {
                Some(index) => match all.get(index.parse::<usize>().ok()?)?.get_ref() {
                    DeValue::Table(table) => Some(table),
                    _ => None,
                },
                None => None,
            },
            _ => None,
        };
    }
    span.map(|span| text[..span.start].matches('\n').count() + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::net::media::radio::Topology;

    #[test]
    fn a_short_file_has_defaults_and_a_preset_takes_changes() {
        let lab = Laboratory::from_toml("stations = 3\n").unwrap();
        assert_eq!((lab.name.as_str(), lab.stations, lab.interface.as_str()), ("lab", 3, "wlan0"));
        assert_eq!(lab.radio, Radio::default());
        assert_eq!((lab.address(2).to_string(), lab.namespace(2)), ("10.77.0.3".to_owned(), "lab2".to_owned()));
        let text = "stations = 2\npreset = \"paper\"\n[radio]\nchannel = \"ad-hoc\"\nretries = 1\n";
        let changed = Laboratory::from_toml(text).unwrap().radio;
        let paper = Radio::preset("paper").unwrap();
        assert_eq!(changed, Radio { channel: Topology::AdHoc, retries: 1, ..paper });
    }

    #[test]
    fn a_station_runs_its_own_command_or_else_the_common_one() {
        let text = "stations = 2\n[[station]]\nnumber = 1\ncommand = [\"iperf\", \"-s\"]\n";
        let lab = Laboratory::from_toml(text).unwrap();
        let own = (1, vec!["iperf".to_owned(), "-s".to_owned()]);
        assert_eq!(lab.commands_or(&[]), std::slice::from_ref(&own));
        assert_eq!(lab.commands_or(&["ping".to_owned()]), [(0, vec!["ping".to_owned()]), own]);
    }

    #[test]
    fn an_error_names_the_field_and_its_line() {
        let error = |text: &str| Laboratory::from_toml(text).unwrap_err().to_string();
        assert_eq!(error("stations = 0\n"), "stations (line 1): 0 is not 1 to 200");
        assert!(error("stations = 2\nradius = 3\n").starts_with("line 2, column 1 (radius): unknown field"));
        assert!(error("name = \"lab\"\n").contains("missing field `stations`"));
        let text = "stations = 2\n\n[radio]\nretries = 3\ncw_min = 16\n";
        assert!(error(text).starts_with("radio.cw_min (line 5): 16 is not one less"), "{}", error(text));
        assert!(error("stations = 2\n[radio]\nrate = \"ofdm-55\"\n").starts_with("line 3"));
        assert!(error("stations = 2\npreset = \"wire\"\n").starts_with("preset (line 2): there is no such radio"));
        let text = "stations = 2\n[[station]]\nnumber = 0\n[[station]]\nnumber = 2\n";
        assert_eq!(error(text), "station.1.number (line 5): 2 is not 0 to 1");
        assert!(error("stations = 2\nsubnet = \"8.8.8.0\"\n").starts_with("subnet (line 2)"));
        assert!(error("stations = 2\nname = \"lab1\"\n").starts_with("name (line 2)"));
        assert!(error("stations = 2\ncable = \"10.77.0.0\"\n").starts_with("cable (line 2)"));
        let text = "stations = 1\n[[station]]\nnumber = 0\npath = [[1.0, 0.0, 0.0], [0.5, 1.0, 1.0]]\n";
        assert!(error(text).starts_with("station.0.path (line 4)"), "{}", error(text));
    }
}
