//! State of a team, built from the messages that a process receives. Pure. Values that were not received stay unknown.

use std::collections::{BTreeMap, BTreeSet};

use super::mesh::Mesh;
use super::receptions::Receptions;
use super::revisions::Revisions;
use super::robot_view::{RobotView, SILENT};
use super::scans::Scans;
use super::snapshot::{RobotState, Snapshot};
use super::status::{Goals, Log, PageStatus, Scene, Success};
use murmurate::messages::geometry::{Planar, Pose};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::{self, Latch};
use murmurate::messages::local::Truth;
use murmurate::messages::telemetry::GuardReport;
use murmurate::messages::trigger::Trigger;
use murmurate::messages::wire::{Located, Mode, Phase, Sensed, Wire};
use murmurate::results::episode::Episode;
use murmurate::safety::guard::SafetyCounts;
use murmurate::scenario::judge::Verdict;
use murmurate::time::{Span, Time};
use murmurate_report::statistics::wilson_95;

/// Age from which a heading is no longer drawn, because the robot may have turned since.
const HEADING_AGE: Span = Span::from_millis(1000);
/// Heading beyond which robots turn at all \[rad\]. Holonomic robots of the training world keep the heading zero, so a
/// heading of theirs would only mislead.
const TURNED_RAD: f32 = 0.05;

/// State of a team as a process knows it, from the messages, true states of simulated robots and results that it has
/// received.
#[derive(Clone, Debug)]
pub struct TeamView {
    scene: Scene,
    /// Host of each robot's agent, by robot id.
    pub(super) homes: Vec<HostId>,
    revisions: Revisions,
    robots: Vec<RobotView>,
    receptions: Receptions,
    scans: Scans,
    goals: Vec<Option<[f32; 2]>>,
    /// Number of changes of the goals so far.
    goals_changed: u64,
    leader: Option<(Phase, u32, Latch)>,
    /// Time since which an episode runs; `None` between episodes.
    running: Option<Time>,
    /// Whether any robot has had another heading than zero.
    turns: bool,
    verdicts: BTreeMap<String, u32>,
    episodes: usize,
    successes: usize,
    log: Log,
    pub(super) mesh: Mesh,
}

impl TeamView {
    /// Returns the state of a team of which nothing was received yet. `scene` has its constant properties. `homes` has
    /// the host of each robot's agent, in the order of robot ids; `hosts` is the number of hosts.
    pub fn new(scene: Scene, homes: Vec<HostId>, hosts: usize) -> TeamView {
        let robots = scene.robots;
        TeamView {
            scene,
            homes,
            revisions: Revisions::default(),
            robots: vec![RobotView::default(); robots],
            receptions: Receptions::new(robots, hosts),
            scans: Scans::default(),
            goals: vec![None; robots],
            goals_changed: 0,
            leader: None,
            running: None,
            turns: false,
            verdicts: BTreeMap::new(),
            episodes: 0,
            successes: 0,
            log: Log::default(),
            mesh: Mesh::default(),
        }
    }

    /// Returns the constant properties of the run: scenario, ground, robots and links.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns the number of times that any robot's goal has changed so far, and the present goals.
    pub fn goals(&self) -> (u64, Goals) {
        (self.goals_changed, Goals { goals: self.goals.clone() })
    }

    /// Returns the number of times that any robot's goal has changed so far.
    pub fn goals_changed(&self) -> u64 {
        self.goals_changed
    }

