//! `murmurate host`: runs one host of a team in real time: its actors, on its sockets. A robot runs this.

use std::cell::{Cell, OnceCell, RefCell};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::actors::recorder::{Out, Steps};
use crate::deploy::team::{Team, TeamFile};
use crate::graph::process::{Graph, ProcessEvent};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::{Phase, Wire};
use crate::net::protocol::key::Key;
use crate::net::protocol::link::{DuplicateId, LinkCounts};
use crate::registry::Registry;
use crate::report::event::{Counted, HostEvent, RobotSafety, Unwritten};
use crate::report::hardware::RobotHardware;
use crate::report::summary::{Counts, Run, Summary};
use crate::report::trial::TrialReport;
use crate::safety::guard::SafetyCounts;
use crate::time::{Span, Time};
use crate::trial::Trial;
use anyhow::{Result, anyhow};
use clap::ValueEnum;
use sd_notify::NotifyState;
use signal_hook::consts::SIGINT;

use crate::live::{self, LiveHost};
use crate::program::BadInput;
use crate::program::Ended;
use crate::program::outlets::Outlets;
use crate::program::recording::{self, OfHost};
use crate::program::signals;
use crate::program::team;

/// Time from a request to stop until the host ends, in which its last commands and its notice of leaving are sent.
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

/// Flags of `murmurate host`.
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
    /// Leaves out warnings that `launch` has printed for all hosts
    #[arg(long, hide = true)]
    launched: bool,
}

/// Period of the event with all counts, which remain known if the host is killed.
const COUNTED_PERIOD: Span = Span::from_millis(1000);

/// Returns what the table of results says of the run.
fn results_of(team: &Team, policy: String, began: Instant, interrupted: bool) -> Run {
    Run {
        mode: team.deployment.mode.clone(),
        scenario: team.scenario.clone(),
        policy,
        robots: team.deployment.robots,
        judged: team.deployment.judged(),
        seed: team.seed,
        wall_s: began.elapsed().as_secs_f64(),
        network: None,
        faults: Vec::new(),
        interrupted,
    }
}

/// Returns the flags of a record's team file, from the arguments of the command that made the record.
#[cfg(feature = "sim")]
pub fn of_record(arguments: &[String]) -> Result<team::TeamArgs> {
    use clap::{Args as _, FromArgMatches};
    let wrong = |error: clap::Error| BadInput(format!("the record's arguments are not understood: {error}"));
    let found = Args::augment_args(clap::Command::new("host")).try_get_matches_from(arguments).map_err(wrong)?;
    Ok(Args::from_arg_matches(&found).map_err(wrong)?.team)
}

/// State collected while the host runs.
struct Seen {
    report: RefCell<TrialReport>,
    over: Cell<bool>,
    messages: Cell<u64>,
    counts: Cell<LinkCounts>,
    safety: RefCell<BTreeMap<RobotId, SafetyCounts>>,
    hardware: RefCell<BTreeMap<RobotId, RobotHardware>>,
    outlets: Outlets,
    /// Another live host has the id of this one.
    duplicate: Cell<Option<DuplicateId>>,
    /// Record of the run, if there is one.
    record: OnceCell<Option<OfHost>>,
}

