//! The command `murmurate doctor`: checks whether this machine can be a host of a team, and prints findings and advice.
//! The checks are in `checks`.

use std::io::IsTerminal;

use anyhow::{Context, Result};
use murmurate::deploy::team::{Team, TeamFile};
use murmurate::registry::Registry;

use crate::checks::{Examination, examine, host_of};
use crate::output::{confirmed, print, talk};
use crate::{BadInput, Ended, team};

/// Checks that this machine is fit to be one host of a team, and says what to do where it is not.
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
    murmurate_mavlink=off,murmurate_ros2=off,murmurate::actors=off,murmurate::safety=off";

/// Runs `doctor`: makes the checks and prints the findings.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let file = args.team.read(registry)?;
    if !(0.0..=3600.0).contains(&args.listen) {
        return Err(BadInput(format!("--listen: {} is not 0 to 3600 seconds", args.listen)).into());
    }
    let teams = teams(args, &file)?;
    if args.wiggle {
        check_drivable(&teams)?;
        check_confirmable(args.yes)?;
        if args.listen == 0.0 {
            return Err(BadInput("--wiggle listens to the team first: leave out --listen 0".to_owned()).into());
        }
    }
    let confirm = |team: &Team| Ok(args.yes || confirm(team)?);
    let report = examine(&Examination {
        teams: &teams,
        all: &|| file.hosts().map(|host| args.team.for_host(&file, host)).collect(),
        registry,
        listen_s: args.listen,
        confirm: if args.wiggle { Some(&confirm) } else { None },
        tell: talk,
    })?;
    let fit = report.is_fit();
    if args.json {
        let object = serde_json::json!({"fit": fit, "checks": report.checks});
        print(&serde_json::to_string(&object).context("checks are JSON")?)?;
    } else {
        let hosts: Vec<&str> = teams.iter().map(|team| &*host_of(team).name).collect();
        report.lines(&hosts).iter().try_for_each(|line| print(line))?;
    }
    Ok(match fit {
        _ if report.interrupted => Ended::Interrupted,
        false => Ended::Unfit,
        true => Ended::Done,
    })
}

/// Checks that one of the hosts `teams` drives real robots. It is an error if none or several do.
fn check_drivable(teams: &[Team]) -> Result<()> {
    let names: Vec<&str> = teams.iter().map(|team| host_of(team).name.as_str()).collect();
    let why = match teams.iter().filter(|team| !host_of(team).actuates.is_empty()).count() {
        1 => return Ok(()),
        0 => format!("{} drives no real robot, and a simulated one needs no wiggle", names.join(", ")),
        _ => "several hosts drive robots; name one by --host, or --robot N".to_owned(),
    };
    Err(BadInput(format!("--wiggle: {why}")).into())
}

/// Checks that the flag `--yes` (`yes`) confirms the wiggle, which drives robots, or that a user can confirm it on a
/// terminal; otherwise it is an error.
fn check_confirmable(yes: bool) -> Result<()> {
    if !yes && !std::io::stdin().is_terminal() {
        let why = "--wiggle moves robots: confirm it by --yes, or on a terminal";
        return Err(BadInput(why.to_owned()).into());
    }
    Ok(())
}

/// Asks on the terminal whether the robots of the host `team.host` may be driven 10 cm and back. Returns true if the
/// answer is yes.
fn confirm(team: &Team) -> Result<bool> {
    let robots: Vec<String> = host_of(team).actuates.iter().map(u16::to_string).collect();
    Ok(confirmed(&format!(
        "robots {} of host '{}' will drive 10 cm and back, one after the other. Is there room?",
        robots.join(", "),
        host_of(team).name
    ))?)
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