    /// Updates the state with a message that a robot or another host has published.
    pub fn receive(&mut self, now: Time, message: &Wire) {
        match message {
            Wire::Reading(m) => self.measured(now, m.robot, m.pose),
            Wire::Latent(m) if m.robot.index() < self.robots.len() => {
                self.receptions.published(m.robot);
                let robot = &mut self.robots[m.robot.index()];
                (robot.heard, robot.latent) = (Some(now), Some(now));
                if !robot.is_true {
                    robot.position = Some(m.motion.position);
                }
            }
            Wire::Heartbeat(m) => self.robot(m.robot, |robot| {
                (robot.heard, robot.phase, robot.controller) = (Some(now), Some(m.phase), Some(m.latch));
                (robot.agent, robot.beats) = (Some(now), true);
            }),
            Wire::Mode(m) => self.led(now, m),
            Wire::Status(m) => {
                self.host_lives(now, m.host, m.revision);
                for following in &m.robots {
                    self.robot(following.robot, |robot| {
                        robot.controller = following.controller.or(robot.controller);
                        robot.body = following.body.or(robot.body);
                    });
                }
            }
            Wire::Telemetry(m) => {
                self.host_lives(now, m.host, m.revision);
                for condition in &m.robots {
                    if let Some(seen) = condition.seen {
                        let age = Span::from_millis(seen.age_ms.into());
                        self.measured(Time::ZERO + now.since(Time::ZERO + age), condition.robot, seen.pose);
                    }
                    self.robot(condition.robot, |robot| {
                        robot.heard = Some(now);
                        robot.phase = condition.phase.or(robot.phase);
                        robot.battery = condition.battery.or(robot.battery);
                        let age = condition.link_age_ms.map(|age_ms| Span::from_millis(age_ms.into()));
                        robot.oldest_link = age.map(|age| (now, age)).or(robot.oldest_link);
                    });
                    // The host of its motors tells of neither.
                    if let Some(report) = condition.guard {
                        self.reported(now, condition.robot, report, condition.suspect);
                    }
                }
            }
            Wire::Located(m) => self.located(now, m),
            Wire::Sensed(m) => self.sensed(now, m),
            Wire::Aloft(m) => self.robot(m.robot, |robot| robot.flight = Some(m.flight)),
            _ => {}
        }
    }

    /// Updates the state with a message that a robot has sent to the host `to` alone.
    pub fn sent(&mut self, to: HostId, robot: RobotId) {
        if robot.index() < self.robots.len() {
            self.receptions.sent(to, robot);
        }
    }

    /// Updates the state with the arrival of a robot's newest latent at the host `at`.
    pub fn arrived(&mut self, now: Time, at: HostId, robot: RobotId) {
        if robot.index() < self.robots.len() {
            self.receptions.arrived(now, at, robot);
        }
    }

    /// Records that a host has sent a message, so that the agents on it live, as far as no heartbeats tell more.
    fn host_lives(&mut self, now: Time, host: HostId, revision: u16) {
        self.revisions.told(host, revision).into_iter().for_each(|line| self.note(now, &line));
        let robots = self.robots.iter_mut().zip(&self.homes).filter(|(robot, home)| **home == host && !robot.beats);
        robots.for_each(|(robot, _)| robot.agent = Some(now));
    }

    /// Updates the state with the death of the process of a host, or with its return; the log names it with `text`.
    pub fn process(&mut self, now: Time, (host, down): (HostId, bool), text: &str) {
        let robots = self.robots.iter_mut().zip(&self.homes).filter(|(_, home)| **home == host);
        robots.for_each(|(robot, _)| robot.down = down);
        self.note(now, text);
    }

    /// Takes a scan for the page, unless it is of no sense with rays, or the robot's pose is unknown.
    fn sensed(&mut self, now: Time, sensed: &Sensed) {
        let robot = self.robots.get(sensed.robot.index());
        let pose = robot.and_then(|robot| Some((robot.position?, robot.heading?.1)));
        let is_scan = sensed.is_whole() && self.scene.scans.iter().any(|form| form.sense == sensed.sense);
        if let Some(pose) = pose.filter(|_| is_scan) {
            self.scans.take(now, sensed, pose);
        }
    }

    fn robot(&mut self, id: RobotId, change: impl FnOnce(&mut RobotView)) {
        if let Some(robot) = self.robots.get_mut(id.index()) {
            change(robot);
        }
    }

    fn measured(&mut self, at: Time, id: RobotId, pose: Pose) {
        self.turns |= pose.heading.is_some_and(|heading| heading.abs() > TURNED_RAD);
        self.robot(id, |robot| {
            robot.heard = robot.heard.max(Some(at));
            if !robot.is_true {
                robot.position = Some(pose.position);
                robot.heading = pose.heading.map(|heading| (at, heading));
            }
        });
    }

