//! The manifest of a policy file of format 1: one JSON object in the safetensors metadata.
//!
//! The manifest holds all parameters that are needed to run the tensors in the same file. Only the policy published
//! with the paper has no manifest. Its file is recognised by its shapes, and its parameters are assumed.

use serde::{Deserialize, Serialize};

use super::Draw;
use crate::chassis::{self, Chassis};
use crate::messages::geometry::Vec2;
use crate::observation::{Dynamics, Observation};

/// Longest `message_name` \[characters\].
const MAX_NAME: usize = 80;

/// Checks the name of what a policy's messages mean, which errors repeat.
pub(crate) fn check_message_name(name: Option<&str>) -> Result<(), String> {
    let plain = |name: &str| (1..=MAX_NAME).contains(&name.chars().count()) && !name.chars().any(char::is_control);
    if name.is_none_or(plain) {
        return Ok(());
    }
    Err(format!("message_name: it is not 1 to {MAX_NAME} printable characters"))
}

/// Key of the safetensors metadata under which a policy file stores its manifest.
pub const KEY: &str = "murmurate";
/// Version of the manifest's format that this module reads, and that the trainer writes.
pub(crate) const FORMAT: u32 = 1;
/// Versions of the manifest's format that this program reads: this one, and that of policies with several hops.
pub(crate) const FORMATS: [u32; 2] = [FORMAT, 2];

/// Layout of the message-passing network: how the messages of a robot's neighbours lead to its action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Architecture {
    /// Layers published with the paper: update(sum over neighbours j and the robot i itself of message(h_j - h_i)).
    /// Here h_i is the encoded observation of robot i.
    Published,
    /// Equation (1) of the paper: update(\[h_i, sum over neighbours j of message(\[h_i, h_j, e_ij\])\]). Here h_i is
    /// the encoded observation of robot i, and e_ij are the features of the edge from j to i. The robot itself is not a
    /// term of the sum.
    Full,
}

/// One entry of the observation vector, the input of a policy's encoder. Each entry is two floats: x and y in the
/// policy frame, but for `FilterAndLag`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Field {
    /// Goal minus position of the robot \[m\].
    GoalMinusPosition,
    /// Position of the robot \[m\].
    Position,
    /// Position of the robot plus its velocity times 1 s \[m\].
    PositionPlusVelocity,
    /// Velocity of the robot \[m/s\].
    Velocity,
    /// 1 if the robot's safety filter is on, else 0; and the time constant \[s\] of the lag of its drivetrain.
    FilterAndLag,
}

impl Field {
    /// Returns the value of this entry for a robot's `observation`: \[m\] or \[m/s\], policy frame, but for
    /// `FilterAndLag`.
    #[inline]
    pub fn of(self, observation: &Observation) -> Vec2 {
        match self {
            Field::GoalMinusPosition => observation.goal - observation.motion.position,
            Field::Position => observation.motion.position,
            // The velocity counts as metres, that is, times one second.
            Field::PositionPlusVelocity => observation.motion.position + observation.motion.velocity,
            Field::Velocity => observation.motion.velocity,
            Field::FilterAndLag => {
                let Dynamics { filtered, lag_s, .. } = observation.dynamics;
                Vec2::new(if filtered { 1.0 } else { 0.0 }, lag_s)
            }
        }
    }
}

/// One feature of an edge, the connection from a neighbour in range to the robot. Edge features are inputs of the
/// message network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EdgeField {
    /// Time since the neighbour's message arrived at the robot \[s\]; one float.
    Age,
    /// The neighbour's position when it sent its message, minus the robot's own position \[m\], policy frame; two
    /// floats.
    RelativePosition,
}

impl EdgeField {
    /// Returns the number of floats of this edge feature.
    pub const fn floats(self) -> usize {
        match self {
            EdgeField::Age => 1,
            EdgeField::RelativePosition => 2,
        }
    }
}

/// Origin of a policy file: the training run that made it, for information.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Training {
    /// Name and version of the program that trained the policy.
    pub program: String,
    /// Name of the predefined training configuration from which the settings of the run were derived.
    pub preset: String,
    /// Random seed of the training run.
    pub seed: u64,
    /// Number of decisions in the training data. One decision is one step of the policy in one environment, for all its
    /// robots.
    pub decisions: u64,
    /// Number of simulated steps of 50 ms in the training data, summed over all environments.
    pub env_steps: u64,
    /// All settings of the training run, in the format of the program that trained the policy.
    pub configuration: serde_json::Value,
}

