//! The command `murmurate doctor`: checks whether this machine can be a host of a team, and gives advice.
//!
//! Local checks come first, then reception from other hosts. For this it sends link reports under ids of its own, so
//! that running robots are not disturbed. The drivers and the source of the host are checked last, unless the host is
//! running and uses them.

mod bench;
mod devices;
mod listen;
mod notes;
mod table;
mod wiggle;

pub use notes::{Notes, Warnings};

use std::fmt;
use std::path::Path;

use anyhow::{Context, Result};
use murmurate::deploy::team::{Team, TeamFile};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::net::transport::{Finding, Fitness, Place};
use murmurate::registry::Registry;
use murmurate::scenario::Settings;
use serde::{Serialize, Serializer};

use crate::BadInput;
use crate::Ended;
use crate::key;
use crate::output::print;
use crate::own_name;
use crate::team;
use listen::Heard;

/// Flags of `murmurate doctor`.
#[derive(clap::Args)]
#[command(after_help = "Exit codes: 0 nothing has failed; 1 a check has failed; 2 a flag or the team file is wrong; \
    130 a wiggle was interrupted: the robots stand.")]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    #[command(flatten)]
    which: team::Which,
    /// Time to listen for other hosts, and then to the drivers and the source of this one, once all else is sound [s];
    /// 0 sends nothing, opens no device and skips these checks
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    listen: f64,
    /// Drives each robot of the host 10 cm and back, one at a time, and checks that it goes where it should
    #[arg(long)]
    wiggle: bool,
    /// Confirms --wiggle without a question
    #[arg(long, requires = "wiggle")]
    yes: bool,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// Log filter of `doctor`, as `target=level` entries. Messages of drivers and sources are off; the findings show them.
pub const LEVEL: &str = "error,murmurate::drivers=off,murmurate::localization=off,murmurate::edge=off,\
    murmurate_ros2=off,murmurate::actors=off,murmurate::safety=off";

/// Severity of a check's result, in rising order; `Fail` means that this machine is not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
enum Status {
    Ok,
    Warn,
    Fail,
}

/// Result of one check.
#[derive(Debug, Serialize)]
struct Check {
    /// Severity of the result.
    status: Status,
    /// Name of the host to which the check belongs; "here" for a check of the machine.
    host: String,
    /// Thing that was checked, such as the key, a link or a robot.
    what: Subject,
    /// Text that says what the check observed.
    found: String,
    /// Advice on what to do; empty if there is nothing to do.
    advice: String,
}

/// Thing that a check is about, displayed as `key`, `link infra, MTU` or `link infra, host world`.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Subject {
    /// Any thing but a link, by name, such as `key`, `policy` or a robot.
    General(String),
    /// Property `item` of the link `link` on this machine, such as its MTU.
    Link { link: String, item: String },
    /// The host `host` as this machine hears it on the link `link`.
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

/// Runs `doctor`: makes the checks and prints the findings.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let file = args.team.read(registry)?;
    if !(0.0..=3600.0).contains(&args.listen) {
        return Err(BadInput(format!("--listen: {} is not 0 to 3600 seconds", args.listen)).into());
    }
    let teams = teams(args, &file)?;
    if args.wiggle {
        wiggle::only(&teams)?;
        wiggle::check_confirmable(args.yes)?;
        if args.listen == 0.0 {
            return Err(BadInput("--wiggle listens to the team first: leave out --listen 0".to_owned()).into());
        }
    }
    let (mut checks, mut interrupted): (Vec<Check>, bool) = (Vec::new(), false);
    for team in &teams {
        let mut add = |found: Found| checks.push(check(&wiggle::host_of(team).name, found));
        add(check_key(team));
        add(check_policy(team, registry));
        for (link, place) in team.deployment.links.iter().zip(&team.links) {
            if let Some(place) = place {
                check_link(team.host, &link.name, place).into_iter().for_each(&mut add);
            }
        }
    }
    let sound = checks.iter().all(|check| check.status != Status::Fail);
    if args.wiggle && !sound {
        checks.push(check("here", wiggle::failed("not begun: a check before it has failed", "")));
    }
    if args.listen > 0.0 && sound {
        let all: Vec<Team> = file.hosts().map(|host| args.team.for_host(&file, host)).collect::<Result<_>>()?;
        let heard = listen::listen(&teams, &all, args.listen)?;
        checks.extend(heard.found.iter().cloned().map(|found| check("here", found)));
        let mut places = Vec::new();
        for team in &teams {
            let name = wiggle::host_of(team).name.clone();
            let (found, end) = look(args, team, registry, &heard, &mut places)?;
            checks.extend(found.into_iter().map(|found| check(&name, found)));
            if let bench::End::Interrupted = end {
                interrupted = true;
                break;
            }
        }
        checks.extend(devices::at_one_place(&places).into_iter().map(|found| check("here", found)));
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
    Ok(match unfit {
        _ if interrupted => Ended::Interrupted,
        true => Ended::Unfit,
        false => Ended::Done,
    })
}

