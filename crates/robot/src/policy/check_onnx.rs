//! The table of `murmurate policy check` for a policy of format 3.

use murmurate::config::shown;
use murmurate::messages::wire::{MAX_PART_BYTES, Missing};
use murmurate::observation::Request;
use murmurate_onnx::contract::{Contract, Distribution, Edges, Feature, Kind, Pad, Sign};
use serde::Serialize;

use super::facts::{channel, in_frame, lines, list, state};
use super::onnx::Sound;

/// Properties of a policy of format 3, which `policy check` prints.
#[derive(Serialize)]
pub(super) struct Facts<'a> {
    /// Name of the file.
    pub file: String,
    /// Contract of the policy.
    pub manifest: &'a Contract,
    /// Name and version of the engine that runs its graphs.
    pub engine: Option<&'static str>,
    /// Remarks and times of the check.
    #[serde(flatten)]
    pub sound: Sound,
}

/// Returns the table of `policy check` for a policy of format 3: the properties of its contract, as text.
pub(super) fn table(facts: &Facts) -> String {
    let contract = facts.manifest;
    let graphs = match &contract.encode {
        Some(_) if !contract.relay.is_empty() => {
            let hops = contract.relay.len() + 1;
            format!("{}: the message in {hops} hops, then the action", hops + 1)
        }
        Some(_) => "two: the message, then the action".to_owned(),
        None => "one for a whole step; its message is heard in the next one".to_owned(),
    };
    let places = match contract.pad {
        Pad::Exact => "the nearest, by robots' ids; as many places as are heard, at least one",
        Pad::Max => "the nearest, by robots' ids; always as many places",
    };
    let message = match contract.message.floats {
        0 => {
            format!("none: position and velocity alone, used within {} m for {} s", contract.radius_m, contract.hold_s)
        }
        floats => format!(
            "{floats} floats ({} bytes as {}{}), used within {} m for {} s",
            contract.message.bytes(),
            contract.message.encoding,
            parts(contract),
            contract.radius_m,
            contract.hold_s
        ),
    };
    let kept = contract.state.map(|state| (state.floats, state.after_gap_s));
    let mut rows = vec![
        ("name", contract.name.clone()),
        ("graphs", graphs),
        ("engine", facts.engine.unwrap_or("none").to_owned()),
        ("observation", observation(&contract.requests())),
        ("edge", edges(contract.edges.as_ref())),
        ("neighbours", format!("at most {}: {places}", contract.max_neighbours)),
        ("action", action(contract)),
        ("messages", message),
        ("state", state(kept)),
        ("step", format!("{:.0} us with {}, here", facts.sound.step_us, neighbours(contract.max_neighbours))),
    ];
    rows.extend(facts.sound.remarks.iter().map(|remark| ("remark", remark.clone())));
    rows.extend(contract.source.iter().map(|source| ("source", source.clone())));
    rows.extend(contract.license.iter().map(|license| ("licence", license.clone())));
    rows.push(("digest", facts.sound.digest.clone()));
    lines(&facts.file, &rows)
}

/// Says in how many parts a message travels; nothing if it fits into a datagram.
fn parts(contract: &Contract) -> String {
    if !contract.message.form().is_in_parts(contract.message.floats) {
        return String::new();
    }
    let parts = contract.message.bytes().div_ceil(MAX_PART_BYTES);
    let lost = match contract.message.missing {
        Missing::Whole => "all or none are used",
        Missing::Last => "a missing one is that of the message before",
        Missing::Zero => "a missing one is zeros",
    };
    if parts == 1 { " in one part".to_owned() } else { format!(" in {parts} parts: {lost}") }
}

fn neighbours(count: usize) -> String {
    shown::counted(count, "neighbour")
}

fn observation(requests: &[Request]) -> String {
    let all: Vec<String> = requests.iter().map(channel).collect();
    list(all.iter().map(String::as_str).collect())
}

fn edges(edges: Option<&Edges>) -> String {
    let Some(Edges { features, sign, frame }) = edges else { return "none".to_owned() };
    let name = |feature: &Feature| match feature {
        Feature::RelativePosition => "relative position [m]",
        Feature::RelativeVelocity => "relative velocity [m/s]",
        Feature::Age => "age of the message [s]",
        Feature::Distance => "distance [m]",
        Feature::Bearing => "bearing [rad]",
    };
    let sign = match sign {
        Sign::OwnMinusTheirs => "own - theirs",
        Sign::TheirsMinusOwn => "theirs - own",
    };
    format!("{}; {sign}, {}", list(features.iter().map(name).collect()), in_frame(*frame))
}

fn action(contract: &Contract) -> String {
    let said = &contract.action;
    let what = match said.kind {
        Kind::Velocity => "velocity [m/s]".to_owned(),
        Kind::Acceleration => "acceleration [m/s2] of the measured velocity".to_owned(),
        Kind::Twist => "speed [m/s] and yaw rate [rad/s] of a differential drive".to_owned(),
        Kind::Choice => format!("the largest of {} outputs, a velocity each [m/s]", said.choices.len()),
    };
    let limit = said.limit.map_or(String::new(), |limit| format!(", at most {limit} along each axis"));
    let drawn = match said.distribution {
        Distribution::None => "",
        Distribution::DiagonalNormal => "; the mean of a normal distribution, or drawn from it with --action sample",
    };
    format!("{what}, {}{limit}, {} times a second{drawn}", in_frame(said.frame), contract.rate_hz)
}
