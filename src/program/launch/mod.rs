//! The command `murmurate launch`: runs every process of a team on this machine and prints the table of results.
//!
//! Each process is `host` of this program. It prints events as JSON lines on stdout (`report::event`). Its stderr is
//! passed on with the host's name before each line.

mod outcome;
#[cfg(feature = "lab")]
mod stations;
mod supervisor;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::deploy::team::{Team, TeamFile};
use crate::registry::Registry;
use crate::report::episode::Episode;
use crate::report::event::{Counted, HostEvent, Unwritten};
use crate::report::summary::{CostName, Counts, Run, Summary};
use crate::report::trial::TrialReport;
use crate::time::Span;
use anyhow::{Context, Result, anyhow};

use crate::program::BadInput;
use crate::program::Ended;
#[cfg(all(feature = "watch", feature = "lab"))]
use crate::program::lab;
use crate::program::output::{colour, log_lines_dropped, print, talk};
use crate::program::recording;
use crate::program::team;
use crate::program::this_program;
#[cfg(feature = "watch")]
use crate::program::watch;
use outcome::Outcome;
use supervisor::{Limits, Output, Process, Response, Supervisor};

/// Flags of `murmurate launch`.
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
    #[cfg(feature = "watch")]
    #[command(flatten)]
    page: watch::OptionalPage,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    json: bool,
    /// Prints only errors and warnings on stderr, without the logs of the processes
    #[arg(long)]
    quiet: bool,
}

/// ANSI colour codes of the host names before log lines. Red is left out, because it looks like an error.
const COLOURS: [u8; 10] = [36, 32, 33, 35, 34, 96, 92, 93, 95, 94];

/// Runs `launch`: starts the team, waits for it, and prints the results.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    #[cfg(feature = "watch")]
    args.page.check()?;
    #[cfg(feature = "lab")]
    if let Some(file) = &args.lab {
        return stations::run(args, file, registry);
    }
    let place = Place { before: &|host, _| through(args, host), page: None };
    run_team(args, &args.team, &place, registry)
}

/// Where the processes of a team and the live page run on this machine.
struct Place<'a> {
    /// Returns the words that precede the command of a process, by the name and the number of its host.
    before: &'a dyn Fn(&str, usize) -> Vec<String>,
    /// Network namespace in which the page joins the team; `None` for that of this process.
    #[cfg_attr(not(all(feature = "watch", feature = "lab")), expect(dead_code, reason = "there is no page or no lab"))]
    page: Option<&'a str>,
}