    fn led(&mut self, now: Time, mode: &Mode) {
        let before = self.leader.replace((mode.phase, mode.round.episode, mode.latch));
        if before.is_none_or(|(.., latch)| latch != mode.latch) && (before.is_some() || !mode.latch.is_clear()) {
            self.note(now, &format!("emergency stop: {}", mode.latch.word()));
        }
        if before.is_none_or(|(_, episode, _)| episode != mode.round.episode) {
            self.goals.fill(None);
        }
        self.running = if mode.phase == Phase::Running { self.running.or(Some(now)) } else { None };
        let first = mode.first.index();
        for (offset, task) in mode.tasks.iter().enumerate() {
            let Some(goal) = self.goals.get_mut(first + offset) else { continue };
            let heard = Some(task.goal.to_array());
            if *goal != heard {
                (*goal, self.goals_changed) = (heard, self.goals_changed + 1);
            }
        }
    }

    /// Updates the state with the true states of the simulated robots.
    pub fn see(&mut self, truth: &Truth) {
        for sample in truth.samples.iter() {
            self.turns |= sample.heading.abs() > TURNED_RAD;
            self.robot(sample.robot, |robot| {
                (robot.position, robot.is_true) = (Some(sample.motion.position), true);
                robot.heading = Some((Time::MAX, sample.heading));
                robot.touches = sample.contacts.robot || sample.contacts.wall;
            });
        }
    }

    /// Updates the state with the result of an episode, and logs it.
    pub fn judged(&mut self, now: Time, episode: &Episode) {
        self.note(now, &format!("episode {}: {}", episode.number(), episode.in_words()));
        *self.verdicts.entry(episode.verdict.word().to_owned()).or_default() += 1;
        self.episodes += 1;
        self.successes += usize::from(episode.verdict == Verdict::Success);
    }

    /// Updates the state with the numbers of times that a robot's guard has stopped or slowed it, and logs the causes
    /// whose numbers have grown.
    pub fn guarded(&mut self, now: Time, id: RobotId, counts: SafetyCounts) {
        let Some(robot) = self.robots.get_mut(id.index()) else { return };
        let begun: Vec<Trigger> = counts.begun_since(&robot.safety).collect();
        (robot.guard, robot.guarded) = (begun.last().map(|last| (*last, Some(now))).or(robot.guard), true);
        robot.safety = counts;
        begun.into_iter().for_each(|trigger| self.note_trigger(now, id, trigger));
    }

    /// Logs that a robot's guard has acted. An emergency stop of the team is logged once, not for each robot.
    fn note_trigger(&mut self, now: Time, id: RobotId, trigger: Trigger) {
        if trigger != Trigger::Stop {
            let episode = self.leader.map(|(_, episode, _)| episode);
            self.log.repeat(now.as_secs(), trigger.name(), id, episode);
        }
    }

    /// Updates what is known of a robot's guard from a telemetry report, and whom its host suspects of false claims.
    fn reported(&mut self, now: Time, id: RobotId, report: GuardReport, suspect: Option<RobotId>) {
        let Some(robot) = self.robots.get_mut(id.index()) else { return };
        let (news, said) = (robot.reported(now, report), robot.suspects(suspect));
        said.into_iter().for_each(|said| self.note(now, &format!("{said}, by the tracker and {id}")));
        news.into_iter().for_each(|trigger| self.note_trigger(now, id, trigger));
    }

    /// Updates which robots' poses are unknown, and logs each change with its reason.
    fn located(&mut self, now: Time, located: &Located) {
        for &(id, whereabouts) in &located.robots {
            let said = self.robots.get_mut(id.index()).and_then(|robot| robot.locate(whereabouts));
            said.into_iter().for_each(|said| self.note(now, &format!("{id}{said}")));
        }
    }

    /// Sets the battery charge \[%\] of a robot.
    pub fn charged(&mut self, id: RobotId, percent: u8) {
        self.robot(id, |robot| robot.battery = Some(percent));
    }

    /// Takes the members of the roster that is in force. The log names the robots of hosts that are none.
    pub fn members(&mut self, now: Time, members: &BTreeSet<HostId>) {
        let robots = self.robots.iter_mut().zip(&self.homes).enumerate();
        let news = robots.filter_map(|(at, (robot, home))| robot.membership(at, !members.contains(home)));
        news.collect::<Vec<String>>().iter().for_each(|line| self.note(now, line));
    }

