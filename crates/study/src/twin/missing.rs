//! Quantities that a twin does not fit, because its records do not hold them, each with the reason.

use std::fmt;

use serde::Serialize;

use super::model::Fitted;
use murmurate::trial::Trial;

/// Quantities that a prediction is compared in.
const PREDICTED: &str = "success, makespan and message ages";

/// Quantity that was not fitted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Missing {
    /// Name of the quantity, as in the rows of the comparison.
    pub quantity: String,
    /// Reason.
    pub why: String,
}

impl Missing {
    fn new(quantity: &str, why: impl Into<String>) -> Missing {
        Missing { quantity: quantity.to_owned(), why: why.into() }
    }
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "not fitted: {}: {}", self.quantity, self.why)
    }
}

/// Parts of an imported run beside the poses of its robots.
#[derive(Clone, Copy, Debug)]
pub struct Held {
    /// Whether it has commands.
    pub commands: bool,
    /// Whether it has receipts of messages.
    pub receipts: bool,
    /// Whether it has velocities, which are then no differences of positions.
    pub velocities: bool,
}

/// Returns what was not fitted to the records of a team's hosts. `trial` has the settings of the run.
pub fn of_team(found: &Fitted, trial: &Trial) -> Vec<Missing> {
    let mut missing = Vec::new();
    if found.late_s.is_some() {
        missing.push(Missing::new(
            "slip",
            "the records have no true states, and slip is less than the noise of estimates",
        ));
    } else if found.lag_s.is_none() {
        let why =
            format!("nothing moved without contact; the lag is that of the team file ({} s)", trial.physics.lag_s);
        missing.push(Missing::new("lag and slip", why));
    }
    for (link, entry) in found.links.iter().zip(&trial.deployment.links) {
        if link.is_none() {
            let quantity = format!("link {}, delay and loss", entry.name);
            missing.push(Missing::new(&quantity, "no data crossed it; it is predicted as ideal"));
        }
    }
    if trial.deployment.links.is_empty() {
        missing.push(Missing::new("delay and loss", "all of the team is on one host, and no message crosses hosts"));
    }
    if found.offsets_s.iter().any(Option::is_none) {
        let why = "those of the robots drift against each other; their offsets are drawn anew for each repeat";
        missing.push(Missing::new("ticks", why));
    }
    if trial.deployment.check_simulated().is_err() {
        let why =
            "nothing is predicted: the robots are real, and a simulation has no part for their drivers and trackers";
        missing.push(Missing::new(PREDICTED, why));
    }
    missing
}

/// Returns what was not fitted to an imported run, which holds `held`.
pub fn of_import(found: &Fitted, held: Held) -> Vec<Missing> {
    let mut missing = Vec::new();
    match found.lag_s {
        None if !held.commands => missing.push(Missing::new("lag and slip", "the mapping names no commands")),
        None => missing.push(Missing::new("lag and slip", "no robot was commanded to move")),
        Some(_) if !held.velocities => {
            let why = "velocities are differences of the poses, in which noise is more than slip";
            missing.push(Missing::new("slip", why));
        }
        Some(_) if found.slip.is_none() => {
            missing.push(Missing::new("slip", "no robot was commanded to drive fast enough"))
        }
        Some(_) => {}
    }
    match found.all_links {
        None if !held.receipts => missing.push(Missing::new("delay and loss", "the mapping names no receipts")),
        None => missing.push(Missing::new("delay and loss", "no message arrived in these episodes")),
        Some(link) if link.delay_s.is_none() => {
            let why = "messages arrive before they were sent: the two times are of different clocks, and messages do \
                not go both ways";
            missing.push(Missing::new("delay", why));
        }
        Some(_) => {}
    }
    missing.push(Missing::new("ticks", "the times at which policies step are not in a mapping"));
    missing.push(Missing::new(PREDICTED, "nothing is predicted: goals and policies are not in a mapping"));
    missing
}
