//! Loading of policies by name or from a file, and the command `murmurate policy`.

mod check;
mod check_hops;
mod check_onnx;
mod facts;
pub mod onnx;
mod python;
pub mod room;

use std::path::Path;

use anyhow::{Context, Result};
use clap::Subcommand;
use murmurate::chassis::{Chassis, DriveKind};
use murmurate::deploy::Deployment;
use murmurate::messages::ids::RobotId;
use murmurate::policy::{Draw, Model, Models, Unequal};
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

/// Policies of a team that were loaded: one for all robots, or one for each role.
pub struct LoadedTeam {
    /// Models of the policies, by robot.
    pub models: Models,
    /// Name of the policy in reports; of several, with the names of their roles.
    pub name: String,
    /// Warnings about the use of the policies.
    pub warnings: Vec<String>,
}

impl Loaded {
    /// Returns this policy for a team whose robots have these chassis. A warning is added if it was trained for another
    /// drive (kind, or distance of the commanded point).
    pub fn for_team(mut self, team: &[Chassis]) -> Loaded {
        let name = &self.name;
        let team: Vec<(RobotId, Chassis)> = RobotId::team(team.len()).zip(team.iter().copied()).collect();
        self.warnings.extend(other_drive(&self.model, &team).map(|warning| format!("--policy {name}: {warning}")));
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

/// Loads the policies of the team of `deployment`: that of each role, and `named` for the robots whose role has none,
/// or the default policy of the scenario if that is `None`. `draw` replaces the files' choices between mean and sampled
/// actions. An error names the flag, the file or the role.
pub fn load_team(
    registry: &Registry,
    named: Option<&Path>,
    draw: Option<Draw>,
    (deployment, scenario): (&Deployment, &dyn Scenario),
) -> Result<LoadedTeam> {
    // A robot of no role, or of a role without a policy, has the team's.
    let role_of = |robot| deployment.role_of(robot).filter(|(_, role)| role.policy.is_some());
    let team: Vec<RobotId> = RobotId::team(deployment.robots).collect();
    let mut names: Vec<Option<&str>> = Vec::new();
    let mut of = Vec::new();
    for robot in &team {
        let name = role_of(*robot).map(|(name, _)| name);
        let known = names.iter().position(|other| *other == name);
        of.push(known.unwrap_or(names.len()));
        if known.is_none() {
            names.push(name);
        }
    }
    if let (Some(named), false) = (named, names.contains(&None)) {
        let why = format!("the policy '{}' is of no robot: each has one by its role", named.display());
        return Err(BadInput(why).into());
    }
    let (mut roles, mut said, mut warnings) = (Vec::new(), Vec::new(), Vec::new());
    for (index, name) in names.iter().enumerate() {
        let file = name.map_or(named, |name| deployment.roles[name].policy.as_deref());
        let robots = team.iter().filter(|robot| of[robot.index()] == index);
        let chassis: Vec<(RobotId, Chassis)> = robots.map(|robot| (*robot, deployment.chassis(*robot))).collect();
        let loaded = load(registry, file, draw, scenario);
        let loaded = match name {
            Some(name) => loaded.with_context(|| format!("roles.{name}.policy"))?,
            None => loaded?,
        };
        warnings.extend(loaded.warnings);
        let drive = other_drive(&loaded.model, &chassis);
        warnings.extend(drive.map(|warning| format!("--policy {}: {warning}", loaded.name)));
        said.push(name.map_or_else(|| loaded.name.clone(), |name| format!("{name}: {}", loaded.name)));
        roles.push((name.unwrap_or_default().to_owned(), loaded.model));
    }
    let models = Models::of_roles(roles, of);
    let models = models.map_err(|Unequal { role, why }| match &*role {
        "" => BadInput(format!("policy: {why}")),
        role => BadInput(format!("roles.{role}.policy: {why}")),
    })?;
    Ok(LoadedTeam { models, name: said.join(", "), warnings })
}

/// Returns a warning that names the first robot whose drive (kind or commanded point) is not the one that the policy
/// was trained for; `None` if all agree, or if the policy does not state its drive.
fn other_drive(model: &Model, team: &[(RobotId, Chassis)]) -> Option<String> {
    let trained = model.trained_chassis()?;
    let same = |chassis: &Chassis| (chassis.drive, chassis.point_ahead_m) == (trained.drive, trained.point_ahead_m);
    let (robot, chassis) = team.iter().find(|(_, chassis)| !same(chassis))?;
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