impl Training {
    /// Returns the number of robots in the largest team of the training. `None` means that the configuration does not
    /// say so in the format of this program.
    pub(crate) fn largest_team(&self) -> Option<usize> {
        if self.configuration.get("imitation").is_some() {
            return usize::try_from(self.configuration.get("robots")?.as_u64()?).ok();
        }
        let stages = self.configuration.get("curriculum")?.as_array()?;
        let groups = stages.iter().filter_map(|stage| stage.get("groups")?.as_array()).flatten();
        let sizes = groups.filter_map(|group| group.as_array()).flatten().filter_map(serde_json::Value::as_u64);
        usize::try_from(sizes.max()?).ok()
    }

    /// Returns the chassis (kind of drive and limits) of the robots in the training. `None` means that the
    /// configuration is not in the format of this program, or that its chassis is invalid. A configuration that states
    /// no chassis was for holonomic robots.
    pub fn chassis(&self) -> Option<Chassis> {
        self.configuration.get("curriculum")?;
        let settings =
            self.configuration.get("body").map_or(Ok(chassis::Settings::default()), chassis::Settings::deserialize);
        settings.ok()?.chassis().ok()
    }
}

/// Probability distribution of a robot's action, of which the network's outputs are the parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Distribution {
    /// Independent normal distributions of both components of a velocity \[m/s\]. The outputs are mean_x, mean_y,
    /// log_std_x and log_std_y: means and natural logarithms of standard deviations.
    DiagonalNormal,
}

/// Activation function between the layers of the encoder, the message network and the update network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", try_from = "String")]
pub enum Activation {
    /// Rectified linear unit: max(x, 0).
    Relu,
}

impl TryFrom<String> for Activation {
    type Error = &'static str;

    fn try_from(name: String) -> Result<Activation, &'static str> {
        if name == "relu" { Ok(Activation::Relu) } else { Err("this program runs relu only") }
    }
}

/// Method by which the messages of all neighbours are combined into one input of the update network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", try_from = "String")]
pub enum Aggregation {
    /// The sum of the messages is the input of the update network.
    Sum,
}

impl TryFrom<String> for Aggregation {
    type Error = &'static str;

    fn try_from(name: String) -> Result<Aggregation, &'static str> {
        if name == "sum" { Ok(Aggregation::Sum) } else { Err("this program computes sum only") }
    }
}

/// Metadata of a policy file of format 1: how its network is built, what it observes, and how it was trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the manifest's format; must be `FORMAT`, which is 1.
    pub format: u32,
    /// Name of the scenario (the team's task) for which the policy was trained.
    pub scenario: String,
    /// Layout of the message-passing network.
    pub architecture: Architecture,
    /// Entries of the observation vector, in the order of the encoder's inputs.
    pub observation: Vec<Field>,
    /// Features of an edge between two robots, in the order of the message network's inputs. The list is empty if there
    /// are none, as in `Architecture::Published`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub edge: Vec<EdgeField>,
    /// Activation function between layers. `None` means that the file states none; then [`Activation::Relu`] is
    /// assumed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub activation: Option<Activation>,
    /// Method of combining neighbours' messages. `None` means that the file states none; then [`Aggregation::Sum`] is
    /// assumed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aggregation: Option<Aggregation>,
    /// Layer widths of the encoder, from its input to its output. The encoder turns an observation into the message
    /// that a robot broadcasts.
    pub encoder: Vec<usize>,
    /// Layer widths of the message network, from its input to its output. The network is applied to each pair of the
    /// robot and a neighbour.
    pub message: Vec<usize>,
    /// Layer widths of the update network, from its input to its output. The network turns the sum of messages into the
    /// parameters of the action.
    pub update: Vec<usize>,
    /// Probability distribution of the action, of which the network's outputs are the parameters.
    pub distribution: Distribution,
    /// Default method of drawing an action from the distribution: its mean or a random sample.
    pub draw: Draw,
    /// Upper limit of the logarithm of the standard deviation, to which larger outputs are clamped when actions are
    /// sampled. `None` means no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_std_max: Option<f32>,
    /// Default communication radius \[m\]: a robot uses messages only of neighbours within this distance, unless the
    /// trial sets another range.
    pub radius_m: f32,
    /// Steps of the policy per second \[Hz\], each of which gives one action.
    pub rate_hz: f64,
    /// Largest commanded speed along each axis \[m/s\].
    pub limit_m_s: f32,
    /// Hold time \[s\]: age up to which a neighbour's newest message is used.
    pub hold_s: f64,
    /// Name of what the policy's messages mean, which policies have that were trained with each other's messages, such
    /// as those of the roles of a team; `None` for a policy that only understands itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message_name: Option<String>,
    /// SHA-256 of all tensors' bytes, in the order of the tensors' names, in hexadecimal.
    pub sha256: String,
    /// Training run that made the file; `None` if the file does not state it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training: Option<Training>,
}