    /// Adds a line to the log, at the time `now`.
    pub fn note(&mut self, now: Time, line: &str) {
        self.log.add(now.as_secs(), line);
    }

    /// Returns how often each robot's guard has stopped or slowed it, by cause, in the order of robot ids.
    pub fn safety(&self) -> impl Iterator<Item = (RobotId, SafetyCounts)> {
        self.robots.iter().enumerate().map(|(at, robot)| (RobotId(at as u16), robot.safety))
    }

    /// Returns the number of episodes with each verdict, by the verdict's name.
    pub fn verdicts(&self) -> &BTreeMap<String, u32> {
        &self.verdicts
    }

    /// Returns the number of lines that were added to the log so far.
    pub fn log_count(&self) -> u64 {
        self.log.count()
    }

    /// Returns the newest line of the log; empty if there is none.
    pub fn last_line(&self) -> String {
        self.log.lines().back().map_or_else(String::new, |line| line.text.clone())
    }

    /// Returns the state of the team's emergency stop: the newest that the state server or a robot has reported.
    pub fn latch(&self) -> Latch {
        let latches = self.robots.iter().filter_map(|robot| robot.controller);
        let known = self.leader.map(|(.., latch)| latch).or_else(|| latches.clone().min()).unwrap_or_default();
        latch::latest(known, latches)
    }

    /// Returns the phase of the current episode and its number, from 0; `None` before an instruction of the state
    /// server was received.
    pub fn phase(&self) -> Option<(Phase, u32)> {
        self.leader.map(|(phase, episode, _)| (phase, episode))
    }

    /// Returns the number of robots that follow the team's state of the emergency stop. For a stop, a robot's guard and
    /// its motors must both follow it.
    pub fn confirmed(&self) -> usize {
        let latch = self.latch();
        let follows = |own: Latch| own.word() == latch.word();
        let confirms = |robot: &&RobotView| {
            let body = |body: Latch| !latch.is_engaged() || follows(body);
            robot.controller.is_some_and(follows) && (!latch.is_engaged() || robot.body.is_some_and(body))
        };
        self.robots.iter().filter(confirms).count()
    }

    /// Returns the snapshot of the team at the time `now`: states of robots, and links between them.
    pub fn snapshot(&self, now: Time) -> Snapshot {
        let state = |robot: &RobotView| RobotState {
            position: robot.position,
            heading: robot.heading.filter(|(at, _)| self.turns && now.since(*at) <= HEADING_AGE).map(|(_, it)| it),
            phase: robot.phase,
            age: robot.age(now, self.running),
            touches: robot.touches,
            latched: robot.controller.is_some_and(|latch| !latch.is_clear()),
        };
        let known = self.robots.iter().enumerate().filter_map(|(at, robot)| Some((at, robot.position?)));
        let range_m = self.scene.range_m.unwrap_or(f32::INFINITY);
        let (links, left_out) = match self.scene.hears_links {
            true => self.receptions.links(now, &self.homes, range_m, &known.collect::<Vec<_>>()),
            false => (Vec::new(), 0),
        };
        let (robots, scans) = (self.robots.iter().map(state).collect(), self.scans.drawn(now));
        let movers = self.running.zip(self.leader).into_iter().flat_map(|(began, (_, episode, _))| {
            self.scene.movers.iter().filter_map(move |mover| mover.place(episode, now.since(began)))
        });
        Snapshot { now, robots, links, left_out, scans, movers: movers.collect() }
    }

