//! The command `murmurate doctor`: checks of whether this machine is fit to be a host of a team, with advice.
//!
//! Local checks come first, then reception from other hosts. For these it sends link reports under ids of its own, so a
//! running robot is not disturbed.

mod listen;
mod table;

use std::fmt;
use std::path::Path;

use crate::deploy::team::{Team, TeamFile};
use crate::messages::ids::HostId;
use crate::net::transport::{Finding, Fitness, Place};
use crate::registry::Registry;
use anyhow::{Context, Result};
use serde::{Serialize, Serializer};

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
    /// Time to listen for other hosts once all else is sound [s]; 0 sends nothing and skips this check
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    listen: f64,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// Result of a check.
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
    /// Its result.
    status: Status,
    /// Host that it is for; "here" for the machine.
    host: String,
    /// Its subject.
    what: Subject,
    /// The finding.
    found: String,
    /// Advice; empty if there is nothing to do.
    advice: String,
}

/// Subject of a check, as text `key`, `link infra, MTU` or `link infra, host world`.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Subject {
    /// The machine, the team or a robot.
    General(String),
    /// An item of a link.
    Link { link: String, item: String },
    /// Another host on a link.
    Peer { link: String, host: String },
}

impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Subject::General(what) => f.write_str(what),
            Subject::Link { link, item } => write!(f, "link {link}, {item}"),
            Subject::Peer { link, host } => write!(f, "link {link}, host {host}"),
        }
    }
}

impl Serialize for Subject {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Runs the checks and prints the findings.
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
        let hosts: Vec<&str> =
            teams.iter().map(|team| &*team.deployment.hosts[usize::from(team.host.0)].name).collect();
        let lines = table::lines(&checks);
        lines.iter().try_for_each(|line| print(&line.text(hosts.len())))?;
        print(&table::verdict(&lines, &hosts))?;
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

/// Result of a check, its subject, the finding and advice.
type Found = (Status, Subject, String, String);

fn check_key(team: &Team) -> Found {
    let found =
        |status, found: String, advice: &str| (status, Subject::General("key".to_owned()), found, advice.to_owned());
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
    let found = |status, found: String| (status, Subject::General("policy".to_owned()), found, String::new());
    match team::policy(team, registry) {
        Ok(policy) if policy.warnings.is_empty() => found(Status::Ok, policy.name),
        Ok(policy) => found(Status::Warn, policy.warnings.join("; ")),
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
        (status, Subject::Link { link: link.to_owned(), item: what.to_owned() }, found, advice)
    };
    place.endpoint.check(host, link, &mtu).into_iter().map(found).collect()
}

/// The largest packet of an interface \[bytes\].
fn mtu(interface: &str) -> Option<usize> {
    let text = std::fs::read_to_string(Path::new("/sys/class/net").join(interface).join("mtu")).ok()?;
    text.trim().parse().ok()
}
