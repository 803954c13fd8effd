//! Runs a simulation at the pace of real time with a live page. If the page gives no command, the report equals that of
//! the same trial without a page.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Result;

use super::feed::Feed;
use super::{OPERATOR, OptionalPage};
use crate::recording::{Recorded, Simulated};
use murmurate::actors::order::OrderKind;
use murmurate::actors::recorder;
use murmurate::deploy::Routes;
use murmurate::faults::{ActorFault, ActorFaultKind, ManualLinkFault, Role};
use murmurate::graph::event::Event;
use murmurate::graph::process::Graph;
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::wire::{Kind, Phase, Wire};
use murmurate::net::protocol::codec::{self, Content, Frame};
use murmurate::report::TrialReport;
use murmurate::results::episode::Episode;
use murmurate::simulate::Proceed;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate_robot::bad;
use murmurate_view::access::Control;
use murmurate_view::command::Command;
use murmurate_view::metrics::Metrics;
use murmurate_view::orders::Orders;
use murmurate_view::scans::ScanForm;
use murmurate_view::server::Publisher;
use murmurate_view::status::{Ending, LinkImpairment, PageStatus, Scene};
use murmurate_view::team_view::TeamView;

/// Flags of `sim` for its live page: those of the page, and the speed of the simulation.
#[derive(clap::Args)]
pub struct PacedPage {
    #[command(flatten)]
    page: OptionalPage,
    /// Simulated seconds a second, with --watch; a large team may reach less
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
}

impl PacedPage {
    /// Returns true if the page was requested by `--watch`.
    pub fn is_on(&self) -> bool {
        self.page.watch
    }

    /// Fails if the flags of the page are wrong, or do not fit a simulation of this many policies and repeats. An error
    /// names the flag; `repeats` is the value of `--repeats`, if given.
    pub fn check(&self, policies: usize, repeats: Option<u32>) -> Result<()> {
        self.page.check()?;
        match self.speed {
            speed if !(0.01..=1000.0).contains(&speed) => bad(format!("--speed: {speed} is not 0.01 to 1000")),
            _ if !self.is_on() => Ok(()),
            _ if policies > 1 => bad("--watch: the page is of one policy; name one".to_owned()),
            _ if repeats.is_some_and(|repeats| repeats > 1) => {
                bad("--watch: the page is of one trial; leave out --repeats".to_owned())
            }
            _ => Ok(()),
        }
    }
}

/// Longest time that the simulation waits, to keep pace with real time, before it updates the page again.
const TURN: Duration = Duration::from_millis(10);
/// Delay of the simulation behind real time beyond which it no longer catches up, but goes on from there.
const BEHIND: Duration = Duration::from_millis(250);
/// Interval of real time over which the speed of the simulation is measured.
const MEASURED: Duration = Duration::from_secs(1);
/// Duration of the crash that a page orders: practically unlimited, until the page restarts the actor.
const FOR_GOOD: Span = Span::from_millis(1 << 40);

/// Runs a trial with a live page, at the speed that the flags give, until its end or until `stop` is set, and returns
/// its report. `policy` is the policy's name; the trial is recorded if `records` is given.
pub fn run(
    trial: &Trial,
    policy: &str,
    flags: &PacedPage,
    stop: &AtomicBool,
    records: Option<&Simulated>,
) -> Result<TrialReport> {
    let routes = Routes::of(&trial.deployment);
    let robots = trial.scenario.robots();
    let homes = RobotId::team(robots).map(|robot| routes.agent_host(robot)).collect();
    let scene = scene(trial, policy);
    let (server, publisher) = flags.page.page.open(scene.clone(), Control::Emulation)?;
    let names: Vec<String> = trial.deployment.hosts.iter().map(|host| host.name.clone()).collect();
    let view = TeamView::new(scene, homes, names.len()).on_mesh(names.clone(), routes.server_host());
    let view = Rc::new(RefCell::new(view));
    let metrics = Rc::new(RefCell::new(Metrics::new(names)));
    let mut last = Time::ZERO;
    let mut desk = Desk {
        trial,
        leader: routes.server_host(),
        publisher,
        feed: Feed::new(Rc::clone(&view), Some(Rc::clone(&metrics))),
        view: Rc::clone(&view),
        orders: Rc::new(RefCell::new(Orders::new(OPERATOR, robots))),
        pause: Pause::No,
        finished: 0,
        killed: BTreeSet::new(),
        impaired: BTreeMap::new(),
        pace: Pace::new(flags.speed),
    };
    let orders = Rc::clone(&desk.orders);
    let observe = move |now: Time, host: HostId, event: Event| {
        metrics.borrow_mut().take(host, event);
        update(&mut view.borrow_mut(), &mut orders.borrow_mut(), now, host, event);
    };
    let turn = |graph: &Graph, now: Time, episodes: &[Episode]| {
        last = now;
        desk.turn(graph, now, episodes, stop)
    };
    let report = match records {
        Some(records) => records.run_observed((&Recorded::repeat(trial), trial), observe, turn),
        None => trial.run_observed(observe, turn),
    };
    desk.feed.at_once();
    desk.publish(last, true);
    server.close();
    Ok(report)
}

