//! The command `murmurate host`: runs one host of a team in real time on its sockets. This runs on robots.

mod patience;
mod seen;

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use self::patience::Patience;
use self::seen::Seen;
use anyhow::{Context, Result, anyhow};
use clap::ValueEnum;
use murmurate::deploy::team::{Team, TeamFile};
use murmurate::flight::LANDING;
use murmurate::graph::process::Graph;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::link::DuplicateId;
use murmurate::policy::Models;
use murmurate::registry::Registry;
use murmurate::results::totals::Steps;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate_report::event::{self, Counted, HostEvent};
use murmurate_report::summary::{CostName, Counts, Run, Summary};
use sd_notify::NotifyState;
use signal_hook::consts::SIGINT;

use crate::BadInput;
use crate::Ended;
use crate::key::KeyFile;
use crate::key::kept::Keeper;
#[cfg(feature = "watch")]
use crate::metrics::MetricsFlags;
use crate::outlets::Outlets;
use crate::recording;
use crate::recording::LiveRecord;
use crate::signals;
use crate::team;
use murmurate::live::{self, LiveHost};

/// Time from a request to stop until the host ends, in which its last commands and its notice of shutdown are sent.
const STOPPING: Span = Span::from_millis(200);

/// Role that selects a host, in a team with one host of that role.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Role {
    /// Runs the agents of several robots.
    Pc,
    /// Runs the simulated World.
    World,
    /// Runs the StateServer.
    StateServer,
}

/// Runs one host of a team in real time: what is started on a robot.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    #[command(flatten)]
    which: team::Which,
    /// Selects the host by its role
    #[arg(long, conflicts_with = "which-host")]
    role: Option<Role>,
    /// Prints events as JSON, one object per line, instead of the final table; the host stops when the reader closes
    /// the pipe
    #[arg(long)]
    json: bool,
    /// CSV file for every robot's trajectory, written while the host runs; only for the host with the World
    #[arg(long, value_name = "FILE.csv")]
    trajectories: Option<PathBuf>,
    #[command(flatten)]
    record: recording::RecordFlags,
    #[cfg(feature = "watch")]
    #[command(flatten)]
    metrics: MetricsFlags,
    /// Leaves out warnings that `launch` has printed for all hosts
    #[arg(long, hide = true)]
    launched: bool,
}

/// Period of the event [`HostEvent::Counted`], which has the host's counts of messages, datagrams and so on. It is
/// printed periodically, so that the counts are known even if the host is killed.
const COUNTED_PERIOD: Span = Span::from_millis(1000);

/// Returns the description of the run for the table of results.
fn results_of(team: &Team, cost: Option<CostName>, policy: String, began: Instant, interrupted: bool) -> Run {
    Run {
        mode: team.deployment.mode.clone(),
        scenario: team.scenario.clone(),
        policy,
        robots: team.deployment.robots,
        cost,
        judged: team.deployment.judged(),
        seed: team.seed,
        wall_s: began.elapsed().as_secs_f64(),
        network: None,
        faults: Vec::new(),
        interrupted,
    }
}

/// Parses the arguments of the command `host` that made a record, and returns its flags about the team: the path of the
/// team file and the changes to it. It is an error if the arguments are not understood.
pub fn of_record(arguments: &[String]) -> Result<team::TeamArgs> {
    use clap::{Args as _, FromArgMatches};
    let wrong = |error: clap::Error| BadInput(format!("the record's arguments are not understood: {error}"));
    let found = Args::augment_args(clap::Command::new("host")).try_get_matches_from(arguments).map_err(wrong)?;
    Ok(Args::from_arg_matches(&found).map_err(wrong)?.team)
}