    /// Returns the status of the team at the time `now`, as far as messages tell it. Fields that the calling process
    /// has to fill, such as its speed, have defaults.
    pub fn status(&mut self, now: Time) -> PageStatus {
        self.note_silence(now);
        let numbered = || self.robots.iter().enumerate().map(|(at, robot)| (at as u16, robot));
        PageStatus {
            time_s: now.as_secs(),
            episode: self.leader.map(|(_, episode, _)| episode + 1),
            phase: self.leader.map(|(phase, ..)| phase.into()),
            latch: self.latch().word(),
            confirmed: self.confirmed(),
            robots: self.robots.len(),
            pause: "no",
            verdicts: self.verdicts.clone(),
            success: self.scene.hears_results.then(|| Success {
                successes: self.successes,
                episodes: self.episodes,
                interval: wilson_95(self.successes, self.episodes),
            }),
            late: numbered().filter(|(_, robot)| robot.guarded).map(|(at, r)| (at, r.safety.late_tick)).collect(),
            guard: numbered()
                .filter_map(|(at, robot)| robot.last_guard(now).map(|(name, age_s)| (at, name, age_s)))
                .collect(),
            down: numbered().filter(|(_, robot)| robot.down).map(|(at, _)| at).collect(),
            link: numbered().filter_map(|(at, robot)| Some((at, robot.link_age_ms(now)?))).collect(),
            battery: numbered().filter_map(|(at, robot)| Some((at, robot.battery?))).collect(),
            flight: numbered().filter_map(|(at, robot)| Some((at, robot.flight?.words()))).collect(),
            mesh: self.mesh.status(now, &self.homes),
            log: self.log.lines().iter().cloned().collect(),
            ..PageStatus::default()
        }
    }

    /// Logs each robot whose agent falls silent or is received again. After the last episode all processes end, which
    /// is no event.
    fn note_silence(&mut self, now: Time) {
        let (mut lines, running) = (Vec::new(), self.running);
        let finished = self.leader.is_some_and(|(phase, ..)| phase == Phase::EpisodesFinished);
        for (at, robot) in self.robots.iter_mut().enumerate() {
            let silent = robot.age(now, running).is_some_and(|age| age >= SILENT);
            if silent != robot.silent && !finished {
                robot.silent = silent;
                let id = RobotId(at as u16);
                lines.push(format!("{id}: {}", if silent { "silent" } else { "heard again" }));
            }
        }
        lines.iter().take(8).for_each(|line| self.note(now, line));
    }
}

#[cfg(test)]
mod tests {
    use super::super::scans::ScanForm;
    use super::super::snapshot::LinkState;
    use super::*;
    use murmurate::messages::geometry::{Motion, Vec2};
    use murmurate::messages::wire;
    use murmurate::messages::wire::REVISION;
    use murmurate::messages::wire::{Condition, Features, Following, Heartbeat, Latent, Round, Telemetry};
    use murmurate::scenario::{DrawnMover, Solid};

    fn view() -> TeamView {
        let scene = Scene { robots: 3, range_m: Some(1.0), hears_links: true, hears_results: true, ..Scene::default() };
        TeamView::new(scene, vec![HostId(0), HostId(1), HostId(2)], 3)
    }

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn latent(robot: u16, x: f32) -> Wire {
        let motion = Motion::at_rest(Vec2::new(x, 0.0));
        let (round, phase) = (Round::default(), Phase::Running);
        Wire::Latent(Latent {
            robot: RobotId(robot),
            round,
            phase,
            motion,
            features: Features(Vec::new().into()),
            part: None,
        })
    }

    #[test]
    fn what_was_not_heard_is_not_drawn() {
        let mut view = view();
        view.receive(at(10), &latent(0, 0.5));
        view.receive(at(10), &latent(77, 0.5));
        let snapshot = view.snapshot(at(40));
        assert_eq!(snapshot.robots[0].position, Some(Vec2::new(0.5, 0.0)));
        assert_eq!((snapshot.robots[0].heading, snapshot.robots[0].age), (None, Some(Span::from_millis(30))));
        assert_eq!(snapshot.robots[1], RobotState::default());
        assert!(snapshot.links.is_empty());
    }

    #[test]
    fn links_join_robots_within_range_and_have_the_age_of_the_older_direction() {
        let mut view = view();
        for (robot, x) in [(0, 0.0), (1, 0.9), (2, 2.0)] {
            view.receive(at(0), &latent(robot, x));
        }
        assert_eq!(view.snapshot(at(0)).links, [LinkState { one: 0, other: 1, age: None, loss: None }]);
        view.arrived(at(5), HostId(0), RobotId(1));
        view.arrived(at(20), HostId(1), RobotId(0));
        let link = view.snapshot(at(30)).links[0];
        assert_eq!((link.age, link.loss), (Some(Span::from_millis(25)), Some(0)));
    }