/// Returns what the page shows of a trial at first: ground, walls, number of robots, links and settings.
fn scene(trial: &Trial, policy: &str) -> Scene {
    let range_m = trial.farthest_m();
    Scene {
        scenario: trial.scenario.name().to_owned(),
        mode: trial.deployment.mode.clone(),
        policy: policy.to_owned(),
        robots: trial.scenario.robots(),
        episodes: trial.layouts.len(),
        hull_m: trial.physics.wall_radius_m,
        range_m: Some(range_m).filter(|range_m| range_m.is_finite()),
        links: trial.deployment.links.iter().map(|link| link.name.clone()).collect(),
        scans: {
            let senses = trial.sense_layouts();
            senses.iter().enumerate().filter_map(|(at, (_, layout))| ScanForm::of(at, layout)).collect()
        },
        hears_links: true,
        hears_results: true,
        drawn: trial.layouts.drawn_blocks(),
        movers: trial.layouts.movers(trial.scenario.arena()),
        waypoints: trial.layouts.waypoints(),
        unlabelled: trial.scenario.goals().are_unlabelled(),
        ..Scene::of_arena(trial.scenario.arena())
    }
}

/// Updates the page's view of the team, and the state of running orders, from an event of the trial.
fn update(view: &mut TeamView, orders: &mut Orders, now: Time, host: HostId, event: Event) {
    match event {
        Event::Published(frame) => {
            let Some(message) = wanted(frame) else { return };
            if let Wire::Status(status) = &message {
                orders.receive(now, status);
            }
            view.receive(now, &message);
        }
        Event::Message(Wire::Latent(latent)) => view.arrived(now, host, latent.robot),
        Event::Truth(truth) => view.see(truth),
        Event::Recorded(recorder::Out::Episode(episode, _)) => view.judged(now, episode),
        Event::Safety(robot, counts) => view.guarded(now, robot, counts),
        Event::Peers(..) => view.take_event(now, host, event),
        Event::Hardware(robot, hardware) => {
            hardware.battery.into_iter().for_each(|percent| view.charged(robot, percent));
        }
        _ => {}
    }
}

/// Decodes a published datagram; `None` if its message is of a kind that the page does not show.
fn wanted(frame: &Frame) -> Option<Wire> {
    let kinds = [Kind::Latent, Kind::Heartbeat, Kind::Mode, Kind::Status, Kind::Sensed, Kind::Aloft];
    match codec::first(frame).ok()? {
        Content::Message(kind) if kinds.contains(&kind) => codec::decode(frame).ok().map(|(_, message)| message),
        _ => None,
    }
}

/// State of a pause, which the page requests and which begins after the current episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pause {
    No,
    Asked,
    /// Paused: virtual time does not advance.
    Yes,
}

/// Keeps the virtual time of a simulation at a given pace relative to real time.
struct Pace {
    speed: f64,
    origin: (Instant, Time),
    measured: (Instant, Time),
    /// Speed of the simulation as last measured: simulated seconds per second of real time.
    reached: f64,
}

impl Pace {
    fn new(speed: f64) -> Pace {
        let origin = (Instant::now(), Time::ZERO);
        Pace { speed, origin, measured: origin, reached: speed }
    }

    /// Returns how long to wait in real time until the virtual time `now` is due; zero if it is due already.
    fn ahead(&mut self, now: Time) -> Duration {
        let present = Instant::now();
        let (origin, from) = self.origin;
        let due = origin + Duration::from_secs_f64(now.since(from).as_secs() / self.speed);
        if present.saturating_duration_since(due) > BEHIND {
            self.origin = (present, now);
        }
        let since = present - self.measured.0;
        if since >= MEASURED {
            self.reached = now.since(self.measured.1).as_secs() / since.as_secs_f64();
            self.measured = (present, now);
        }
        due.saturating_duration_since(present)
    }
}

/// Does the work between two instants of a trial: executes commands of the page, sends orders, updates the page, and
/// waits for real time.
struct Desk<'a> {
    trial: &'a Trial,
    /// Host of the state server, through which orders are sent.
    leader: HostId,
    publisher: Publisher,
    feed: Feed,
    view: Rc<RefCell<TeamView>>,
    orders: Rc<RefCell<Orders>>,
    pause: Pause,
    /// Number of episodes with a result so far.
    finished: usize,
    killed: BTreeSet<String>,
    impaired: BTreeMap<String, LinkImpairment>,
    pace: Pace,
}

