//! Fields of a team file with their types and defaults: those of the whole team, and those of links, most of which
//! belong to transports.

use crate::config::fields::FieldType;
use crate::deploy::MODES;
use crate::deploy::rates::LATENT_RATE_HZ;
use crate::net::protocol::reliability::Reliability;
use crate::net::transport;
use crate::world::Sensor;

/// Name, type and default of a field; the default is written as in a file.
type Field = (&'static str, FieldType, Option<&'static str>);

/// Name of the field that sets the network interface of every link. It exists in flags and environment variables only,
/// not in files.
pub const EVERY_INTERFACE: &str = "interface";

/// Names of the reliability modes, as written in a team file.
const RELIABILITIES: [&str; 4] = {
    let [(a, _), (b, _), (c, _), (d, _)] = Reliability::NAMED;
    [a, b, c, d]
};

/// Names of the simulated sensors, as written in a team file.
const SENSORS: [&str; 3] = {
    let [(a, _), (b, _), (c, _)] = Sensor::NAMED;
    [a, b, c]
};

/// Fields of the whole team, in the order in which `config show` lists them.
const TEAM: [Field; 25] = [
    ("team", FieldType::Whole(0, 65_535), None),
    ("key_file", FieldType::Text, None),
    // All hosts must agree on it, so it is set for the whole team.
    ("confidential", FieldType::Truth, Some("false")),
    ("mode", FieldType::Choice(&MODES), None),
    ("robots", FieldType::Whole(1, 65_535), None),
    ("scenario", FieldType::Text, Some("passage")),
    ("gap_m", FieldType::Number(0.01, 100.0), None),
    ("scale", FieldType::Number(0.01, 100.0), None),
    ("hull_m", FieldType::Number(0.001, 10.0), None),
    ("policy", FieldType::Text, None),
    ("latent_rate_hz", FieldType::Number(LATENT_RATE_HZ[0], LATENT_RATE_HZ[1]), None),
    ("episodes", FieldType::Whole(1, 1_000_000), Some("16")),
    ("seed", FieldType::Whole(0, u64::MAX), Some("0")),
    ("plant", FieldType::Text, None),
    ("lag_s", FieldType::Number(0.0, 10.0), None),
    ("contacts", FieldType::Choice(&["block", "judge"]), None),
    ("wall_radius_m", FieldType::Number(1e-3, 10.0), None),
    ("sensor", FieldType::Choice(&SENSORS), None),
    ("clamp", FieldType::Choice(&["training", "deployed"]), Some("training")),
    ("handling", FieldType::Choice(&["hold", "as-published"]), Some("hold")),
    ("estimator", FieldType::Text, Some("none")),
    ("sensor_delay_s", FieldType::Number(0.0, 2.0), None),
    ("record", FieldType::Text, None),
    ("record_last_s", FieldType::Number(1.0, 3600.0), None),
    ("record_size_mb", FieldType::Number(1.0, 1e6), None),
];

/// Fields of the team that can be overridden for a robot or a host, in addition to those of its links.
const OVERRIDES: [&str; 5] = ["key_file", "policy", "record", "record_last_s", "record_size_mb"];

/// Returns the names of the fields of a team file that are for the whole team, not for a link.
pub fn team_fields() -> impl Iterator<Item = &'static str> {
    TEAM.iter().map(|(name, ..)| *name)
}

/// All fields that a team file may have, with their types and defaults; it depends on the transports.
#[derive(Clone, Debug)]
pub struct Fields {
    /// Fields of links that the transports define; a name that several transports define occurs once.
    own: Vec<transport::Field>,
}

impl Fields {
    /// Returns the permitted fields of a team file whose links may use the given transports.
    pub fn of(transports: &[transport::Entry]) -> Fields {
        let mut own: Vec<transport::Field> = Vec::new();
        for field in transports.iter().flat_map(|entry| entry.fields) {
            if own.iter().all(|other| other.name != field.name) {
                own.push(*field);
            }
        }
        Fields { own }
    }