/// Runs the host until the team has finished, or until it is told to stop.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let began = Instant::now();
    let file = args.team.read(registry)?;
    let id = args.host(&file)?;
    let team = args.team.for_host(&file, id)?;
    let name = team.deployment.hosts[usize::from(id.0)].name.clone();
    if args.launched {
        team::leave_out_key_warning();
    }
    let key = team::key(&team)?.map(Key::new);
    let policy = team::policy(&team, registry)?;
    let digest = policy.model.digest().to_owned();
    let mut trial = Trial::of_host(registry, &team, policy.model).map_err(|e| BadInput(e.to_string()))?;
    if args.trajectories.is_some() {
        trial.steps = Steps::Reported;
        sees_whole_team(&team)?;
    }
    let seen = Rc::new(Seen::new(Outlets::open(args.json, args.trajectories.as_deref())?));
    let outlets = &seen.outlets;
    let keyed = key.is_some();
    let live = LiveHost::open(&team, &trial, key, registry)?;
    let files = [Some(args.team.file.clone()), team.policy.clone()].into_iter().flatten().collect();
    seen.record.set(OfHost::open(&args.record, (&team, &live), (began, keyed), (files, &digest))?).ok();
    let (signal, wake_reader) = signals::listen()?;
    tracing::info!(host = name, robots = team.deployment.robots, policy = policy.name, digest, "starts");
    let abandoned = Rc::new(Cell::new(false));
    let mut watch = Watch::new(&team, Rc::clone(&seen), Arc::clone(&signal), Rc::clone(&abandoned));
    let (heard, recorded) = (Rc::clone(&seen), Rc::clone(&seen));
    let graph = live.run(
        began,
        move |host, event| heard.hear(host, event),
        move |out| recorded.note(out),
        |readers, now| {
            seen.end_turn(now);
            outlets.notify(&NotifyState::Ready);
            let source = Rc::clone(&wake_reader);
            readers.watch(wake_reader, move || {
                let _ = (&*source).read(&mut [0; 16]);
            });
            if args.json {
                // The process that started this host and read its events has died: its robot must not go on alone.
                let gone = Rc::clone(&abandoned);
                readers.watch_end(Rc::new(std::io::stdout()), move || gone.set(true));
            }
            outlets.print_event(&HostEvent::Ready { host: name.clone() });
        },
        |graph: &Rc<Graph>, now| watch.turn(graph, now),
    );
    let written = seen.record().map_or(Ok(()), OfHost::finish);
    let counted = seen.counted(&graph);
    drop(graph);
    watch.failure(&name)?;
    let report = seen.report.borrow().clone().counted([&counted].into_iter());
    let (interrupted, unwritten) = (watch.over.is_none(), counted.unwritten);
    outlets.print_event(&if interrupted { HostEvent::Counted(counted) } else { HostEvent::Finished(counted) });
    if !args.json && !report.episodes.is_empty() {
        let counts = if team.deployment.hosts.len() == 1 { Counts::Team } else { Counts::Host };
        let run = results_of(&team, policy.name, began, interrupted);
        outlets.print(&Summary::of_team(run, report, counts, unwritten).to_string());
    }
    outlets.close()?;
    written?;
    let by_user = signal.load(Ordering::Relaxed) == SIGINT as usize;
    Ok(if interrupted && by_user { Ended::Interrupted } else { Ended::Done })
}

/// Checks after every turn of the event loop: prints new events and decides whether the host ends.
struct Watch {
    seen: Rc<Seen>,
    id: HostId,
    /// Time that the host runs on after the last episode.
    grace: Span,
    signal: Arc<AtomicUsize>,
    /// True once the reader of its events has closed the pipe.
    abandoned: Rc<Cell<bool>>,
    /// Watchdog timeout of the service manager.
    watchdog: Option<Duration>,
    /// Number of episodes reported so far.
    reported: usize,
    /// Time of the last watchdog notification.
    notified: Time,
    /// Time of the last event with counts.
    counted: Time,
    over: Option<Time>,
    stopping: Option<Time>,
    /// Error that has ended its output.
    lost: Option<anyhow::Error>,
}