/// Runs the command `host`: the actors of one host of the team, until the team has finished or a stop is requested.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let began = Instant::now();
    // The allocator asks for huge pages of 2 MiB, so the first byte beyond one took 2 MiB more of a robot's memory. A
    // kernel without this setting goes on with them.
    #[cfg(target_os = "linux")]
    let _ = nix::sys::prctl::set_thp_disable(true);
    #[cfg(feature = "watch")]
    args.metrics.check()?;
    let file = args.team.read(registry)?;
    let id = args.host(&file)?;
    let team = args.team.for_host(&file, id)?;
    let name = team.deployment.hosts[usize::from(id.0)].name.clone();
    if args.launched {
        team::leave_out_key_warning();
    }
    let file = team::key(&team)?;
    let key = file.as_ref().map(|file| file.key().confidential_if(team.confidential));
    let policy = crate::policy::room::checked(team::policy(&team, registry)?, key.as_ref())?;
    let digest = policy.models.digest();
    let trial = args.trial(registry, &team, policy.models)?;
    let links = team.deployment.links.iter().map(|link| link.name.clone()).collect();
    let outlets = Outlets::open(args.json, args.trajectories.as_deref())?;
    let seen = Rc::new(Seen::new(outlets, links, keeper(file.as_ref())?));
    let (outlets, known) = (&seen.outlets, key.clone());
    let (signal, wake_reader) = signals::listen()?;
    let mut patience = Patience::new((&signal, &wake_reader), outlets, (args.json, args.launched));
    let live = match LiveHost::open_when_fit(&team, &trial, key, registry, &mut |error| patience.wait(error)) {
        // Asked to end while it waited.
        Err(_) if signal.load(Ordering::Relaxed) != 0 => return ended(&signal),
        opened => opened?,
    };
    patience.end();
    let files = files(&args.team.file, &team);
    let record = LiveRecord::of_host(&args.record, (&team, &live), (began, known.as_ref()), (files, &digest))?;
    seen.record.set(record).ok();
    #[cfg(feature = "watch")]
    seen.metrics.set(args.metrics.open(&team)?).ok();
    tracing::info!(host = name, robots = team.deployment.robots, policy = policy.name, digest, "starts");
    let abandoned = Rc::new(Cell::new(false));
    let mut watch =
        Watch::new(&team, Rc::clone(&seen), (Arc::clone(&signal), signals::keep_request()?), Rc::clone(&abandoned));
    let (heard, recorded) = (Rc::clone(&seen), Rc::clone(&seen));
    let graph = live.run(
        began,
        move |host, event| heard.receive(host, event),
        move |out| recorded.note(out),
        |readers, now| {
            seen.end_turn(now, None);
            outlets.notify(&NotifyState::Ready);
            signals::watch(readers, wake_reader);
            if args.json {
                // If the process that reads this host's events has died, no one supervises the robot, so it must stop.
                let gone = Rc::clone(&abandoned);
                readers.watch_end(Rc::new(std::io::stdout()), move || gone.set(true));
            }
            outlets.print_event(&HostEvent::Ready { host: name.clone() });
        },
        |graph: &Rc<Graph>, now| watch.turn(graph, now),
    );
    let written = seen.record().map_or(Ok(()), LiveRecord::finish);
    let counted = seen.counted(&graph);
    drop(graph);
    watch.failure(&name)?;
    let interrupted = watch.over.is_none();
    let run = results_of(&team, CostName::of(&*trial.scenario), policy.name, began, interrupted);
    print_results(&seen, counted, run, args.json, team.deployment.hosts.len() == 1);
    outlets.close()?;
    written?;
    if interrupted { ended(&signal) } else { Ok(Ended::Done) }
}

/// Returns the files that a record of a host has: that of the team, its task file, and those of the policies.
fn files(team_file: &Path, team: &Team) -> Vec<PathBuf> {
    let of_roles = team.deployment.roles.values().filter_map(|role| role.policy.clone());
    let task = team.task.iter().map(|(path, _)| path.clone());
    std::iter::once(team_file.to_owned()).chain(task).chain(team.policy.clone()).chain(of_roles).collect()
}

/// Starts the writer of the rosters of a member with its own key file.
fn keeper(file: Option<&KeyFile>) -> Result<Option<Keeper>> {
    let kept = file.and_then(KeyFile::kept);
    kept.map(Keeper::open).transpose().context("cannot start a thread to write rosters")
}