impl Manifest {
    /// Returns the manifest that is assumed for the policy published with the paper, whose file has none. The policy is
    /// for the scenario `passage`, and every value is from the data of that release.
    pub fn published() -> Manifest {
        Manifest {
            format: FORMAT,
            scenario: "passage".to_owned(),
            architecture: Architecture::Published,
            observation: vec![Field::GoalMinusPosition, Field::Position, Field::PositionPlusVelocity],
            edge: Vec::new(),
            activation: None,
            aggregation: None,
            encoder: vec![6, 16, 32, 32, 32],
            message: vec![32, 64, 64, 64],
            update: vec![64, 64, 64, 64, 4],
            distribution: Distribution::DiagonalNormal,
            draw: Draw::Sample,
            log_std_max: None,
            radius_m: 2.0,
            rate_hz: 20.0,
            limit_m_s: 1.5,
            hold_s: 0.2,
            message_name: None,
            sha256: String::new(),
            training: None,
        }
    }

    /// Returns the manifest of a network with the full architecture of equation (1) in the paper. Its edge features are
    /// age and relative position; all other parameters are those of `published`.
    pub(crate) fn full() -> Manifest {
        Manifest {
            architecture: Architecture::Full,
            edge: vec![EdgeField::Age, EdgeField::RelativePosition],
            message: vec![67, 64, 64, 64],
            update: vec![96, 64, 64, 64, 4],
            ..Manifest::published()
        }
    }

    /// Checks the range of each field, and that the fields are consistent with each other. The error names the first
    /// wrong field.
    pub fn check(&self) -> Result<(), String> {
        if self.format != FORMAT {
            return Err(format!("format: {}; this program reads {FORMAT} and 2", self.format));
        }
        check_message_name(self.message_name.as_deref())?;
        for (field, widths) in [("encoder", &self.encoder), ("message", &self.message), ("update", &self.update)] {
            if widths.len() < 2 || widths.iter().any(|&width| width == 0 || width > 4096) {
                return Err(format!("{field}: {widths:?} are not valid layer widths (two or more, each 1 to 4096)"));
            }
        }
        let ends = |widths: &[usize]| (widths[0], widths[widths.len() - 1]);
        let (observed, hidden) = ends(&self.encoder);
        if self.architecture == Architecture::Published && !self.edge.is_empty() {
            return Err("edge: the published architecture has no edge features; leave it out".to_owned());
        }
        let edge: usize = self.edge.iter().map(|field| field.floats()).sum();
        let messages = ends(&self.message).1;
        let (to_message, to_update) = match self.architecture {
            Architecture::Published => (("the encoder's output", hidden), ("the message network's output", messages)),
            Architecture::Full => (
                ("the encoder's output twice and the edge", 2 * hidden + edge),
                ("the encoder's output and the message network's", hidden + messages),
            ),
        };
        let chain = [
            ("encoder", observed, ("2 for each of the observation's fields", 2 * self.observation.len())),
            ("message", ends(&self.message).0, to_message),
            ("update", ends(&self.update).0, to_update),
        ];
        for (field, input, (what, expected)) in chain {
            if input != expected {
                return Err(format!("{field}: input of {input}; expected {expected}, {what}"));
            }
        }
        if ends(&self.update).1 != 4 {
            return Err(format!("update: output of {}; a diagonal normal distribution needs 4", ends(&self.update).1));
        }
        if hidden > crate::messages::wire::MAX_FEATURES {
            return Err(format!(
                "encoder: output of {hidden}; a message carries {} floats",
                crate::messages::wire::MAX_FEATURES
            ));
        }
        check_conditions(self.log_std_max, self.radius_m, self.limit_m_s, self.rate_hz, self.hold_s)
    }
}