impl Watch {
    fn new(team: &Team, seen: Rc<Seen>, signal: Arc<AtomicUsize>, abandoned: Rc<Cell<bool>>) -> Watch {
        Watch {
            seen,
            id: team.host,
            grace: live::grace(team),
            signal,
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

    /// Runs the checks once; returns whether the host ends.
    fn turn(&mut self, graph: &Graph, now: Time) -> bool {
        let seen = Rc::clone(&self.seen);
        let outlets = &seen.outlets;
        while let Some(episode) = seen.report.borrow().episodes.get(self.reported).copied() {
            self.reported += 1;
            outlets.print_event(&HostEvent::Episode(episode));
        }
        if now.since(self.counted) >= COUNTED_PERIOD {
            self.counted = now;
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
                // The process that supervised the whole team has died.
                graph.stop(self.id);
            }
        }
        seen.end_turn(now);
        self.lost = outlets.failure();
        self.lost.is_some()
            || seen.duplicate.get().is_some()
            || self.over.is_some_and(|at| now.since(at) >= self.grace)
            || self.stopping.is_some_and(|at| now.since(at) >= STOPPING)
    }

    /// Returns an error if the host of that name has not ended as it should.
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

impl Seen {
    fn new(outlets: Outlets) -> Seen {
        let (report, over, messages, counts) = Default::default();
        let (safety, hardware, duplicate) = Default::default();
        Seen { report, over, messages, counts, safety, hardware, outlets, duplicate, record: OnceCell::new() }
    }

    /// Record of the run, if there is one.
    fn record(&self) -> Option<&OfHost> {
        self.record.get()?.as_ref()
    }

    /// Ends a turn of the event loop in the record.
    fn end_turn(&self, now: Time) {
        self.record().into_iter().for_each(|record| record.turn(now));
    }

    fn hear(&self, host: HostId, heard: ProcessEvent) {
        self.record().into_iter().for_each(|record| record.push(host, heard));
        match heard {
            ProcessEvent::Message(Wire::Mode(mode)) if mode.phase == Phase::EpisodesFinished => self.over.set(true),
            ProcessEvent::Message(_)
            | ProcessEvent::Peers(_)
            | ProcessEvent::Arrived(..)
            | ProcessEvent::Sent(..)
            | ProcessEvent::Input(_)
            | ProcessEvent::Truth(_)
            | ProcessEvent::Recorded(_) => {}
            ProcessEvent::Counts(counts) => self.counts.set(*counts),
            ProcessEvent::Safety(robot, counts) => drop(self.safety.borrow_mut().insert(robot, counts)),
            ProcessEvent::Hardware(robot, hardware) => {
                let mut all = self.hardware.borrow_mut();
                all.entry(robot).or_insert_with(|| RobotHardware::new(robot)).note(hardware);
            }
            ProcessEvent::Published(_) => self.messages.set(self.messages.get() + 1),
            ProcessEvent::Duplicate(duplicate) => self.duplicate.set(Some(duplicate)),
        }
    }

    fn note(&self, out: Out) {
        let mut report = self.report.borrow_mut();
        match out {
            Out::Step(step) => self.outlets.step(&step),
            other => report.note(other),
        }
        report.simulated = report.totals.end.since(Time::ZERO);
    }

    /// Returns all counts so far.
    fn counted(&self, graph: &Graph) -> Counted {
        let (refused, lost) = graph.undelivered();
        let robot = |(&robot, &counts): (&RobotId, &SafetyCounts)| RobotSafety { robot, counts };
        Counted {
            messages: self.messages.get(),
            refused,
            lost,
            links: Box::new(self.counts.get()),
            oldest_command_s: self.report.borrow().totals.oldest_command.map(Span::as_secs),
            safety: self
                .safety
                .borrow()
                .iter()
                .filter(|(_, counts)| counts.reasons().next().is_some())
                .map(robot)
                .collect(),
            hardware: self.hardware.borrow().values().cloned().collect(),
            unwritten: Unwritten {
                record_events: self.record().map_or(0, OfHost::dropped),
                ..self.outlets.unwritten()
            },
        }
    }
}

impl Args {
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

/// Refuses trajectories of a host that does not simulate the whole team.
fn sees_whole_team(team: &Team) -> Result<()> {
    let host = &team.deployment.hosts[usize::from(team.host.0)];
    if host.simulates.len() != team.deployment.robots {
        let why = format!("--trajectories: host '{}' does not run the World of the whole team", host.name);
        return Err(BadInput(why).into());
    }
    Ok(())
}