/// Prints the last event, with the counts of the host, and the table of results unless events are printed as JSON.
/// `alone` says that no other host is in the team, so that the counts are those of the team.
fn print_results(seen: &Seen, counted: Counted, run: Run, json: bool, alone: bool) {
    let report = event::counted(seen.report.borrow().clone(), [&counted].into_iter());
    let unwritten = counted.unwritten;
    let last = if run.interrupted { HostEvent::Counted(counted) } else { HostEvent::Finished(counted) };
    seen.outlets.print_event(&last);
    if !json && !report.episodes.is_empty() {
        let counts = if alone { Counts::Team } else { Counts::Host };
        seen.outlets.print(&Summary::of_team(run, report, counts, unwritten).to_string());
    }
}

/// Returns the end of a host that was asked to end by the signal of this number, if any: SIGTERM asks for a regular
/// one.
fn ended(signal: &AtomicUsize) -> Result<Ended> {
    Ok(if signal.load(Ordering::Relaxed) == SIGINT as usize { Ended::Interrupted } else { Ended::Done })
}

/// Number of the signal that ended the host, and the flag that requests to keep the last seconds of its record.
type Signals = (Arc<AtomicUsize>, Arc<AtomicBool>);

/// State of the work that a host does after every turn of its event loop: it prints new events, notifies the service
/// manager, and decides whether the host ends.
struct Watch {
    seen: Rc<Seen>,
    id: HostId,
    /// Time that the host runs on after the last episode.
    grace: Span,
    signal: Arc<AtomicUsize>,
    /// Flag that a signal sets to request that the last seconds of the record are kept; cleared when that is done.
    keep: Arc<AtomicBool>,
    /// True if the reader of the events that the host prints has closed the pipe.
    abandoned: Rc<Cell<bool>>,
    /// Watchdog timeout of the service manager; `None` without one.
    watchdog: Option<Duration>,
    /// Number of episodes reported so far.
    reported: usize,
    /// Time of the last watchdog notification.
    notified: Time,
    /// Time of the last printed event with counts.
    counted: Time,
    over: Option<Time>,
    stopping: Option<Time>,
    /// Error that has ended the host's output, such as of a full disk; `None` without one.
    lost: Option<anyhow::Error>,
}

impl Watch {
    fn new(team: &Team, seen: Rc<Seen>, (signal, keep): Signals, abandoned: Rc<Cell<bool>>) -> Watch {
        Watch {
            seen,
            id: team.host,
            grace: live::grace(team),
            signal,
            keep,
            abandoned,
            watchdog: sd_notify::watchdog_enabled(),
            reported: 0,
            notified: Time::ZERO,
            counted: Time::ZERO,
            over: None,
            stopping: None,
            lost: None,
        }
    }

    /// Prints new events, notifies the service manager, and handles requests to stop or to keep the record. It is
    /// called after each turn of the event loop. Returns true if the host must end now.
    fn turn(&mut self, graph: &Graph, now: Time) -> bool {
        let seen = Rc::clone(&self.seen);
        let outlets = &seen.outlets;
        while let Some(episode) = seen.report.borrow().episodes.get(self.reported).copied() {
            self.reported += 1;
            outlets.print_event(&HostEvent::Episode(episode));
        }
        if now.since(self.counted) >= COUNTED_PERIOD {
            self.counted = now;
            seen.heard.take().into_iter().for_each(|heard| outlets.print_event(&HostEvent::Heard(heard)));
            outlets.print_event(&HostEvent::Counted(seen.counted(graph)));
        }
        if let Some(timeout) = self.watchdog
            && now.since(self.notified) >= Span::from_secs(timeout.as_secs_f64() / 4.0)
        {
            self.notified = now;
            outlets.notify(&NotifyState::Watchdog);
        }
        if seen.over.get() && self.over.is_none() {
            self.over = Some(now);
        }
        if (self.signal.load(Ordering::Relaxed) != 0 || self.abandoned.get()) && self.stopping.is_none() {
            self.stopping = Some(now);
            outlets.notify(&NotifyState::Stopping);
            graph.leave(self.id);
            if self.abandoned.get() {
                // The process that supervised the whole team has died, so the team is stopped.
                graph.stop(self.id);
            }
        }
        if self.keep.swap(false, Ordering::Relaxed) {
            seen.record().into_iter().for_each(LiveRecord::keep);
        }
        for number in seen.keeper.iter().filter_map(Keeper::kept) {
            graph.roster_kept(self.id, number);
        }
        seen.end_turn(now, Some(graph.steps()));
        self.lost = outlets.failure();
        self.lost.is_some()
            || seen.duplicate.get().is_some()
            || self.over.is_some_and(|at| self.is_down(graph, now.since(at), self.grace))
            || self.stopping.is_some_and(|at| self.is_down(graph, now.since(at), STOPPING))
    }