    #[test]
    fn a_stop_is_confirmed_by_controller_and_motors() {
        let mut view = view();
        let (clear, stopped) = (Latch::clear(0), Latch::engaged(1));
        let heartbeat = |robot: u16, latch| {
            Wire::Heartbeat(Heartbeat::new(RobotId(robot), Round::default(), Phase::Running, latch))
        };
        (0..3).for_each(|robot| view.receive(at(0), &heartbeat(robot, clear)));
        assert_eq!((view.confirmed(), view.latch().word()), (3, "clear"));
        view.receive(at(10), &heartbeat(1, stopped));
        assert_eq!((view.confirmed(), view.latch().word()), (0, "stopped"), "its motors may turn");
        let robots = vec![Following { robot: RobotId(1), controller: Some(stopped), body: Some(stopped) }];
        view.receive(at(20), &Wire::Status(wire::Status::of(HostId(1), false, robots, None)));
        let before = view.log_count();
        let status = wire::Status::of(HostId(1), false, Vec::new(), None);
        for revision in [REVISION + 1, REVISION + 1, REVISION] {
            view.receive(at(30), &Wire::Status(wire::Status { revision, ..status.clone() }));
            let said =
                if revision == REVISION { "revision 1 now" } else { "revision 2, this page of 1: the team stands" };
            assert!(view.last_line().contains(said), "{}", view.last_line());
        }
        assert_eq!(view.log_count(), before + 2, "each change once");
        assert_eq!(view.confirmed(), 1);
        assert!(view.snapshot(at(20)).robots[1].latched);
    }

    #[test]
    fn guards_and_silence_are_logged_once() {
        let mut view = view();
        view.receive(at(0), &latent(2, 0.0));
        view.guarded(at(0), RobotId(2), SafetyCounts { late_tick: 2, ..SafetyCounts::default() });
        view.guarded(at(0), RobotId(2), SafetyCounts { late_tick: 2, fence: 1, ..SafetyCounts::default() });
        let status = view.status(at(2000));
        assert_eq!((status.late, status.guard), (vec![(2, 2)], vec![(2, "geofence", Some(2.0))]));
        assert_eq!(lines(&view.status(at(2500))), ["robot 2: late ticks", "robot 2: geofence", "robot 2: silent"]);
        assert!(view.status(at(60_001)).guard.is_empty(), "a minute later it tells nothing");
    }

    #[test]
    fn scans_are_drawn_where_the_robot_was_and_other_senses_are_not() {
        let mut view = view();
        view.scene.scans = vec![ScanForm { sense: 1, ..ScanForm::default() }];
        let sensed = |robot, sense| {
            let values = Features([1.0, f32::INFINITY].into());
            Wire::Sensed(Sensed { robot: RobotId(robot), sense, stamp_ns: 1, first: 0, of: 2, values })
        };
        view.receive(at(0), &sensed(0, 1));
        assert!(view.snapshot(at(0)).scans.is_empty(), "where the robot is, is not known");
        let motion = Motion::at_rest(Vec2::new(0.5, 0.0));
        let reading = Wire::Reading(wire::Reading::of_point(RobotId(0), 1, motion));
        let Wire::Reading(mut measured) = reading else { panic!("it is one") };
        measured.pose.heading = Some(0.0);
        view.receive(at(10), &Wire::Reading(measured));
        [sensed(0, 1), sensed(0, 0), sensed(9, 1)].iter().for_each(|message| view.receive(at(20), message));
        view.receive(at(30), &latent(0, 0.75));
        let scans = view.snapshot(at(40)).scans;
        let [scan] = &scans[..] else { panic!("one is of a sense with rays: {scans:?}") };
        assert_eq!((scan.robot, scan.sense, scan.position, scan.heading), (0, 1, Vec2::new(0.5, 0.0), 0.0));
    }

    fn lines(status: &PageStatus) -> Vec<&str> {
        status.log.iter().map(|line| &*line.text).collect()
    }