/// Starts the team `team` at `place`, waits for it, and prints the results.
fn run_team(args: &Args, team: &team::TeamArgs, place: &Place, registry: &Registry) -> Result<Ended> {
    let file = team.read(registry)?;
    let teams: Vec<Team> = file.hosts().map(|host| team.for_host(&file, host)).collect::<Result<_>>()?;
    let policy = checked(&teams, registry)?;
    let supervisor = Supervisor::new(processes(args, team, &file, place.before)?, Limits::default());
    let stopper = supervisor.stopper();
    let interrupted = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&interrupted);
    ctrlc::set_handler(move || {
        signal.store(true, Ordering::Relaxed);
        stopper.stop();
    })
    .context("cannot listen for Ctrl-C")?;

    let names: Vec<String> = file.deployment().hosts.iter().map(|host| host.name.clone()).collect();
    let mut results = Results::new(&names, teams[0].episodes, args.quiet);
    let outcome = supervise(args, (team, &file, place), registry, supervisor, &mut results)?;
    if let Outcome::Refused(why) = outcome {
        return Err(BadInput(why).into());
    }
    let first = &teams[0];
    let began = results.began;
    let wall_s = began.elapsed().as_secs_f64();
    let finished = results.episodes.len() == first.episodes as usize;
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
    let summary = Summary::of_team(run, results.report(wall_s), Counts::Team, results.unwritten());
    print(&if args.json {
        serde_json::to_string(&summary).context("a summary is JSON")?
    } else {
        summary.to_string()
    })?;
    match outcome {
        Outcome::Failed(why) => Err(anyhow!(why)),
        Outcome::Done | Outcome::Incomplete(_) if !finished => {
            let (got, all) = (results.episodes.len(), first.episodes);
            Err(anyhow!("every process has ended, but {got} of {all} episodes have a result; see their logs"))
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
    let of = |(number, host): (usize, &crate::deploy::Host)| {
        let (program, mut flags) = (program.clone(), team_arguments(team));
        flags.extend(["--host".into(), host.name.clone().into(), "--json".into(), "--launched".into()]);
        flags.extend(args.record.arguments());
        let before = before(&host.name, number);
        let command = move || {
            let mut words = before.iter().map(OsString::from).chain(program.clone());
            let mut command = Command::new(words.next().expect("the program is one of them"));
            command.args(words).arg("host").args(&flags);
            command
        };
        Process { name: host.name.clone(), command: Box::new(command) }
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

/// Runs the processes of all hosts until they end, and collects their results in `results`; serves the live page
/// meanwhile if `--watch` is given. Returns how the run ended.
fn supervise(
    args: &Args,
    (_team, _file, _place): (&team::TeamArgs, &TeamFile, &Place),
    _registry: &Registry,
    supervisor: Supervisor,
    results: &mut Results,
) -> Result<Outcome> {
    #[cfg(feature = "watch")]
    if args.page.watch {
        let (sender, receiver) = std::sync::mpsc::channel();
        results.page = Some(sender);
        let page = watch::team::Page::open(_file, _team, &args.page.page, _registry, Some(receiver))?;
        let over = AtomicBool::new(false);
        #[cfg(feature = "lab")]
        let space = _place.page;
        return Ok(std::thread::scope(|scope| {
            scope.spawn(|| {
                let run = || page.run(_team, _registry, None, || over.load(Ordering::Relaxed));
                #[cfg(feature = "lab")]
                let ended = match space {
                    Some(space) => lab::inside(space, run),
                    None => run(),
                };
                #[cfg(not(feature = "lab"))]
                let ended = run();
                if let Err(error) = ended {
                    talk(&format!("warning: the page has ended: {error:#}"));
                }
            });
            let outcome = supervisor.run(|at, output| results.handle(at, &output));
            over.store(true, Ordering::Relaxed);
            outcome
        }));
    }
    Ok(supervisor.run(|at, output| results.handle(at, &output)))
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

/// Results received from the processes so far.
struct Results {
    names: Vec<String>,
    width: usize,
    wanted: u32,
    quiet: bool,
    coloured: bool,
    began: Instant,
    ready: usize,
    episodes: BTreeMap<u32, Episode>,
    /// Counts (messages and the like) that the newest incarnation of each process has reported, by process.
    counted: Vec<Counted>,
    /// Last counts of processes that have been restarted since: one entry per earlier incarnation.
    past: Vec<Counted>,
    /// Sender of results to the live page; `None` without a page.
    #[cfg(feature = "watch")]
    page: Option<std::sync::mpsc::Sender<Episode>>,
}

impl Results {
    fn new(names: &[String], wanted: u32, quiet: bool) -> Results {
        Results {
            names: names.to_vec(),
            width: names.iter().map(|name| name.chars().count()).max().unwrap_or(0),
            wanted,
            quiet,
            coloured: colour(),
            began: Instant::now(),
            ready: 0,
            episodes: BTreeMap::new(),
            counted: vec![Counted::default(); names.len()],
            past: Vec::new(),
            #[cfg(feature = "watch")]
            page: None,
        }
    }

    fn handle(&mut self, at: usize, output: &Output<'_>) -> Response {
        match *output {
            Output::Log(line) => self.pass_on(at, line),
            Output::Note(note) => talk(&format!("warning: the process '{}' {note}", self.names[at])),
            Output::Data(line) => match HostEvent::from_line(line) {
                Some(HostEvent::Ready { .. }) => {
                    self.past.push(std::mem::take(&mut self.counted[at]));
                    self.ready();
                }
                Some(HostEvent::Episode(episode)) => self.episode(episode),
                Some(HostEvent::Counted(counted)) => self.counted[at] = counted,
                Some(HostEvent::Finished(counted)) => {
                    self.counted[at] = counted;
                    return Response::Done;
                }
                None => self.pass_on(at, line),
            },
        }
        Response::Continue
    }

    /// Counts a process as ready. The run's clock starts when all are ready.
    fn ready(&mut self) {
        self.ready += 1;
        if self.ready == self.names.len() {
            self.began = Instant::now();
            self.info(&format!("{} processes run; Ctrl-C stops them and prints the results so far", self.ready));
        }
    }

    fn episode(&mut self, episode: Episode) {
        // A restarted host may report an episode again; the first report counts.
        if self.episodes.contains_key(&episode.episode) {
            return;
        }
        self.episodes.insert(episode.episode, episode);
        #[cfg(feature = "watch")]
        if let Some(page) = &self.page {
            // Sending fails if the page has ended, which does not matter.
            let _ = page.send(episode);
        }
        self.info(&format!("episode {} of {}: {}", episode.episode + 1, self.wanted, episode.in_words()));
    }

    fn info(&self, text: &str) {
        if !self.quiet {
            talk(text);
        }
    }

    fn pass_on(&self, at: usize, line: &str) {
        let name = format!("{:1$}", self.names[at], self.width);
        let name = if self.coloured { format!("\x1b[{}m{name}\x1b[0m", COLOURS[at % COLOURS.len()]) } else { name };
        self.info(&format!("{name} | {line}"));
    }

    fn incarnations(&self) -> impl Iterator<Item = &Counted> + Clone {
        self.past.iter().chain(&self.counted)
    }

    fn unwritten(&self) -> Unwritten {
        let own = Unwritten { log_lines: log_lines_dropped(), ..Unwritten::default() };
        self.incarnations().map(|counted| counted.unwritten).chain([own]).sum()
    }

    fn report(&self, wall_s: f64) -> TrialReport {
        let report = TrialReport {
            episodes: self.episodes.values().copied().collect(),
            simulated: Span::from_secs(wall_s),
            finished: self.episodes.len() == self.wanted as usize,
            ..TrialReport::default()
        };
        report.counted(self.incarnations())
    }
}
