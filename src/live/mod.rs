//! One host of a team in real time, from its team file to the end of its run, on this machine's clock and sockets. The
//! command `host` uses it, and `examples/host.rs` runs a whole team with it.

pub mod links;
mod replay;

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::Instant;

use self::links::{LinkError, ProcessIdentity};
use crate::actors::recorder::Out;
use crate::deploy::team::Team;
use crate::graph::devices::{self, DeviceError, Devices, Workers};
use crate::graph::end::HostEnd;
use crate::graph::event::Event;
use crate::graph::host;
use crate::graph::process::Graph;
use crate::messages::ids::HostId;
use crate::messages::wire::{Phase, Wire};
use crate::net::protocol::key::Key;
use crate::registry::Registry;
use crate::report::TrialReport;
use crate::runtime::real::{Readers, run_real};
use crate::time::{Span, Time};
use crate::trial::Trial;

/// Time for which a host without the state server continues after the last episode, so that hosts that missed the end
/// receive it again.
const GRACE: Span = Span::from_millis(500);
/// Time for which the host of the state server continues after the last episode. It is longer than that of other hosts,
/// because the state server announces the end.
const SERVER_GRACE: Span = Span::from_millis(2000);

/// Returns how long this host of a team continues to run after the last episode, so that hosts that missed the end
/// receive it again. It is longer for the host of the state server, which announces the end.
pub fn grace(team: &Team) -> Span {
    if team.deployment.hosts[usize::from(team.host.0)].state_server { SERVER_GRACE } else { GRACE }
}

/// Reason why a host cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// A link of the host cannot be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A driver or the source of readings of the host cannot be created or started.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

impl OpenError {
    /// Returns whether the cause is a mistake in the user's settings, in contrast to the state of the machine.
    pub fn is_wrong_input(&self) -> bool {
        matches!(self, OpenError::Link(LinkError::Wrong(_)) | OpenError::Device(DeviceError::Config(_)))
    }
}

/// One host of a team with open sockets, drivers and sources, ready to run in real time.
pub struct LiveHost {
    end: HostEnd,
    devices: Devices,
    workers: Workers,
    trial: Trial,
    grace: Span,
    /// Seed of the link layer's random streams, as bytes for a record of the process.
    seed: [u8; 32],
}

impl LiveHost {
    /// Opens the sockets, drivers and source of the host that `team` describes; `trial` is the team's trial. Drivers
    /// and sources are looked up in `registry` by name. `key` authenticates the team's datagrams; `None` only if no
    /// link leaves this machine.
    pub fn open(team: &Team, trial: &Trial, key: Option<Key>, registry: &Registry) -> Result<LiveHost, OpenError> {
        LiveHost::open_when_fit(team, trial, key, registry, &mut |_| false)
    }

    /// Opens the host as `open` does, and calls `wait` whenever a link cannot be opened yet, such as one without an
    /// interface: it may wait a moment, and returns whether to try again.
    pub fn open_when_fit(
        team: &Team,
        trial: &Trial,
        key: Option<Key>,
        registry: &Registry,
        wait: &mut dyn FnMut(&LinkError) -> bool,
    ) -> Result<LiveHost, OpenError> {
        let links = links::setups(&team.deployment, team.links.iter().map(Option::as_ref));
        let transports = links::open(team, team.host, wait)?;
        let identity = ProcessIdentity::draw()?;
        let entry = &team.deployment.hosts[usize::from(team.host.0)];
        let (mut devices, mut workers) = devices::open(entry, team.deployment.robots, registry)?;
        devices::open_agents(entry, trial, (&mut devices, &mut workers))?;
        devices::open_senses(entry, trial, (&mut devices, &mut workers))?;
        let end = HostEnd { me: identity.host_of(team), key, seed: identity.seed, links, keep: None, transports };
        Ok(LiveHost { end, devices, workers, trial: trial.clone(), grace: grace(team), seed: identity.bytes })
    }

    /// Returns the settings of the whole team's run. This host runs its own part of it.
    pub fn trial(&self) -> &Trial {
        &self.trial
    }

    /// Returns what a replay needs of this process: its incarnation, the 32 bytes of its link layer's random seed, and
    /// the number of transports of each link.
    pub fn process(&self) -> (u32, [u8; 32], Vec<usize>) {
        let transports = |link: usize| self.end.transports.iter().filter(|(id, _)| usize::from(id.0) == link).count();
        (self.end.me.incarnation, self.seed, (0..self.end.links.len()).map(transports).collect())
    }

    /// Runs the host on this thread, and returns its actors at the end. Its time counts from `origin`. `heard` is
    /// called with each event of the host, such as a message; `said` with each result of the Recorder, which runs only
    /// on the host that judges episodes. `begun` is called once, after the actors have started, with the event loop's
    /// file descriptors and the time. `done` is called after every turn of the event loop; the run ends when it returns
    /// `true`.
    pub fn run(
        self,
        origin: Instant,
        heard: impl Fn(HostId, Event) + 'static,
        said: impl FnMut(Out) + 'static,
        begun: impl FnOnce(&mut Readers, Time),
        done: impl FnMut(&Rc<Graph>, Time) -> bool,
    ) -> Rc<Graph> {
        let LiveHost { end, mut devices, workers, trial, .. } = self;
        let observer = Rc::new(RefCell::new(devices.observer.take()));
        let observing = Rc::clone(&observer);
        let heard = move |host: HostId, event: Event| {
            if let (Some(observer), Event::Message(message)) = (&*observing.borrow(), event) {
                observer.receive(Time::ZERO + Span::from_secs(origin.elapsed().as_secs_f64()), message);
            }
            heard(host, event);
        };
        let graph = run_real(
            origin,
            |clock, readers| {
                let graph = host::wire((clock, readers), trial, (end, devices), heard, said);
                begun(readers, clock.now());
                graph
            },
            done,
        );
        // The graph, which goes on, holds what is called for each event: the observer's worker would never end.
        drop(observer.take());
        workers.join();
        graph
    }

    /// Runs the host on this thread until its team has finished all episodes. The report has episodes only on the host
    /// that judges them; its counters are those of this host alone.
    pub fn run_to_the_end(self) -> TrialReport {
        let (report, news) = (Rc::new(RefCell::new(TrialReport::default())), Rc::new(Cell::new(false)));
        let (told, grace) = (Rc::clone(&news), self.grace);
        let heard = move |_: HostId, heard: Event| match heard {
            Event::Message(Wire::Mode(mode)) if mode.phase == Phase::EpisodesFinished => told.set(true),
            _ => {}
        };
        let noted = Rc::clone(&report);
        let said = move |told| noted.borrow_mut().note(told);
        let mut over: Option<Time> = None;
        let graph = self.run(
            Instant::now(),
            heard,
            said,
            |_, _| {},
            |_, now| {
                if news.get() {
                    over.get_or_insert(now);
                }
                over.is_some_and(|at| now.since(at) >= grace)
            },
        );
        let mut report = report.borrow().clone();
        report.simulated = report.totals.end.since(Time::ZERO);
        (report.refused, report.lost) = graph.undelivered();
        report
    }
}