    #[test]
    fn a_robot_whose_host_the_roster_does_not_name_is_named_once_and_again_when_it_is() {
        let mut view = view();
        let all: BTreeSet<HostId> = view.homes.iter().copied().collect();
        let none = BTreeSet::from([HostId::operator(1)]);
        for members in [&all, &all, &none, &none, &all] {
            view.members(at(0), members);
        }
        let (status, robots) = (view.status(at(0)), view.homes.len());
        let said = lines(&status);
        assert_eq!(said.iter().filter(|line| line.contains("it may move uncontrolled")).count(), robots, "{said:?}");
        assert_eq!(said.iter().filter(|line| line.contains("in the roster again")).count(), robots, "{said:?}");
    }

    #[test]
    fn a_suspect_is_named_once_and_again_when_it_is_none_any_more() {
        let mut view = view();
        let told = |suspect, guard| {
            let (robot, seen, health, temperature, reason) = (RobotId(0), None, None, None, None);
            let (phase, battery, link_age_ms) = (None, None, None);
            let all =
                Condition { robot, phase, seen, health, battery, temperature, reason, guard, link_age_ms, suspect };
            Wire::Telemetry(Telemetry::of(HostId(0), vec![all]))
        };
        let guard = Some(GuardReport::default());
        for (suspect, guard) in [(Some(RobotId(1)), guard), (None, None), (Some(RobotId(1)), guard), (None, guard)] {
            view.receive(at(0), &told(suspect, guard));
        }
        let said = [
            "robot 1 is not where it says it is, by the tracker and robot 0",
            "robot 1 is again where it says it is, by the tracker and robot 0",
        ];
        assert_eq!(lines(&view.status(at(0))), said, "the host of its motors tells of no suspects");
    }

    #[test]
    fn a_stop_is_no_guard_s_last_action_any_more_once_the_robot_may_move_again() {
        let mut view = view();
        let heartbeat = |latch| {
            let round = Round::default();
            Wire::Heartbeat(Heartbeat::new(RobotId(0), round, Phase::Running, latch))
        };
        let counts = |stop| SafetyCounts { stop, ..SafetyCounts::default() };
        let report = || GuardReport { acted: 1, late_ticks: 0, last: Some(Trigger::Stop) };
        view.receive(at(0), &heartbeat(Latch::engaged(1)));
        view.guarded(at(0), RobotId(0), counts(1));
        assert_eq!(view.status(at(100)).guard, [(0, "emergency stops", Some(0.1))]);
        view.receive(at(200), &heartbeat(Latch::held(2)));
        assert_eq!(view.status(at(200)).guard.len(), 1, "it still stands");
        view.receive(at(300), &heartbeat(Latch::clear(3)));
        assert!(view.status(at(300)).guard.is_empty());
        // A page that joins later hears of the stop in telemetry, which repeats it for ever.
        for ms in [400, 700] {
            view.reported(at(ms), RobotId(0), report(), None);
            assert!(view.status(at(ms)).guard.is_empty());
        }
    }

    #[test]
    fn a_robot_whose_agent_has_died_is_silent_although_others_measure_it() {
        let mut view = view();
        let reading = |x| Wire::Reading(wire::Reading::of_point(RobotId(1), 1, Motion::at_rest(Vec2::new(x, 0.0))));
        let heartbeat = || {
            let (round, latch) = (Round::default(), Latch::default());
            Wire::Heartbeat(Heartbeat::new(RobotId(1), round, Phase::Running, latch))
        };
        view.receive(at(0), &heartbeat());
        for ms in (0..3000).step_by(50) {
            view.receive(at(ms), &reading(0.1));
        }
        let robot = view.snapshot(at(3000)).robots[1];
        assert_eq!((robot.age, robot.position), (Some(Span::from_millis(3000)), Some(Vec2::new(0.1, 0.0))));
        assert_eq!(lines(&view.status(at(3000))), ["robot 1: silent"]);
        view.receive(at(3100), &heartbeat());
        assert_eq!(lines(&view.status(at(3100))), ["robot 1: silent", "robot 1: heard again"]);
    }

