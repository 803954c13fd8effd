//! `murmurate doctor`: whether this machine is fit to be one host of a team; one line a check, and what to do.
//!
//! First what can be seen without the rest of the team, then who is heard. What it sends for that are link reports
//! under names of its own: a robot that runs is not disturbed.

mod listen;

use std::path::Path;

use crate::deploy::team::{Team, TeamFile};
use crate::messages::ids::HostId;
use crate::net::transport::{Finding, Fitness, Place};
use crate::registry::Registry;
use anyhow::{Context, Result};
use serde::Serialize;

use crate::program::BadInput;
use crate::program::Ended;
use crate::program::key;
use crate::program::output::print;
use crate::program::team;

/// Flags of `murmurate doctor`.
#[derive(clap::Args)]
#[command(after_help = "Exit codes: 0 nothing has failed; 1 a check has failed; 2 a flag or the team file is wrong.")]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    #[command(flatten)]
    which: team::Which,
    /// How long to listen who is there, once all else is sound; 0 sends nothing and listens to nobody
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    listen: f64,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// What came of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Status {
    Ok,
    Warn,
    Fail,
}

/// A check.
#[derive(Debug, Serialize)]
struct Check {
    /// What came of it.
    status: Status,
    /// The host that it is about.
    host: String,
    /// What was checked.
    what: String,
    /// What was found.
    found: String,
    /// What to do about it; empty if nothing.
    advice: String,
}

/// Checks, and prints what was found.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let file = args.team.read(registry)?;
    if !(0.0..=3600.0).contains(&args.listen) {
        return Err(BadInput(format!("--listen: {} is not 0 to 3600 seconds", args.listen)).into());
    }
    let teams = teams(args, &file)?;
    let mut checks = Vec::new();
    for team in &teams {
        let mut add = |(status, what, found, advice): Found| {
            let host = team.deployment.hosts[usize::from(team.host.0)].name.clone();
            checks.push(Check { status, host, what, found, advice });
        };
        add(check_key(team));
        add(check_policy(team, registry));
        for (link, place) in team.deployment.links.iter().zip(&team.links) {
            if let Some(place) = place {
                check_link(team.host, &link.name, place).into_iter().for_each(&mut add);
            }
        }
    }
    if args.listen > 0.0 && checks.iter().all(|check| check.status != Status::Fail) {
        let all: Vec<Team> = file.hosts().map(|host| args.team.for_host(&file, host)).collect::<Result<_>>()?;
        for (status, what, found, advice) in listen::listen(&teams, &all, args.listen)? {
            checks.push(Check { status, host: "here".to_owned(), what, found, advice });
        }
    }
    let unfit = checks.iter().any(|check| check.status == Status::Fail);
    if args.json {
        let object = serde_json::json!({"fit": !unfit, "checks": checks});
        print(&serde_json::to_string(&object).context("checks are JSON")?)?;
    } else {
        let several = teams.len() > 1;
        checks.iter().try_for_each(|check| print(&check.line(several)))?;
    }
    Ok(if unfit { Ended::Unfit } else { Ended::Done })
}

/// The hosts that this machine is: the one that was named, or all of a team that stays on one machine.
fn teams(args: &Args, file: &TeamFile) -> Result<Vec<Team>> {
    if let Some(host) = args.which.find(file)? {
        return Ok(vec![args.team.for_host(file, host)?]);
    }
    let teams: Vec<Team> = file.hosts().map(|host| args.team.for_host(file, host)).collect::<Result<_>>()?;
    let leaves = |team: &Team| team.links.iter().flatten().any(|place| !place.endpoint.is_local());
    if teams.iter().any(leaves) {
        let names: Vec<&str> = file.deployment().hosts.iter().map(|host| host.name.as_str()).collect();
        let why = "--host: the team has several machines; say which host this one is, or --robot N; there are";
        return Err(BadInput(format!("{why} {}", names.join(", "))).into());
    }
    Ok(teams)
}

/// Status, what was checked, what was found, what to do.
type Found = (Status, String, String, String);

fn check_key(team: &Team) -> Found {
    let found = |status, found: String, advice: &str| (status, "key".to_owned(), found, advice.to_owned());
    match &team.key_file {
        None => found(
            Status::Warn,
            "none: every program on this machine can command these robots".to_owned(),
            "make one with 'murmurate key new' and name it as key_file",
        ),
        Some(path) => match key::read(path) {
            Ok(key) => found(
                Status::Ok,
                format!("fingerprint {}, which every host of the team must have", key::fingerprint(&key)),
                "",
            ),
            // The error says what to do, too.
            Err(error) => found(Status::Fail, error.to_string(), ""),
        },
    }
}

fn check_policy(team: &Team, registry: &Registry) -> Found {
    let found = |status, found: String| (status, "policy".to_owned(), found, String::new());
    match team::policy(team, registry) {
        Ok(policy) => match policy.assumed {
            Some(assumed) => found(Status::Warn, assumed),
            None => found(Status::Ok, policy.name),
        },
        Err(error) => found(Status::Fail, error.to_string()),
    }
}

fn check_link(host: HostId, link: &str, place: &Place) -> Vec<Found> {
    let found = |Finding { fitness, what, found, advice }: Finding| {
        let status = match fitness {
            Fitness::Ok => Status::Ok,
            Fitness::Warn => Status::Warn,
            Fitness::Fail => Status::Fail,
        };
        (status, format!("link {link}, {what}"), found, advice)
    };
    place.endpoint.check(host, link, &mtu).into_iter().map(found).collect()
}

/// The largest packet of an interface \[bytes\].
fn mtu(interface: &str) -> Option<usize> {
    let text = std::fs::read_to_string(Path::new("/sys/class/net").join(interface).join("mtu")).ok()?;
    text.trim().parse().ok()
}

impl Check {
    fn line(&self, several: bool) -> String {
        let status = match self.status {
            Status::Ok => "ok  ",
            Status::Warn => "warn",
            Status::Fail => "fail",
        };
        let host = if several { format!("{}: ", self.host) } else { String::new() };
        let advice = if self.advice.is_empty() { String::new() } else { format!(" \u{2014} {}", self.advice) };
        format!("{status} {host}{}: {}{advice}", self.what, self.found)
    }
}
