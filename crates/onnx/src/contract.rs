//! Contract of a policy of format 3: what its graphs take and give, with units and frames, as a person writes it.

use std::collections::BTreeMap;

use murmurate::config::{self, ConfigError};
use murmurate::messages::wire::{MAX_FLOATS, Missing};
pub use murmurate::observation::Observed;
use murmurate::observation::{Frame, Request};
use murmurate::policy::Interface;
use murmurate::time::Span;
use serde::{Deserialize, Serialize};

pub use crate::action::{Action, Distribution, Kind};
pub use crate::message::Message;
pub use crate::robots::{Id, MAX_ROBOTS, Robots};
use crate::role::Role;

/// Version of the policy format that this crate reads.
pub const FORMAT: u32 = 3;
/// Key of the metadata of an ONNX file under which its contract is stored.
pub const METADATA: &str = "murmurate";
/// Names of the inputs of a graph that are no observations.
pub const ROLES: [&str; 6] = ["messages", "edges", "heard", "own_message", "state", "id"];
/// Largest number of floats that a policy keeps from one step to the next.
pub const MAX_STATE: usize = 65_536;
/// Largest number of neighbours that one call of a graph takes.
pub const MAX_NEIGHBOURS: usize = 64;
/// Largest number of graphs that make a message for a further hop.
pub const MAX_RELAYS: usize = 15;
/// Longest name that reports show \[characters\].
const MAX_NAME: usize = 80;

/// Contract of a policy: what its graphs take and give. Lengths are in metres, times in seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contract {
    /// Version of the policy format: 3.
    pub format: u32,
    /// Name of the policy in reports.
    pub name: String,
    /// File of the one graph that makes a whole step, beside the contract; left out in the metadata of the graph
    /// itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub graph: Option<String>,
    /// File of the graph that makes the message, if that and the action are computed by two graphs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encode: Option<String>,
    /// Files of the graphs that make the message for a further hop each, in their order, if the robots of a step
    /// exchange messages several times.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub relay: Vec<String>,
    /// File of the graph that makes the action, if that and the message are computed by two graphs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub act: Option<String>,
    /// Policy in Python instead of graphs: `module:Class`, with the module in the contract's folder or installed, or
    /// `unix:PATH`, the socket of a process that serves one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub python: Option<String>,
    /// Largest memory of the process of a policy in Python \[MB\]; 4096 if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_mb: Option<u32>,
    /// SHA-256 of the graph's file, or of both files one after the other, as hexadecimal digits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Licence of the policy, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
    /// Origin of the policy, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Steps in a second: 10 to 1000.
    pub rate_hz: f64,
    /// Distance within which neighbours are heard \[m\].
    pub radius_m: f32,
    /// Age up to which a neighbour's message is used \[s\].
    pub hold_s: f64,
    /// Largest number of neighbours in a call: the nearest count.
    #[serde(default = "default_neighbours")]
    pub max_neighbours: usize,
    /// Number of places for neighbours in a call.
    #[serde(default)]
    pub pad: Pad,
    /// Robots of the team, if the graphs tell them apart: the input `id`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robots: Option<Robots>,
    /// Observations that the graphs take, by the names of their inputs.
    #[serde(default)]
    pub observation: BTreeMap<String, Observed>,
    /// Features of the edges, the connections from neighbours to the robot: the input `edges`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edges: Option<Edges>,
    /// Message that a robot broadcasts in each step.
    #[serde(default)]
    pub message: Message,
    /// State that the policy keeps from one step to the next.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<State>,
    /// Meaning of the output `action`.
    pub action: Action,
}

/// Returns whether a text may be a name in reports.
fn is_name(text: &str) -> bool {
    !text.is_empty() && text.chars().count() <= MAX_NAME && !text.chars().any(char::is_control)
}

fn default_neighbours() -> usize {
    8
}

/// Number of places for neighbours in a call of a graph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pad {
    /// As many places as there are neighbours, and one that is empty without any.
    #[default]
    Exact,
    /// Always `max_neighbours` places, of which those without a neighbour are empty.
    Max,
}

/// Features of an edge, the connection from a neighbour to the robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Edges {
    /// Features in their order.
    pub features: Vec<Feature>,
    /// Sign of relative positions and velocities, and the end from which a bearing is taken. There is no default, since
    /// both are in use.
    pub sign: Sign,
    /// Frame of relative positions, velocities and bearings.
    pub frame: Frame,
}