    #[test]
    fn an_agent_without_latents_in_an_episode_is_silent_although_its_controller_lives() {
        let mut view = view();
        let heartbeat = || {
            let (round, latch) = (Round::default(), Latch::default());
            Wire::Heartbeat(Heartbeat::new(RobotId(0), round, Phase::Running, latch))
        };
        let mode = |phase| {
            let (round, latch) = (Round::default(), Latch::default());
            Wire::Mode(Mode { round, repeat: 0, phase, first: RobotId(0), tasks: Vec::new().into(), latch })
        };
        view.receive(at(0), &mode(Phase::Running));
        view.receive(at(0), &latent(0, 0.5));
        let age = |view: &mut TeamView, ms| {
            view.receive(at(ms), &heartbeat());
            view.snapshot(at(ms)).robots[0].age
        };
        assert_eq!(age(&mut view, 2000), Some(Span::from_millis(2000)));
        view.receive(at(2000), &mode(Phase::AbortRunning));
        assert_eq!(age(&mut view, 4000), Some(Span::ZERO), "between episodes agents need not speak");
        view.receive(at(5000), &mode(Phase::Running));
        assert_eq!(age(&mut view, 5100), Some(Span::from_millis(100)), "it has just begun");
    }

    #[test]
    fn moving_obstacles_are_where_they_begin_in_each_episode_and_nowhere_between() {
        let mut view = view();
        view.scene.movers = vec![DrawnMover {
            body: Solid::Rect([-0.1; 4]),
            round: vec![[0.0, 0.0], [2.0, 0.0], [0.0, 0.0]],
            speed_m_s: 0.5,
            phases: vec![0.0, 0.5],
        }];
        let mode = |episode, phase| {
            let (round, latch) = (Round { episode, ..Round::default() }, Latch::default());
            Wire::Mode(Mode { round, repeat: 0, phase, first: RobotId(0), tasks: Vec::new().into(), latch })
        };
        let mut places = |ms, episode, phase| {
            view.receive(at(ms), &mode(episode, phase));
            view.snapshot(at(ms + 1000)).movers
        };
        assert_eq!(places(100, 0, Phase::Running), [Vec2::new(0.5, 0.0)]);
        assert_eq!(places(1100, 0, Phase::Running), [Vec2::new(1.0, 0.0)]);
        assert!(places(1200, 0, Phase::FinishedRunning).is_empty());
        assert_eq!(places(1300, 1, Phase::Running), [Vec2::new(1.5, 0.0)], "on its way back");
    }

    #[test]
    fn a_process_that_died_and_came_back_is_named_and_its_robot_is_down_meanwhile() {
        let mut view = view();
        view.process(at(100), (HostId(2), true), "the process 'agent-2' has died");
        assert_eq!(view.status(at(100)).down, [2]);
        view.process(at(500), (HostId(2), false), "the process 'agent-2' is back");
        let status = view.status(at(500));
        assert!(status.down.is_empty());
        assert_eq!(lines(&status), ["the process 'agent-2' has died", "the process 'agent-2' is back"]);
    }

    #[test]
    fn the_end_of_the_last_episode_makes_no_robot_silent_in_the_log() {
        let mut view = view();
        let (round, latch) = (Round::default(), Latch::default());
        let phase = Phase::EpisodesFinished;
        let mode = Mode { round, repeat: 0, phase, first: RobotId(0), tasks: Vec::new().into(), latch };
        (0..3).for_each(|robot| view.receive(at(0), &latent(robot, 0.0)));
        view.receive(at(10), &Wire::Mode(mode));
        assert!(view.status(at(5000)).log.is_empty());
    }

    #[test]
    fn robots_that_never_turn_show_no_heading() {
        let mut view = view();
        let heads = |view: &TeamView| view.snapshot(at(10)).robots.iter().filter(|r| r.heading.is_some()).count();
        let mut see = |heading: f32| {
            let sample = |robot| murmurate::messages::local::Sample {
                robot,
                time: at(0),
                motion: Motion::at_rest(Vec2::zeros()),
                heading,
                yaw_rate: 0.0,
                command: Vec2::zeros(),
                contacts: murmurate::messages::local::Contacts::default(),
            };
            view.see(&Truth { time: at(0), samples: RobotId::team(3).map(sample).collect() });
            heads(&view)
        };
        assert_eq!((see(0.0), see(0.3), see(0.0)), (0, 3, 3));
    }
}