/// Checks the ranges of the fields that policy files of both formats have. The error names the first wrong field.
pub(super) fn check_conditions(
    log_std_max: Option<f32>,
    radius_m: f32,
    limit_m_s: f32,
    rate_hz: f64,
    hold_s: f64,
) -> Result<(), String> {
    let positive = |field: &str, value: f64| {
        if value.is_finite() && value > 0.0 { Ok(()) } else { Err(format!("{field}: {value} is not above 0")) }
    };
    if let Some(max) = log_std_max.filter(|max| !max.is_finite()) {
        return Err(format!("log_std_max: {max} is not finite; leave it out for none"));
    }
    positive("radius_m", f64::from(radius_m))?;
    positive("limit_m_s", f64::from(limit_m_s))?;
    positive("rate_hz", rate_hz)?;
    positive("hold_s", hold_s)?;
    // A motor command is valid for 200 ms, and a robot must act at least twice in that time.
    if !(10.0..=1000.0).contains(&rate_hz) {
        return Err(format!("rate_hz: {} is not 10 to 1000", rate_hz));
    }
    if !(1.0 / rate_hz..=60.0).contains(&hold_s) {
        return Err(format!("hold_s: {} is not one step ({} s) to 60 s", hold_s, 1.0 / rate_hz));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;

    #[test]
    fn an_inconsistent_manifest_is_refused_with_the_name_of_the_field() {
        let changed = |mut manifest: Manifest, change: fn(&mut Manifest)| {
            assert_eq!(manifest.check(), Ok(()));
            change(&mut manifest);
            manifest.check().unwrap_err()
        };
        let broken = |change| changed(Manifest::published(), change);
        assert!(broken(|m| m.format = 9).starts_with("format"));
        assert!(broken(|m| m.message[0] = 31).starts_with("message"));
        assert!(broken(|m| m.update[4] = 3).starts_with("update"));
        assert!(broken(|m| m.radius_m = f32::NAN).starts_with("radius_m"));
        assert!(broken(|m| m.rate_hz = 0.0).starts_with("rate_hz"));
        assert!(broken(|m| m.rate_hz = 2.0).starts_with("rate_hz"));
        assert!(broken(|m| m.hold_s = 1e-4).starts_with("hold_s"));
        assert!(broken(|m| m.edge = vec![EdgeField::Age]).starts_with("edge"));
        assert!(broken(|m| m.architecture = Architecture::Full).starts_with("message"));
        assert!(broken(|m| m.log_std_max = Some(f32::NAN)).starts_with("log_std_max"));
        let broken = |change| changed(Manifest::full(), change);
        assert!(broken(|m| m.edge.truncate(1)).starts_with("message"));
        assert!(broken(|m| m.message[0] = 64).starts_with("message"));
        assert!(broken(|m| m.message[3] = 32).starts_with("update"));
        assert!(broken(|m| m.update[0] = 64).starts_with("update"));
        assert!(broken(|m| m.architecture = Architecture::Published).starts_with("edge"));
    }

    #[test]
    fn entries_of_an_observation_are_what_they_say() {
        let motion = Motion { position: Vec2::new(0.5, -1.0), velocity: Vec2::new(0.25, 0.75) };
        let dynamics = Dynamics { filtered: true, lag_s: 0.5, point_ahead_m: 0.0 };
        let own = Observation { dynamics, ..Observation::new(motion, Vec2::new(1.0, 1.0)) };
        let entries = [
            ("goal-minus-position", [0.5, 2.0]),
            ("position", [0.5, -1.0]),
            ("position-plus-velocity", [0.75, -0.25]),
            ("velocity", [0.25, 0.75]),
            ("filter-and-lag", [1.0, 0.5]),
        ];
        for (name, value) in entries {
            let field: Field = serde_json::from_value(name.into()).expect("it is an entry");
            assert_eq!(field.of(&own), Vec2::from(value), "{name}");
        }
        let plain = Observation::new(motion, Vec2::zeros());
        assert_eq!(Field::FilterAndLag.of(&plain), Vec2::zeros());
    }

    #[test]
    fn optional_fields_without_a_value_are_not_written_and_not_required() {
        let text = serde_json::to_string(&Manifest::published()).expect("a manifest is JSON");
        for field in ["edge", "activation", "aggregation", "log_std_max", "training"] {
            assert!(!text.contains(field), "{field} is left out: {text}");
        }
        assert_eq!(serde_json::from_str::<Manifest>(&text).expect("it can be read"), Manifest::published());
    }
}
