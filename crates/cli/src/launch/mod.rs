//! The command `murmurate launch`: runs every process of a team on this machine and prints the table of results.
//!
//! Each process is `host` of this program. It prints events as JSON lines on stdout (`report::event`). Its stderr is
//! passed on with the host's name before each line.

mod progress;
#[cfg(feature = "lab")]
mod stations;

use std::ffi::OsString;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use murmurate::config::shown::counted;
use murmurate::deploy::team::{Team, TeamFile};
use murmurate::flight::LANDING;
use murmurate::messages::ids::RobotId;
use murmurate::registry::Registry;
use murmurate_report::event::Unwritten;
use murmurate_report::summary::{CostName, Counts, Run, Summary};

use crate::watch::{self, team::TeamEvent};
use murmurate_launch::outcome::Outcome;
use murmurate_launch::results::Results;
use murmurate_launch::supervisor::{Limits, Process, Supervisor};
use murmurate_robot::BadInput;
use murmurate_robot::Ended;
use murmurate_robot::output::{log_lines_dropped, print, talk};
use murmurate_robot::recording;
use murmurate_robot::team;
use murmurate_robot::this_program;
use murmurate_view::status::Ending;
use progress::Progress;

/// Runs every process of a team on this machine, in real time, and prints the same table as `sim`.
#[derive(clap::Args)]
#[command(after_help = "Exit codes: 0 every episode has a result and every process has ended well; 1 a process has \
    failed (more than 3 restarts in 60 s, or it would not end), or could not write all of its output, such as a record \
    on a full disk; 2 a flag, the team file, the key or the policy is \
    wrong; 130 interrupted by Ctrl-C or SIGTERM. The results until then are printed.")]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    /// Command that starts each process, with {host} for its host's name, such as 'ip netns exec lab-{host}' for
    /// network namespaces; its words are separated by spaces
    #[arg(long, value_name = "COMMAND")]
    through: Option<String>,
    /// Runs each process in a station of a laboratory: links by radio on its channel, all others on its cable
    #[cfg(feature = "lab")]
    #[arg(long, value_name = "FILE", conflicts_with = "through")]
    lab: Option<std::path::PathBuf>,
    #[command(flatten)]
    record: recording::RecordFlags,
    #[command(flatten)]
    page: watch::OptionalPage,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    json: bool,
    /// Prints only errors and warnings on stderr, without the logs of the processes
    #[arg(long)]
    quiet: bool,
}

/// Runs `launch`: starts the team, waits for it, and prints the results.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    args.page.check()?;
    #[cfg(feature = "lab")]
    if let Some(file) = &args.lab {
        return stations::run(args, file, registry).map_err(crate::lab::sorted);
    }
    let place = Place { before: &|host, _| through(args, host), page: None };
    run_team(args, &args.team, &place, registry)
}

/// Place on this machine of the processes of a team and of the live page.
struct Place<'a> {
    /// Returns the words that precede the command of a process, by the name and the number of its host.
    before: &'a dyn Fn(&str, usize) -> Vec<String>,
    /// Network namespace in which the page joins the team; `None` for that of this process.
    page: Option<&'a str>,
}

/// Starts the team `team` at `place`, waits for it, and prints the results.
fn run_team(args: &Args, team: &team::TeamArgs, place: &Place, registry: &Registry) -> Result<Ended> {
    let file = team.read(registry)?;
    let teams: Vec<Team> = file.hosts().map(|host| team.for_host(&file, host)).collect::<Result<_>>()?;
    let policy = checked(&teams, registry)?;
    let flies = RobotId::team(file.deployment().robots).any(|robot| file.deployment().flight(robot).is_some());
    let (landing, usual) = (Duration::from_secs_f64(if flies { LANDING.as_secs() } else { 0.0 }), Limits::default());
    let limits = Limits { finish: usual.finish + landing, stop: usual.stop + landing, ..usual };
    let supervisor = Supervisor::new(processes(args, team, &file, place.before)?, limits);
    let stopper = supervisor.stopper();
    let interrupted = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&interrupted);
    ctrlc::set_handler(move || {
        signal.store(true, Ordering::Relaxed);
        stopper.stop();
    })
    .context("cannot listen for Ctrl-C")?;

    let names: Vec<String> = file.deployment().hosts.iter().map(|host| host.name.clone()).collect();
    let mut results = Results::new(&names, teams[0].episodes);
    let progress = Progress::new(&names, teams[0].episodes, args.quiet);
    let outcome = supervise(args, (team, &file, place), registry, supervisor, (&mut results, progress))?;
    if let Outcome::Refused(why) = outcome {
        return Err(BadInput(why).into());
    }
    let first = &teams[0];
    let (wall_s, finished) = (results.wall_s(), results.are_all());
    // An interrupt counts even if all results are there, as long as processes are running.
    let interrupted = interrupted.load(Ordering::Relaxed);
    let run = Run {
        mode: first.deployment.mode.clone(),
        scenario: first.scenario.clone(),
        policy,
        robots: first.deployment.robots,
        cost: CostName::named(registry, &first.scenario, first.deployment.robots),
        judged: first.deployment.judged(),
        seed: first.seed,
        wall_s,
        network: None,
        faults: Vec::new(),
        interrupted: !finished || interrupted,
    };
    let own = Unwritten { log_lines: log_lines_dropped(), ..Unwritten::default() };
    let unwritten = [results.unwritten(), own].into_iter().sum();
    let summary = Summary::of_team(run, results.report(wall_s), Counts::Team, unwritten);
    print(&if args.json {
        serde_json::to_string(&summary).context("a summary is JSON")?
    } else {
        summary.to_string()
    })?;
    match outcome {
        Outcome::Failed(why) => Err(anyhow!(why)),
        Outcome::Done | Outcome::Incomplete(_) if !finished => {
            let (got, all) = (results.received(), first.episodes);
            Err(anyhow!(
                "every process has ended, with a result of {got} of {}; see their logs",
                counted(all, "episode")
            ))
        }
        Outcome::Incomplete(why) => Err(anyhow!("every episode has a result, but {why}")),
        _ => Ok(if interrupted { Ended::Interrupted } else { Ended::Done }),
    }
}