    /// Returns the names of the fields of a link that have one value for all hosts, such as `transport`.
    pub fn of_link(&self) -> impl Iterator<Item = &'static str> {
        ["transport"].into_iter().chain(self.own.iter().filter(|field| !field.by_host).map(|field| field.name))
    }

    /// Returns the names of the fields of a link that are tables with one value for each host, such as `peers`.
    pub fn by_host(&self) -> impl Iterator<Item = &'static str> {
        self.own.iter().filter(|field| field.by_host).map(|field| field.name)
    }

    fn takes(&self, name: &str, by_host: bool) -> Option<FieldType> {
        let named = |field: &&transport::Field| field.name == name && field.by_host == by_host;
        self.own.iter().find(named).map(|field| field.takes)
    }

    /// Returns type and default of the field with this key, such as `seed` or `link.radio.transport`; `None` if there
    /// is no such field. The inner `None` stands for no default, or for a field of a transport, whose default is in the
    /// transport's entry.
    pub fn field(&self, key: &str) -> Option<(FieldType, Option<&'static str>)> {
        let of_team =
            |name: &str| TEAM.iter().find(|(field, ..)| *field == name).map(|(_, takes, default)| (*takes, *default));
        let own = |takes: Option<FieldType>| takes.map(|takes| (takes, None));
        match key.split('.').collect::<Vec<_>>()[..] {
            [name] => of_team(name),
            // The registry checks the name.
            ["link", _, "transport"] => Some((FieldType::Text, Some(transport::USUAL))),
            ["link", _, name] => own(self.takes(name, false)),
            ["link", _, "reliability", _] => Some((FieldType::Choice(&RELIABILITIES), None)),
            ["link", _, table, _] => own(self.takes(table, true)),
            ["robot" | "host", _, name] if OVERRIDES.contains(&name) => of_team(name),
            // Senders and receivers must agree on reliability, so it is set for the whole team.
            ["robot" | "host", _, "link", _, "reliability", ..] => None,
            ["robot" | "host", _, "link", ..] => self.field(key.splitn(3, '.').nth(2)?),
            _ => None,
        }
    }

    /// Returns a text that lists the permitted fields beside the unknown field `key`, for the error about it.
    pub fn siblings(&self, key: &str) -> String {
        let names = match key.split('.').collect::<Vec<_>>()[..] {
            ["link", _, "reliability", ..] => return "a kind of message is followed by its reliability".to_owned(),
            ["link", name, ..] => {
                let fields: Vec<&str> = self.of_link().chain(self.by_host()).chain(["reliability"]).collect();
                return format!("link.{name} has {}", fields.join(", "));
            }
            ["robot" | "host", name, ..] => return format!("{name} may have {}, link", OVERRIDES.join(", ")),
            _ => team_fields().chain(["deployment", "senses", "roles", "link", "robot", "host"]),
        };
        format!("there are {}", names.collect::<Vec<_>>().join(", "))
    }

    /// Whether a table with this key, such as `link.radio` or `host.pc`, may occur in a team file with fields in it.
    pub fn holds_fields(&self, key: &str) -> bool {
        let parts: Vec<&str> = key.split('.').collect();
        match parts[..] {
            ["robot" | "host"] | ["robot" | "host", _] => true,
            // Senders and receivers must agree on reliability, so it is set for the whole team.
            ["robot" | "host", _, ref link @ ..] => link.last() != Some(&"reliability") && self.holds_link_fields(link),
            ref link => self.holds_link_fields(link),
        }
    }

    fn holds_link_fields(&self, parts: &[&str]) -> bool {
        match parts {
            ["link"] | ["link", _] | ["link", _, "reliability"] => true,
            ["link", _, table] => self.by_host().any(|name| name == *table),
            _ => false,
        }
    }
}