    /// Whether a host that ends since `since` has waited for `least`, and for the landing of its robots.
    fn is_down(&self, graph: &Graph, since: Span, least: Span) -> bool {
        since >= least && (!graph.is_airborne() || since >= LANDING)
    }

    /// Returns an error if the host did not end regularly. `name` is the name of the host.
    fn failure(&mut self, name: &str) -> Result<()> {
        if let Some(error) = self.lost.take() {
            return Err(error);
        }
        if let Some(DuplicateId { host, .. }) = self.seen.duplicate.get() {
            return Err(anyhow!(
                "another live host is number {} of this team ('{name}') and was started before this one: stop it, or \
                 correct --host or --robot here",
                host.0
            ));
        }
        if self.abandoned.get() && !self.seen.over.get() {
            return Err(anyhow!("the reader of this host's events has closed the pipe; the host has stopped"));
        }
        Ok(())
    }
}

impl Args {
    /// Returns the trial that the host runs, which reports every step if trajectories are written.
    fn trial(&self, registry: &Registry, team: &Team, models: Models) -> Result<Trial> {
        let mut trial = Trial::of_host(registry, team, models).map_err(|e| BadInput(e.to_string()))?;
        if self.trajectories.is_some() {
            trial.steps = Steps::Reported;
            sees_whole_team(team)?;
        }
        // An emulated channel that is too small is refused; what carries real datagrams is not known.
        for budget in trial.budgets().iter().filter(|budget| budget.is_exceeded()) {
            tracing::warn!("{budget}: raise the access point's basic rate, or expect that messages are lost");
        }
        Ok(trial)
    }

    fn host(&self, file: &TeamFile) -> Result<HostId> {
        if let Some(host) = self.which.find(file)? {
            return Ok(host);
        }
        let Some(role) = self.role else {
            let why = "which host is this? give --host NAME, --robot N, or --role pc|world|state-server";
            return Err(BadInput(why.to_owned()).into());
        };
        let hosts = &file.deployment().hosts;
        let fits: Vec<usize> = (0..hosts.len())
            .filter(|&at| match role {
                Role::Pc => hosts[at].agents.concat().len() > 1,
                Role::World => !hosts[at].simulates.is_empty(),
                Role::StateServer => hosts[at].state_server,
            })
            .collect();
        match fits[..] {
            [only] => Ok(HostId(u16::try_from(only).expect("hosts are counted in u16"))),
            _ => Err(BadInput(format!("--role: {} hosts have that role; give --host NAME", fits.len())).into()),
        }
    }
}

/// Checks that the host simulates every robot of the team, which `--trajectories` needs, since trajectories come from
/// true states. Otherwise it is an error.
fn sees_whole_team(team: &Team) -> Result<()> {
    let host = &team.deployment.hosts[usize::from(team.host.0)];
    if host.simulates.len() != team.deployment.robots {
        let why = format!("--trajectories: host '{}' does not run the World of the whole team", host.name);
        return Err(BadInput(why).into());
    }
    Ok(())
}