/// Returns the processes of all hosts.
fn processes(
    args: &Args,
    team: &team::TeamArgs,
    file: &TeamFile,
    before: &dyn Fn(&str, usize) -> Vec<String>,
) -> Result<Vec<Process>> {
    let program = this_program()?;
    let of = |(number, host): (usize, &murmurate::deploy::Host)| {
        let (program, mut flags) = (program.clone(), team_arguments(team));
        flags.extend(["--host".into(), host.name.clone().into(), "--json".into(), "--launched".into()]);
        flags.extend(args.record.arguments());
        let before = before(&host.name, number);
        let mut words = before.into_iter().map(OsString::from).chain(program);
        let mut command = Command::new(words.next().expect("the program is one of them"));
        command.args(words).arg("host").args(flags);
        Process { name: host.name.clone(), command }
    };
    Ok(file.deployment().hosts.iter().enumerate().map(of).collect())
}

/// Returns the words of the flag `--through` that precede the command of a host's process, with `{host}` replaced by
/// the host's name; empty without the flag.
fn through(args: &Args, host: &str) -> Vec<String> {
    args.through
        .iter()
        .flat_map(|command| command.split_whitespace())
        .map(|word| word.replace("{host}", host))
        .collect()
}

/// Runs the processes of all hosts until they end, and collects their results in `results`; `progress`
/// prints their events, and the live page shows them if `--watch` is given. Returns how the run ended.
fn supervise(
    args: &Args,
    (team, file, place): (&team::TeamArgs, &TeamFile, &Place),
    registry: &Registry,
    supervisor: Supervisor,
    (results, mut progress): (&mut Results, Progress),
) -> Result<Outcome> {
    if args.page.watch {
        let (sender, receiver) = std::sync::mpsc::channel();
        progress.page = Some(sender);
        let page = watch::team::Page::open(file, team, &args.page.page, registry, Some(receiver))?;
        let space = place.page;
        return Ok(std::thread::scope(|scope| {
            scope.spawn(|| {
                // The event of the run's end ends the page.
                let run = || page.run(team, registry, None, || false);
                let ended = match space {
                    #[cfg(feature = "lab")]
                    Some(space) => murmurate_lab::machine::inside(space, run),
                    _ => run(),
                };
                if let Err(error) = ended {
                    talk(&format!("warning: the page has ended: {error:#}"));
                }
            });
            let outcome = supervisor.run(|at, output| results.take(at, &output, |event| progress.show(at, event)));
            let (regular, text) = results.ending(&outcome);
            progress.send(TeamEvent::Over(Ending { regular, text }));
            outcome
        }));
    }
    Ok(supervisor.run(|at, output| results.take(at, &output, |event| progress.show(at, event))))
}

/// Returns the team file and the flags `--set`, `--interface` and `--key-file` as command-line arguments for another
/// process of this program.
fn team_arguments(team: &team::TeamArgs) -> Vec<OsString> {
    let mut all: Vec<OsString> = vec![team.file.clone().into()];
    all.extend(team.set.iter().flat_map(|given| ["--set".into(), given.into()]));
    all.extend(team.interface.iter().flat_map(|name| ["--interface".into(), name.into()]));
    all.extend(team.key_file.iter().flat_map(|path| ["--key-file".into(), path.into()]));
    all
}

/// Reads every host's key file and policy before any process starts, and fails if one is wrong. Returns the policies'
/// names, separated by commas.
fn checked(teams: &[Team], registry: &Registry) -> Result<String> {
    let mut names: Vec<String> = Vec::new();
    let mut seen: Vec<&Team> = Vec::new();
    for team in teams {
        if !seen.iter().any(|other| other.key_file == team.key_file) {
            team::key(team)?;
        }
        if !seen.iter().any(|other| other.policy == team.policy) {
            names.push(team::policy(team, registry)?.name);
        }
        seen.push(team);
    }
    Ok(names.join(", "))
}
