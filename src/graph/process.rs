//! The part of a deployment that runs in one process, and the mailboxes of all actors. The module `graph` starts the
//! actors and connects them.

use std::cell::{Cell, OnceCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use crate::actors::{agent, body, cache, controller, localizer, network, recorder, state_server, status, world};
use crate::deploy::{Deployment, Link, Routes};
use crate::faults::{ActorFault, ManualLinkFault, Role};
use crate::graph::Plan;
use crate::graph::devices::Devices;
use crate::graph::inputs::{DeviceId, Input};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::local::Truth;
use crate::messages::wire::{Hardware, Kind, Stop, Wire};
use crate::net::protocol::codec::Frame;
use crate::net::protocol::key::Key;
use crate::net::protocol::limits::LOSS_TO_REPEAT;
use crate::net::protocol::link::{DuplicateId, LinkCounts, Refusal};
use crate::net::protocol::reliability::{Heartbeats, Setup};
use crate::net::protocol::sender::Peer;
use crate::net::transport::{self, Renewed};
use crate::random::Seed;
use crate::report::episode::AbortReason;
use crate::runtime::clock::Clock;
use crate::runtime::shell::Mailbox;
use crate::safety::guard::SafetyCounts;

/// Probability of loss of an emulated link from which on heartbeats are sent twice: that of `LOSS_TO_REPEAT`.
const MIN_LOSS: f64 = LOSS_TO_REPEAT as f64 / 64.0;
/// Team number of runs in one process, where no other team can interfere.
const TEAM: u16 = 0;

/// Part of a deployment that runs in this process: one host or all, with their identity on the links and their devices.
#[derive(Clone)]
pub(crate) struct Process {
    /// The one host that runs in this process; `None` if all hosts do.
    pub(crate) only: Option<HostId>,
    /// Number of the team, which keeps teams on the same network apart.
    pub(crate) team: u16,
    /// Incarnation: random number that distinguishes successive processes of the same host.
    pub(crate) incarnation: u32,
    /// Secret seed from which the random numbers of the link layer are drawn; `None` to use the seed of the run.
    pub(crate) secret: Option<Seed>,
    /// Key that authenticates the team's datagrams; `None` if they are not authenticated.
    pub(crate) key: Option<Key>,
    /// Setup of each link, `None` for a link in which the host does not take part. The whole list is `None` if links
    /// are emulated.
    pub(crate) links: Option<Vec<Option<Setup>>>,
    /// Drivers and source of readings of real robots; empty if all robots are simulated.
    pub(crate) devices: Devices,
    /// Whether the Recorder, the actor that collects results, runs in this process.
    pub(crate) records: bool,
    /// Function that is called with each event of this process, such as a received message.
    pub(crate) report: Report,
}

/// Function that is called with each event of a process, and with the host at which the event happened.
pub type Report = Rc<dyn Fn(HostId, ProcessEvent)>;

/// Event in a process, reported to the code that started it.
#[derive(Clone, Copy, Debug)]
pub enum ProcessEvent<'a> {
    /// An actor of this process has published a message: the datagram, without its authentication tag.
    Published(&'a Frame),
    /// A datagram is sent on a link, with its authentication tag if the team has a key.
    Sent(LinkId, &'a Frame),
    /// A datagram arrives over an emulated link.
    Arrived(LinkId, &'a Frame),
    /// Input from outside the actors, such as a datagram. Does not occur if all hosts run in one process with emulated
    /// links.
    Input(&'a Input),
    /// A datagram that had arrived was refused for this cause, without any effect but its count.
    Refused(LinkId, Refusal, &'a Frame),
    /// True states of simulated robots after a step of their World.
    Truth(&'a Truth),
    /// Output of the Recorder: the result of an episode, a step, or the end of the run.
    Recorded(&'a recorder::Out),
    /// Message that was delivered to actors of this process.
    Message(&'a Wire),
    /// State of the other hosts on links with link reports, such as delay and loss.
    Peers(&'a [Peer]),
    /// Numbers of datagrams sent, received and refused on the links of a host since its Network was started.
    Counts(&'a LinkCounts),
    /// Another running host uses the id of this host and was started earlier.
    Duplicate(DuplicateId),
    /// The state server of this process has aborted the episode with this index, from 0, for this reason.
    Aborted(u32, AbortReason),
    /// Numbers of times that a robot's guard has stopped or slowed it since the robot's Controller was started.
    Safety(RobotId, SafetyCounts),
    /// Condition of the hardware of a real robot, as its driver reports it.
    Hardware(RobotId, &'a Hardware),
    /// The sockets of a link were closed or opened again, because a network interface or its address has changed.
    Link(LinkId, &'a Renewed),
}

impl Process {
    /// Returns the process that runs every host of a deployment, with emulated links and simulated robots.
    pub(super) fn all_hosts(report: Report) -> Process {
        Process {
            only: None,
            team: TEAM,
            incarnation: 0,
            secret: None,
            key: None,
            links: None,
            devices: Devices::default(),
            records: true,
            report,
        }
    }

    /// Returns the setup of each link for a host, in the order of the deployment; `None` for a link on which the host
    /// neither sends nor receives.
    pub(super) fn setups(&self, deployment: &Deployment, routes: &Routes, host: HostId) -> Vec<Option<Setup>> {
        let emulated = |link: &Link| {
            let partakes = link.carries.iter().any(|kind| routes.exchanges(host, *kind));
            // A link of robots sends heartbeats twice while it loses 3 % or more, which this link is known to do.
            let lossy = link.loss >= MIN_LOSS && link.impairs.contains(&Kind::Heartbeat);
            let heartbeats = if lossy { Heartbeats::Twice } else { Heartbeats::Once };
            partakes.then(|| Setup { heartbeats, ..Setup::emulated(link.reliability.clone()) })
        };
        self.links.clone().unwrap_or_else(|| deployment.links.iter().map(emulated).collect())
    }
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
    /// Mailboxes of the transports or emulated links, indexed by link.
    pub(super) transports: Rc<[Mailbox<transport::In>]>,
    /// Mailbox of the Recorder; `None` in a process without a Recorder.
    pub(super) recorder: Option<Mailbox<recorder::In>>,
    /// Notice of the start of each episode, for faults that are timed from it.
    pub(super) episodes: EpisodeNotice,
    /// Function that is called with each event of this process.
    pub(super) report: Report,
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
    /// Makes the mailboxes of all actors of a deployment (`plan.deployment`), those of other processes included, before
    /// any actor is started. `process` says which hosts run here, and whether they have a Recorder.
    pub(super) fn new(plan: &Plan, process: &Process) -> Graph {
        let deployment = &plan.deployment;
        let routes = Routes::of(deployment);
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
        let links = deployment.links.iter().map(|link| format!("transport of {}", link.name));
        Graph {
            clock: OnceCell::new(),
            caches: team().map(named("cache")).map(Mailbox::new).collect(),
            agents,
            controllers: team().map(named("controller")).map(Mailbox::new).collect(),
            bodies: team().map(named("body")).map(Mailbox::new).collect(),
            sensors: team().map(named("localizer")).map(Mailbox::new).collect(),
            source: Mailbox::new("localizer"),
            worlds,
            server: Mailbox::new("state server"),
            statuses: deployment.hosts.iter().map(|host| Mailbox::new(format!("status of {}", host.name))).collect(),
            networks: deployment.hosts.iter().map(|host| Mailbox::new(format!("network of {}", host.name))).collect(),
            transports: links.map(Mailbox::new).collect(),
            recorder: process.records.then(|| Mailbox::new("recorder")),
            episodes: EpisodeNotice::default(),
            report: Rc::clone(&process.report),
            routes,
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

    /// Returns a function that sends its argument to the Recorder, or does nothing in a process without a Recorder.
    pub(super) fn record(&self) -> impl Fn(recorder::In) + use<> {
        let recorder = self.recorder.clone();
        move |input| {
            if let Some(recorder) = &recorder {
                recorder.send(input);
            }
        }
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
            .chain(of(&self.worlds))
            .chain(of(&self.statuses))
            .chain(of(&self.networks))
            .chain(of(&self.transports))
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

    /// Injects a fault into an actor of this process now, for `fault.lasts`; the start in `fault` is ignored.
    pub fn inject(&self, fault: ActorFault) {
        self.change_fault(fault.role, fault.robot, Some(&fault));
    }

    /// Ends all injected faults of an actor of this process, given by its role and robot; a crashed actor restarts.
    pub fn recover(&self, role: Role, robot: RobotId) {
        self.change_fault(role, robot, None);
    }

    /// Sets a fault on an emulated link during the run, in addition to planned ones. It replaces the fault of the link
    /// that an earlier call has set.
    pub fn impair(&self, link: LinkId, fault: ManualLinkFault) {
        self.transports[usize::from(link.0)].send(transport::In::Manual(fault));
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
        (self.report)(host, ProcessEvent::Input(&input));
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
            Input::Ended(DeviceId::Driver(robot)) => self.bodies[robot.index()].send(body::In::WorkerEnded),
            Input::Ended(DeviceId::Source) => {
                tracing::error!("the source of this host has ended: no more readings; restart the host");
            }
            Input::Leave => self.send_leave(host),
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