/// Feature of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Feature {
    /// Difference of the positions \[m\]; two floats.
    RelativePosition,
    /// Difference of the velocities \[m/s\]; two floats.
    RelativeVelocity,
    /// Time since the neighbour's message has arrived \[s\]; one float.
    Age,
    /// Distance \[m\]; one float.
    Distance,
    /// Direction of the relative position \[rad\], from -pi to pi; one float.
    Bearing,
}

impl Feature {
    /// Returns the number of floats of the feature.
    pub fn floats(self) -> usize {
        match self {
            Feature::RelativePosition | Feature::RelativeVelocity => 2,
            Feature::Age | Feature::Distance | Feature::Bearing => 1,
        }
    }
}

/// Sign of relative positions and velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sign {
    /// The robot's own value minus the neighbour's.
    OwnMinusTheirs,
    /// The neighbour's value minus the robot's own.
    TheirsMinusOwn,
}

/// State that a policy keeps from one step to the next. It is at its start when an episode begins, when the robot's
/// Agent is started again, and after a gap.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct State {
    /// Number of floats, all of which are zero at the start.
    pub floats: usize,
    /// Longest time between two steps after which the policy goes on from its state \[s\].
    pub after_gap_s: f64,
}

impl Contract {
    /// Reads a contract from TOML, or from JSON as it may stand in a graph's metadata, and checks it. An error names
    /// the wrong field.
    pub fn parse(text: &str) -> Result<Contract, ConfigError> {
        let json = text.trim_start().starts_with('{');
        #[derive(Deserialize)]
        struct Version {
            format: Option<u32>,
        }
        let wrong = |error: &serde_json::Error| ConfigError::Syntax(config::json(error));
        // Of another format the other fields are not known.
        let Version { format } = match json {
            true => serde_json::from_str(text).map_err(|error| wrong(&error))?,
            false => config::from_toml(text)?,
        };
        let Some(format) = format else {
            let why =
                "it is missing, so this is no contract of a policy, which says 'format = 3' (docs/policy-format-3.md)";
            return Err(ConfigError::field("format", why));
        };
        if format != FORMAT {
            return Err(ConfigError::field(
                "format",
                format!("{format}; this program reads contracts of format {FORMAT}"),
            ));
        }
        let contract: Contract = match json {
            true => serde_json::from_str(text).map_err(|error| wrong(&error))?,
            false => config::from_toml(text)?,
        };
        contract.check()?;
        Ok(contract)
    }

    /// Returns the files of the graphs in the order of their calls, each with the part of a step that it computes.
    pub fn files(&self) -> impl Iterator<Item = (Role, &String)> {
        let [graph, encode, act] = [(Role::Step, &self.graph), (Role::Encode, &self.encode), (Role::Act, &self.act)]
            .map(|(role, file)| file.iter().map(move |file| (role, file)));
        graph.chain(encode).chain(self.relay.iter().map(|file| (Role::Relay, file))).chain(act)
    }

    /// Returns the parameters that the rest of the system needs to run the policy.
    pub fn interface(&self) -> Interface {
        Interface {
            features: self.message.floats,
            radius_m: self.radius_m,
            period: Span::from_secs(1.0 / self.rate_hz),
            limit_m_s: self.action.speed_limit(),
            hold: Span::from_secs(self.hold_s),
        }
    }

    /// Returns the channels that the policy takes, in the order of the names of its inputs.
    pub fn requests(&self) -> Vec<Request> {
        self.observation.iter().map(|(input, observed)| observed.request(input)).collect()
    }

    /// Returns the number of floats of an edge; zero without edges.
    pub fn edge_floats(&self) -> usize {
        self.edges.as_ref().map_or(0, |edges| edges.features.iter().map(|feature| feature.floats()).sum())
    }

    /// Returns the number of floats of the state; zero without one.
    pub fn state_floats(&self) -> usize {
        self.state.map_or(0, |state| state.floats)
    }

    /// Returns the number of floats of the output `action`.
    pub fn action_floats(&self) -> usize {
        self.action.floats()
    }

