//! Loading of policies by name or from a file, and the command `murmurate policy`.

mod check;
mod check_hops;
mod check_onnx;
mod facts;
pub mod onnx;
mod python;
pub mod room;

use std::path::Path;

use anyhow::Result;
use clap::Subcommand;
use murmurate::chassis::{Chassis, DriveKind};
use murmurate::messages::ids::RobotId;
use murmurate::policy::{Draw, Model};
use murmurate::registry::Registry;
use murmurate::scenario::Scenario;

use crate::output::read_bytes;
use crate::{BadInput, Ended};

/// Examines policy files.
#[derive(Subcommand)]
pub enum Args {
    /// Says what a policy file is and whether this program can run it; exits with 2 if it cannot
    Check(check::Args),
}

/// Runs a subcommand of `policy`.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let Args::Check(args) = args;
    check::run(args, registry)
}

/// Policy that was loaded by its name or from a file, with warnings about its use.
pub struct Loaded {
    /// Model of the policy, which makes an instance for each robot.
    pub model: Model,
    /// Name of the policy in reports: its name in the registry, or the path of its file.
    pub name: String,
    /// Warnings about the use of the policy. Its file may lack fields, for which values are assumed; the team may be
    /// larger than in its training, or have another drive.
    pub warnings: Vec<String>,
}

impl Loaded {
    /// Returns this policy for a team whose robots have these chassis. A warning is added if it was trained for another
    /// drive (kind, or distance of the commanded point).
    pub fn for_team(mut self, team: &[Chassis]) -> Loaded {
        let name = &self.name;
        self.warnings.extend(other_drive(&self.model, team).map(|warning| format!("--policy {name}: {warning}")));
        self
    }
}

/// Loads the policy `named`: an entry of the registry, or a policy file. `None` loads the default policy of the
/// scenario. `draw` replaces the file's choice between mean and sampled actions. An error names the flag or the file.
pub fn load(registry: &Registry, named: Option<&Path>, draw: Option<Draw>, scenario: &dyn Scenario) -> Result<Loaded> {
    let named = named.unwrap_or_else(|| Path::new(registry.default_policy(scenario)));
    let name = named.display().to_string();
    let (model, place, slow) = match named.to_str().and_then(|name| registry.policy(name)) {
        Some(entry) => ((entry.build)(scenario), format!("--policy {name}"), None),
        None if onnx::is_format_3(named) => {
            let (network, sound) = onnx::load(named)?;
            let slow = onnx::too_slow(&network, &sound);
            (Ok(network.model()), format!("the policy file '{name}'"), slow)
        }
        None => {
            let known: Vec<&str> = registry.policies().iter().map(|entry| entry.name).collect();
            let bytes = read_bytes(named, &format!("policy file (or name a policy: {})", known.join(", ")))?;
            (Model::from_file(&bytes, scenario.name()), format!("the policy file '{name}'"), None)
        }
    };
    let mut model = model.map_err(|error| BadInput(format!("{place}: {error}")))?;
    if let Some(draw) = draw {
        let nothing =
            || BadInput(format!("--action: the policy '{name}' has no action distribution; leave the flag out"));
        model = model.with_draw(draw).ok_or_else(nothing)?;
    }
    let robots = scenario.robots();
    let larger = model.largest_team().filter(|largest| robots > *largest).map(|largest| {
        format!("it was trained in teams of at most {largest} robots, and the team has {robots}: train it for these")
    });
    let warnings = model.assumed().map(str::to_owned).into_iter().chain(larger).chain(slow);
    let warnings = warnings.map(|warning| format!("{place}: {warning}")).collect();
    Ok(Loaded { model, name, warnings })
}

/// Returns a warning that names the first robot whose drive (kind or commanded point) is not the one that the policy
/// was trained for; `None` if all agree, or if the policy does not state its drive.
fn other_drive(model: &Model, team: &[Chassis]) -> Option<String> {
    let trained = model.trained_chassis()?;
    let same = |chassis: &&Chassis| (chassis.drive, chassis.point_ahead_m) == (trained.drive, trained.point_ahead_m);
    let (robot, chassis) = RobotId::team(team.len()).zip(team).find(|(_, chassis)| !same(chassis))?;
    let (theirs, ours) = (described(&trained), described(chassis));
    Some(format!("it was trained for {theirs}, and {robot} has {ours}: train it for these, with 'train --drive'"))
}

fn described(chassis: &Chassis) -> String {
    match chassis.drive {
        DriveKind::Holonomic => "a holonomic drive".to_owned(),
        DriveKind::Differential => {
            format!("a differential drive with the point {} m ahead", chassis.point_ahead_m)
        }
    }
}