fn check(host: &str, (status, what, found, advice): Found) -> Check {
    Check { status, host: host.to_owned(), what, found, advice }
}

/// Checks the drivers and the source of the host `team.host`, and drives its robots if `--wiggle` is given. Returns the
/// findings, and why the check ended.
///
/// The devices are not opened if the host is running already, according to `heard`. With `--wiggle`, they are not
/// opened either if `heard` has a reason why no robot may be driven, or if the user does not confirm the drive. Where
/// the source has measured robots is appended to `places`.
fn look(
    args: &Args,
    team: &Team,
    registry: &Registry,
    heard: &Heard,
    places: &mut Vec<(RobotId, Vec2)>,
) -> Result<(Vec<Found>, bench::End)> {
    let host = wiggle::host_of(team);
    let wiggles = args.wiggle && !host.actuates.is_empty();
    let done = |found: Vec<Found>| Ok((found, bench::End::Done));
    if host.actuates.is_empty() && host.localizes.is_empty() {
        return done(Vec::new());
    }
    if heard.hosts.contains(&team.host) {
        let said = format!("host '{}' is running, and its devices are its own", host.name);
        let status = if wiggles { Status::Fail } else { Status::Warn };
        let what = if wiggles { "wiggle" } else { "devices" };
        let advice = "end it to check them here".to_owned();
        return done(vec![(status, Subject::General(what.to_owned()), said, advice)]);
    }
    let mut plan = None;
    if wiggles {
        if let Some(why) = &heard.hindrance {
            return done(vec![wiggle::failed(&format!("refused: {why}"), "")]);
        }
        if !args.yes && !wiggle::confirm(team)? {
            return done(vec![wiggle::failed("not confirmed: no robot has moved", "")]);
        }
        plan = Some((wiggle::config(team, registry)?, listen::operator(team)?));
    }
    let (seen, end) = bench::look(team, registry, args.listen, plan)?;
    let scenario = registry.scenario(&team.scenario, &Settings::of(team.deployment.robots));
    let scenario = scenario.map_err(|error| BadInput(error.to_string()))?;
    let mut found = seen.findings(team, args.listen, scenario.arena().half_extent);
    places.extend(seen.places());
    let localizes = !host.localizes.is_empty();
    found.extend(seen.results.iter().map(|(robot, verdict)| wiggle::finding(*robot, verdict, localizes)));
    if let bench::End::Team(why) = &end {
        found.push(wiggle::failed(&format!("ended, and all robots stand: {why}"), ""));
    }
    Ok((found, end))
}

/// Returns the hosts that `doctor` checks this machine for: the one that a flag names, or all if the team stays on one
/// machine. Without such a flag, a team of several machines is an error.
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

/// Result of a check: severity, subject, observation, advice.
type Found = (Status, Subject, String, String);

fn check_key(team: &Team) -> Found {
    let found =
        |status, found: String, advice: &str| (status, Subject::General("key".to_owned()), found, advice.to_owned());
    match &team.key_file {
        None => found(
            Status::Warn,
            "none: every program on this machine can command these robots".to_owned(),
            &format!("make one with '{} key new' and name it as key_file", own_name()),
        ),
        Some(path) => match key::read(path) {
            Ok(key) => found(
                Status::Ok,
                format!("fingerprint {}, which every host of the team must have", key::fingerprint(&key)),
                "",
            ),
            // The error also says what to do.
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

/// Returns the largest packet of an interface \[bytes\]; `None` if it is unknown.
fn mtu(interface: &str) -> Option<usize> {
    let text = std::fs::read_to_string(Path::new("/sys/class/net").join(interface).join("mtu")).ok()?;
    text.trim().parse().ok()
}