    /// Checks what no type says. An error names the first wrong field.
    fn check(&self) -> Result<(), ConfigError> {
        let refuse = |field: &str, why: String| Err(ConfigError::field(field, why));
        if !is_name(&self.name) {
            return refuse("name", format!("it is not 1 to {MAX_NAME} printable characters"));
        }
        if !(10.0..=1000.0).contains(&self.rate_hz) {
            return refuse("rate_hz", format!("{} is not 10 to 1000", self.rate_hz));
        }
        if !(self.hold_s >= 1.0 / self.rate_hz && self.hold_s <= 60.0) {
            return refuse("hold_s", format!("{} is not one period to 60 s", self.hold_s));
        }
        if !(self.radius_m > 0.0 && self.radius_m.is_finite()) {
            return refuse("radius_m", format!("{} is not above zero", self.radius_m));
        }
        self.check_files()?;
        if let Some(robots) = &self.robots {
            robots.check(self.python.is_some())?;
        }
        if !(1..=MAX_NEIGHBOURS).contains(&self.max_neighbours) {
            return refuse("max_neighbours", format!("{} is not 1 to {MAX_NEIGHBOURS}", self.max_neighbours));
        }
        if self.message.floats > MAX_FLOATS {
            let floats = self.message.floats;
            return refuse("message.floats", format!("{floats}; a message has at most {MAX_FLOATS}"));
        }
        let name = self.message.name.as_deref();
        if name.is_some_and(|name| !is_name(name)) {
            return refuse("message.name", format!("it is not 1 to {MAX_NAME} printable characters"));
        }
        if self.message.missing != Missing::Whole && !self.message.form().is_in_parts(self.message.floats) {
            let why = "its message fits into one datagram; leave it out, or send more floats or in another encoding";
            return refuse("message.missing", why.to_owned());
        }
        for (input, observed) in &self.observation {
            let field = format!("observation.{input}");
            if ROLES.contains(&input.as_str()) {
                return refuse(
                    &field,
                    format!("the names {} are for inputs that are no observations", ROLES.join(", ")),
                );
            }
            if let Err(why) = observed.floats() {
                return refuse(&format!("{field}.shape"), why);
            }
        }
        if self.edges.as_ref().is_some_and(|edges| edges.features.is_empty()) {
            return refuse("edges.features", "there are none; leave the table out".to_owned());
        }
        if let Some(State { floats, after_gap_s }) = self.state {
            if !(1..=MAX_STATE).contains(&floats) {
                return refuse(
                    "state.floats",
                    format!("{floats} is not 1 to {MAX_STATE}; leave the table out for none"),
                );
            }
            if !(after_gap_s >= 1.0 / self.rate_hz && after_gap_s.is_finite()) {
                return refuse("state.after_gap_s", format!("{after_gap_s} is less than one period"));
            }
        }
        self.action.check()?;
        self.interface().check().map_err(ConfigError::Syntax)
    }

    /// Checks that the contract names one graph, two, or a class of Python.
    fn check_files(&self) -> Result<(), ConfigError> {
        let refuse = |field: &str, why: String| Err(ConfigError::field(field, why));
        if self.graph.is_some() && (self.encode.is_some() || self.act.is_some()) {
            return refuse(
                "graph",
                "one graph makes a whole step; leave out 'encode' and 'act', or 'graph'".to_owned(),
            );
        }
        if self.encode.is_some() != self.act.is_some() {
            return refuse("encode", "two graphs make a step: 'encode' and 'act' are both needed".to_owned());
        }
        if self.relay.len() > MAX_RELAYS {
            return refuse("relay", format!("{} of them; there are at most {MAX_RELAYS}", self.relay.len()));
        }
        if !self.relay.is_empty() && self.encode.is_none() {
            return refuse("relay", "it is between 'encode' and 'act', which are missing".to_owned());
        }
        if self.python.is_some() && (self.graph.is_some() || self.encode.is_some() || self.sha256.is_some()) {
            return refuse("python", "a policy in Python has no graphs; leave out one of both".to_owned());
        }
        match self.memory_mb {
            Some(_) if self.python.is_none() => {
                return refuse("memory_mb", "it is for a policy in Python; leave it out".to_owned());
            }
            Some(memory_mb) if !(64..=1_000_000).contains(&memory_mb) => {
                return refuse("memory_mb", format!("{memory_mb} is not 64 to 1000000"));
            }
            _ => {}
        }
        if self.encode.is_some() && self.message.floats == 0 {
            return refuse("message.floats", "0, and a graph 'encode' has a message to make".to_owned());
        }
        Ok(())
    }
}