impl Desk<'_> {
    fn turn(&mut self, graph: &Graph, now: Time, episodes: &[Episode], stop: &AtomicBool) -> Proceed {
        let ended = episodes.len() > std::mem::replace(&mut self.finished, episodes.len());
        loop {
            while let Some(command) = self.publisher.command() {
                self.execute(graph, now, command);
            }
            self.take_pause(now, ended);
            let message = self.orders.borrow_mut().turn(now);
            message.into_iter().for_each(|message| graph.publish_stop(self.leader, message));
            if let Some(result) = self.orders.borrow_mut().take_result() {
                self.view.borrow_mut().note(now, &result);
            }
            self.publish(now, false);
            if stop.load(Ordering::Relaxed) {
                return Proceed::Stop;
            }
            let ahead = self.pace.ahead(now);
            if self.pause != Pause::Yes && ahead.is_zero() {
                break;
            }
            let wait = if self.pause == Pause::Yes { TURN } else { ahead.min(TURN) };
            if let Some(command) = self.publisher.wait(wait) {
                self.execute(graph, now, command);
            }
        }
        if self.view.borrow().latch().is_clear() { Proceed::Continue } else { Proceed::Hold }
    }

    /// Starts a requested pause if no episode is running, or one has just ended (`ended`).
    fn take_pause(&mut self, now: Time, ended: bool) {
        let phase = self.view.borrow().phase().map(|(phase, _)| phase);
        let between = !matches!(phase, Some(Phase::Running | Phase::FinishedRunning));
        if self.pause == Pause::Asked && (ended || between) {
            self.pause = Pause::Yes;
            self.view.borrow_mut().note(now, "paused, until it is resumed");
        }
    }

    fn publish(&mut self, now: Time, over: bool) {
        let Desk { killed, impaired, pace, orders, .. } = self;
        let pause = match self.pause {
            Pause::No => "no",
            Pause::Asked => "asked",
            Pause::Yes => "yes",
        };
        let fill = |status: &mut PageStatus| {
            status.speed = Some(pace.reached);
            status.ordering = orders.borrow().is_running();
            status.pause = pause;
            status.killed = killed.iter().cloned().collect();
            status.impaired = impaired.clone();
            status.over = over;
            let text = "The run is over; this is its last picture.".to_owned();
            status.ending = over.then_some(Ending { regular: true, text });
        };
        let own = match (over, orders.borrow().is_running()) {
            (true, _) => "over",
            (_, true) => "ordering",
            _ => pause,
        };
        self.feed.publish(&self.publisher, now, own, fill);
    }

    fn execute(&mut self, graph: &Graph, now: Time, command: Command) {
        let note = |line: &str| self.view.borrow_mut().note(now, line);
        match command {
            Command::Stop => {
                // Robots need time to stop, so a pause ends.
                self.pause = Pause::No;
                note("page: STOP");
                self.order(now, OrderKind::Stop);
            }
            Command::Rearm => self.order(now, OrderKind::Rearm),
            Command::Resume if self.pause != Pause::No => {
                self.pause = Pause::No;
                note("page: goes on");
            }
            Command::Resume => self.order(now, OrderKind::Resume),
            Command::Pause => {
                self.pause = Pause::Asked;
                note("page: pause after this episode");
            }
            Command::Kill { role, robot } => self.kill(graph, now, role, robot),
            Command::Restart { role, robot } => {
                if robot.index() < self.trial.scenario.robots() {
                    graph.recover(role, robot);
                    self.killed.remove(&name(role, robot));
                    note(&format!("page: {} restarts", name(role, robot)));
                }
            }
            // Not reached: these commands are refused before, because no record is played.
            Command::Play { .. } | Command::Seek { .. } | Command::Step { .. } => {}
            Command::Link { link, cut, delay_ms, loss } => {
                let links = &self.trial.deployment.links;
                let Some(at) = links.iter().position(|other| other.name == link) else {
                    return note("page: no link has that name");
                };
                let fault = ManualLinkFault { cut, delay: Span::from_secs(delay_ms / 1e3), loss };
                graph.impair(LinkId(u16::try_from(at).expect("links are counted in u16")), fault);
                let state = if cut { "cut" } else { "not cut" };
                note(&format!("page: link {link} {state}, delay {delay_ms} ms, loss {:.0} %", 100.0 * loss));
                self.impaired.insert(link, LinkImpairment { cut, delay_ms, loss });
            }
        }
    }

    fn order(&self, now: Time, kind: OrderKind) {
        if let Err(why) = self.orders.borrow_mut().give(now, kind) {
            self.view.borrow_mut().note(now, &format!("page: refused, {why}"));
        }
    }

    fn kill(&mut self, graph: &Graph, now: Time, role: Role, robot: RobotId) {
        if robot.index() >= self.trial.scenario.robots() {
            return;
        }
        let (kind, at, lasts, by, episode) = (ActorFaultKind::Crash, now, FOR_GOOD, Span::ZERO, None);
        graph.inject(ActorFault { role, robot, kind, at, lasts, by, episode });
        self.killed.insert(name(role, robot));
        self.view.borrow_mut().note(now, &format!("page: {} is killed", name(role, robot)));
    }
}

/// Returns the name of an actor for lines on the page: its role and robot.
fn name(role: Role, robot: RobotId) -> String {
    let word = serde_json::to_value(role).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default();
    if role == Role::StateServer { word } else { format!("{word} of {robot}") }
}
