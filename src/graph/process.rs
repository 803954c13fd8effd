//! The part of a deployment that runs in one process, and the mailboxes of all actors. The module `graph` starts the
//! actors and connects them.

use std::cell::{Cell, OnceCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use super::airborne::Airborne;

use crate::actors::{
    agent, body, cache, controller, localizer, network, recorder, senses, state_server, status, world,
};
use crate::deploy::{Link, Routes, Stepping};
use crate::faults::{ActorFault, ManualLinkFault, Role};
use crate::graph::devices::Devices;
use crate::graph::end::HostEnd;
use crate::graph::event::{Event, Events, Report};
use crate::graph::inputs::{DeviceId, Input};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::wire::{Kind, Marks, Stop, Wire};
use crate::net::media::ether;
use crate::net::protocol::limits::LOSS_TO_REPEAT;
use crate::net::protocol::link::Identity;
use crate::net::protocol::reliability::{Heartbeats, Setup};
use crate::net::transport;
use crate::runtime::clock::Clock;
use crate::runtime::shell::Mailbox;
use crate::trial::Trial;

/// Probability of loss of an emulated link from which on heartbeats are sent twice: that of `LOSS_TO_REPEAT`.
const MIN_LOSS: f64 = LOSS_TO_REPEAT as f64 / 64.0;
/// Team number of runs in one process, where no other team can interfere.
const TEAM: u16 = 0;

/// Part of a trial that runs in this process: one host, or all hosts over emulated links.
pub(crate) struct Process {
    /// Ends of the hosts that run in this process, by id.
    pub(crate) ends: BTreeMap<HostId, HostEnd>,
    /// Whether this process runs all hosts, over emulated links.
    pub(crate) emulated: bool,
    /// Drivers and source of readings of real robots; empty if all robots are simulated.
    pub(crate) devices: Devices,
    /// Function that is called with each event of this process, such as a received message.
    pub(crate) report: Report,
}

impl Process {
    /// Returns the process that runs every host of a trial, with emulated links and simulated robots.
    pub(super) fn all_hosts(trial: &Trial, routes: &Routes, report: Report) -> Process {
        let (deployment, seed) = (&trial.deployment, trial.streams());
        let end = |host: HostId| HostEnd {
            me: Identity { host, team: TEAM, incarnation: 0 },
            key: None,
            seed,
            keep: None,
            links: deployment.links.iter().map(|link| emulated(link, deployment.stepping, routes, host)).collect(),
            transports: Vec::new(),
        };
        let hosts = (0..=u16::MAX).map(HostId).take(deployment.hosts.len());
        let ends = hosts.map(|host| (host, end(host))).collect();
        Process { ends, emulated: true, devices: Devices::default(), report }
    }

    /// Returns whether this process runs the host.
    pub(super) fn runs(&self, host: HostId) -> bool {
        self.ends.contains_key(&host)
    }
}

/// Returns the setup of an emulated link for a host; `None` if the host neither sends nor receives on it.
fn emulated(link: &Link, stepping: Stepping, routes: &Routes, host: HostId) -> Option<Setup> {
    // A link of robots sends heartbeats twice while it loses 3 % or more, which this link is known to do.
    let lossy = link.loss >= MIN_LOSS && link.impairs.contains(&Kind::Heartbeat);
    let heartbeats = if lossy { Heartbeats::Twice } else { Heartbeats::Once };
    let partakes = link.carries.iter().any(|kind| routes.exchanges(host, *kind));
    let (reliability, mesh) = (link.reliability.clone(), link.mesh);
    partakes.then(|| match link.auto {
        false => Setup { heartbeats, mesh, ..Setup::emulated(reliability) },
        // The one process of all hosts is as fast as it likes.
        true => Setup { rate: None, mesh, spread: link.spreads(stepping), ..Setup::choosing(reliability) },
    })
}

/// Actors of a run, held by their mailboxes, through which messages and faults reach them.
pub struct Graph {
    /// Hosts of all actors, and the routes of all messages.
    pub(super) routes: Routes,
    /// Clock of the actors, in the process of one host.
    pub(super) clock: OnceCell<Clock>,
    /// Mailboxes of Caches, indexed by robot.
    pub(super) caches: Rc<[Mailbox<cache::In>]>,
    /// Mailboxes of Agents, indexed by robot; the robots of one Agent share a mailbox.
    pub(super) agents: Vec<Mailbox<agent::In>>,
    /// Mailboxes of Controllers, indexed by robot.
    pub(super) controllers: Rc<[Mailbox<controller::In>]>,
    /// Mailboxes of Bodies, indexed by robot.
    pub(super) bodies: Rc<[Mailbox<body::In>]>,
    /// Mailboxes of the Localizers of simulated robots, indexed by robot.
    pub(super) sensors: Rc<[Mailbox<localizer::In>]>,
    /// Mailboxes of the Senses, indexed by robot; empty in a team without senses.
    pub(super) senses: Rc<[Mailbox<senses::In>]>,
    /// Mailbox of the Localizer that runs this process's source of readings of real robots; without such a source no
    /// actor takes its messages.
    pub(super) source: Mailbox<localizer::In>,
    /// Mailboxes of Worlds, indexed by robot; the robots of one World share a mailbox.
    pub(super) worlds: Vec<Mailbox<world::In>>,
    /// Mailbox of the state server.
    pub(super) server: Mailbox<state_server::In>,
    /// Mailboxes of the Status actors, indexed by host.
    pub(super) statuses: Rc<[Mailbox<status::In>]>,
    /// Mailboxes of Networks, indexed by host.
    pub(super) networks: Rc<[Mailbox<network::In>]>,
    /// Mailboxes of the links' transports, indexed by link; without actors where links are emulated.
    pub(super) transports: Rc<[Mailbox<transport::In>]>,
    /// Mailboxes of the emulated media, indexed by link; without actors where links are real.
    pub(super) media: Rc<[Mailbox<ether::In>]>,
    /// Mailbox of the Recorder; `None` in a process without a Recorder.
    pub(super) recorder: Option<Mailbox<recorder::In>>,
    /// Robots of this process that are in the air.
    pub(super) airborne: Airborne,
    /// Notice of the start of each episode, for faults that are timed from it.
    pub(super) episodes: EpisodeNotice,
    /// Sink of all events of this process.
    pub(super) events: Rc<Events>,
    /// Whether members sign what others may pass on, and operators what ends a stop or a hold.
    pub(super) signed: bool,
    /// Marks of this process, which heartbeats have; 0 in a simulation, where all robots have the same policy and task.
    pub(super) marks: Marks,
}

/// Function that is called with the number of an episode when it begins.
type EpisodeListener = Box<dyn Fn(u32)>;

/// Calls a function that was set before with the number of each episode that begins. Clones share it.
#[derive(Clone, Default)]
pub(super) struct EpisodeNotice {
    listener: Rc<OnceCell<EpisodeListener>>,
    newest: Rc<Cell<Option<u32>>>,
}

impl EpisodeNotice {
    /// Tells that the episode with this number runs; the function that `listen` has set is called at the first call for
    /// each episode.
    pub(super) fn runs(&self, episode: u32) {
        if self.newest.get() < Some(episode) {
            self.newest.set(Some(episode));
            self.listener.get().into_iter().for_each(|listener| listener(episode));
        }
    }

    /// Sets the function to call with the number of each episode that begins. Panics if one was set before.
    pub(super) fn listen(&self, listener: impl Fn(u32) + 'static) {
        assert!(self.listener.set(Box::new(listener)).is_ok(), "a plan is scheduled once");
    }
}

impl Graph {
    /// Makes the mailboxes of all actors of a trial, those of other processes included, before any actor is started.
    /// `routes` are those of its deployment; `process` has the hosts that run here. There is a Recorder where the host
    /// runs that judges episodes.
    pub(super) fn new(trial: &Trial, routes: Routes, process: &Process) -> Graph {
        let deployment = &trial.deployment;
        let team = || RobotId::team(deployment.robots);
        let named = |what: &'static str| move |robot: RobotId| format!("{what} of {robot}");
        let mut agents: Vec<Mailbox<agent::In>> = Vec::new();
        let mut worlds: Vec<Mailbox<world::In>> = Vec::new();
        let mut by_host: BTreeMap<Result<HostId, RobotId>, Mailbox<world::In>> = BTreeMap::new();
        for robot in team() {
            let agent = agents.get(routes.agent_robots(robot)[0].index());
            agents.push(agent.cloned().unwrap_or_else(|| Mailbox::new(named("agent")(robot))));
            // A real robot gets a mailbox without an actor.
            let host = routes.world_host(robot).ok_or(robot);
            let world = by_host.entry(host).or_insert_with(|| Mailbox::new(named("world")(robot)));
            worlds.push(world.clone());
        }
        let links = |what: &'static str| deployment.links.iter().map(move |link| format!("{what} of {}", link.name));
        let recorder = process.runs(deployment.judge()).then(|| Mailbox::new("recorder"));
        Graph {
            clock: OnceCell::new(),
            caches: team().map(named("cache")).map(Mailbox::new).collect(),
            agents,
            controllers: team().map(named("controller")).map(Mailbox::new).collect(),
            bodies: team().map(named("body")).map(Mailbox::new).collect(),
            sensors: team().map(named("localizer")).map(Mailbox::new).collect(),
            senses: team()
                .filter(|_| !deployment.sense_names().is_empty())
                .map(named("senses"))
                .map(Mailbox::new)
                .collect(),
            source: Mailbox::new("localizer"),
            worlds,
            server: Mailbox::new("state server"),
            statuses: deployment.hosts.iter().map(|host| Mailbox::new(format!("status of {}", host.name))).collect(),
            networks: deployment.hosts.iter().map(|host| Mailbox::new(format!("network of {}", host.name))).collect(),
            transports: links("transport").map(Mailbox::new).collect(),
            media: links("medium").map(Mailbox::new).collect(),
            events: Rc::new(Events::new(trial, process.emulated, (&process.report, recorder.as_ref()))),
            recorder,
            airborne: Airborne::default(),
            episodes: EpisodeNotice::default(),
            routes,
            marks: if process.emulated { Marks::default() } else { trial.marks() },
            signed: process.ends.values().any(|end| end.key.as_ref().is_some_and(|key| key.signatures().is_some())),
        }
    }

    /// Returns the mailbox of the Network of a host.
    pub(super) fn network_of(&self, host: HostId) -> Mailbox<network::In> {
        self.networks[usize::from(host.0)].clone()
    }

    /// Returns the mailbox of the Status of a host.
    pub(super) fn status_of(&self, host: HostId) -> Mailbox<status::In> {
        self.statuses[usize::from(host.0)].clone()
    }

    /// Returns two numbers of messages between actors since the start of the run: those refused because a mailbox was
    /// full, and those lost when an actor crashed.
    pub fn undelivered(&self) -> (u64, u64) {
        fn of<I>(mailboxes: &[Mailbox<I>]) -> impl Iterator<Item = (&str, (u64, u64))> {
            mailboxes.iter().map(|mailbox| (mailbox.name(), (mailbox.refused(), mailbox.lost())))
        }
        // Counted by name, because some robots share an Agent or a World.
        let counts: BTreeMap<&str, (u64, u64)> = of(&self.caches)
            .chain(of(&self.agents))
            .chain(of(&self.controllers))
            .chain(of(&self.bodies))
            .chain(of(&self.sensors))
            .chain(of(&self.senses))
            .chain(of(&self.worlds))
            .chain(of(&self.statuses))
            .chain(of(&self.networks))
            .chain(of(&self.transports))
            .chain(of(&self.media))
            .chain(of(std::slice::from_ref(&self.source)))
            .chain(of(std::slice::from_ref(&self.server)))
            .chain(of(self.recorder.as_slice()))
            .collect();
        counts.values().fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
    }

    /// Engages the team's emergency stop through the host `by` of this process.
    pub fn stop(&self, by: HostId) {
        self.take(by, Input::Stop);
    }

    /// Shuts down a host of this process: its robots stop, and then it tells the team that it leaves.
    pub fn leave(&self, host: HostId) {
        self.take(host, Input::Leave);
    }

    /// Puts the roster with this number in force on a host of this process: it is on disk.
    pub fn roster_kept(&self, host: HostId, number: u32) {
        self.take(host, Input::Kept(number));
    }

    /// Injects a fault into an actor of this process now, for `fault.lasts`; the start in `fault` is ignored.
    pub fn inject(&self, fault: ActorFault) {
        self.change_fault(fault.role, fault.robot, Some(&fault));
    }

    /// Sets the charge of a simulated robot that flies \[%\].
    pub(super) fn charge(&self, robot: RobotId, percent: u8) {
        self.bodies[robot.index()].send(body::In::Packet([percent].into()));
    }

    /// Whether a robot that this process drives is in the air, so that the process has to wait for its landing.
    pub fn is_airborne(&self) -> bool {
        self.airborne.any()
    }

    /// Ends all injected faults of an actor of this process, given by its role and robot; a crashed actor restarts.
    pub fn recover(&self, role: Role, robot: RobotId) {
        self.change_fault(role, robot, None);
    }

    /// Sets a fault on an emulated link during the run, in addition to planned ones. It replaces the fault of the link
    /// that an earlier call has set.
    pub fn impair(&self, link: LinkId, fault: ManualLinkFault) {
        self.media[usize::from(link.0)].send(ether::In::Manual(fault));
    }

    /// Sends an emergency stop message (stop, re-arm or resume) to the team through the host `through` of this process.
    pub fn publish_stop(&self, through: HostId, stop: Stop) {
        self.networks[usize::from(through.0)].send(network::In::Publish(Wire::Stop(stop)));
    }

    fn change_fault(&self, role: Role, robot: RobotId, fault: Option<&ActorFault>) {
        fn change<I>(mailbox: &Mailbox<I>, fault: Option<&ActorFault>) {
            match fault {
                Some(fault) => mailbox.inject(fault.clone()),
                None => mailbox.recover(),
            }
        }
        let at = robot.index();
        match role {
            Role::Cache => change(&self.caches[at], fault),
            Role::Agent => change(&self.agents[at], fault),
            Role::Controller => change(&self.controllers[at], fault),
            // The body fault of a robot covers its measurement and its motors.
            Role::Body => {
                change(&self.sensors[at], fault);
                self.senses.get(at).into_iter().for_each(|senses| change(senses, fault));
                change(&self.bodies[at], fault);
            }
            Role::World => change(&self.worlds[at], fault),
            Role::StateServer => change(&self.server, fault),
            Role::Network => change(&self.network_of(self.routes.agent_host(robot)), fault),
        }
    }
}

impl Graph {
    /// Returns how many things the actors have done so far: messages that they handled, and wake-ups. 0 if several
    /// hosts are in one process.
    pub fn steps(&self) -> u64 {
        self.clock.get().map_or(0, Clock::steps)
    }

    /// Passes an input from outside the actors, such as a datagram, to the actors of `host`, a host of this process.
    /// The input is reported as an event first.
    pub(crate) fn take(&self, host: HostId, input: Input) {
        self.events.emit(host, Event::Input(&input));
        match input {
            Input::Frame(link, frame, from) => {
                self.networks[usize::from(host.0)].send(network::In::Frame(link, frame, from));
            }
            Input::Dropped(link, count) => {
                self.networks[usize::from(host.0)].send(network::In::Dropped(link, count));
            }
            Input::Refused(link, cause, count) => {
                self.networks[usize::from(host.0)].send(network::In::Refused(link, cause, count));
            }
            Input::Packet(DeviceId::Driver(robot), packet) => {
                self.bodies[robot.index()].send(body::In::Packet(packet));
            }
            Input::Packet(DeviceId::Source, packet) => self.source.send(localizer::In::Packet(packet)),
            Input::Packet(DeviceId::Agent(robot), packet) => {
                if let Some(agent) = self.agents.get(robot.index()) {
                    agent.send(agent::In::Answer(packet));
                }
            }
            Input::Ended(DeviceId::Agent(robot)) => {
                tracing::error!("the worker that computes the policy of {robot} has ended; its robots stand");
                if let Some(agent) = self.agents.get(robot.index()) {
                    agent.send(agent::In::Ended);
                }
            }
            Input::Packet(DeviceId::Sense(robot, sense), packet) => {
                if let Some(senses) = self.senses.get(robot.index()) {
                    senses.send(senses::In::Packet(sense, packet));
                }
            }
            // Its values get old by themselves.
            Input::Ended(DeviceId::Sense(robot, _)) => {
                tracing::error!("a sense of {robot} has ended, and is started again: it perceives nothing meanwhile");
            }
            Input::Ended(DeviceId::Driver(robot)) => self.bodies[robot.index()].send(body::In::WorkerEnded),
            Input::Ended(DeviceId::Source) => {
                tracing::error!("the source of this host has ended, and is started again: no readings meanwhile");
            }
            Input::Leave => self.send_leave(host),
            Input::Kept(number) => self.networks[usize::from(host.0)].send(network::In::Kept(number)),
            Input::Stop => {
                let stop = Stop::engage(host, Latch::default());
                self.networks[usize::from(host.0)].send(network::In::Publish(Wire::Stop(stop)));
            }
        }
    }

    fn send_leave(&self, host: HostId) {
        for robot in RobotId::team(self.bodies.len()) {
            if self.routes.actuator_host(robot) == host {
                self.bodies[robot.index()].send(body::In::Leave);
            }
            if self.routes.agent_host(robot) == host {
                self.controllers[robot.index()].send(controller::In::Leave);
            }
        }
        if self.routes.server_host() == host {
            self.server.send(state_server::In::Leave);
        }
        self.statuses[usize::from(host.0)].send(status::In::Leave);
    }
}
