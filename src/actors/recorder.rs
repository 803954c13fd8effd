//! Recorder: receives all published messages and true states, and produces the report of the trial.
//!
//! It digests messages and states into the run's trace, follows the state server's instructions, and passes each step
//! of a running episode to the judge. No actor of the graph receives its results.
//!
//! If one World simulates the whole team, the judge gets true states. Otherwise it gets the readings of each robot
//! (`Judged::Readings`; `scenario::sightings` describes their quality). A robot measured within its radius of a wall
//! then counts as touching it. Readings do not show a motion that a World blocks before a wall.

use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;

use xxhash_rust::xxh3::Xxh3;

use crate::actor::Core;
use crate::actors::listener::{Datagram, Listener};
use crate::chassis::Chassis;
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::local::{Contacts, Sample, Truth};
use crate::messages::wire::{KINDS, Kind, Phase, Reading, Round, Wire};
use crate::net::media::radio::RadioCounts;
use crate::net::protocol::codec::{self, Content, Flags, Frame, Header};
use crate::net::protocol::link::LinkCounts;
use crate::results::episode::{AbortReason, Episode, Judged};
use crate::results::sensing::Sensings;
use crate::results::totals::{Hearing, Published, Step, Steps, Totals};
use crate::safety::guard::SafetyCounts;
use crate::scenario::Scenario;
use crate::scenario::judge::{JudgedRobot, Judgement, Verdict};
use crate::scenario::layout::Layouts;
use crate::scenario::sightings::{Sighting, Sightings, Spot};
use crate::scenario::watched::EpisodeJudge;
use crate::time::{Span, Time};

/// Input message of a Recorder, the actor that judges episodes and collects the results of a trial.
#[derive(Clone, Debug)]
pub(crate) enum In {
    /// Datagram that a Network of this process has published.
    Tap(Frame),
    /// Message that another process has published and this process has received; sent where hosts run in processes of
    /// their own.
    Received(Wire),
    /// True states after a step of a World.
    Truth(Truth),
    /// Numbers of datagrams that were sent, received and refused on all links of a host, since its Network was started.
    Counts(HostId, Box<LinkCounts>),
    /// Counts of the emulated radio channel of a link, such as frames sent and lost, since the start of the run.
    Radio(LinkId, Box<RadioCounts>),
    /// Numbers of times that a robot's guard has stopped or slowed it, since its Controller was started.
    Safety(RobotId, SafetyCounts),
    /// The state server of this process aborts the episode with this index, from 0, for this reason. It comes before
    /// the instruction.
    Aborted(u32, AbortReason),
    /// Request for the totals of the run, which ends now even if an episode is running.
    Closing,
    /// Datagram that a host of this process has received.
    Arrived(HostId, Frame),
    /// Percept (policy inputs) of a robot at its host: the neighbours whose messages are in it, and the ages of the
    /// messages.
    Perceived(HostId, RobotId, Box<[(RobotId, Span)]>),
    /// Reading that the state server's host has received; readings are judged there.
    Reading(Reading),
}

/// Output of a Recorder.
#[derive(Clone, Debug)]
pub enum Out {
    /// Result of an episode, and the totals so far.
    Episode(Episode, Totals),
    /// State of the whole team at one instant.
    Step(Step),
    /// All episodes of the trial have ended; with the totals of the trial.
    Finished(Totals),
    /// The run has ended, perhaps before all episodes have; with the totals so far.
    Closed(Totals),
}

/// Configuration of a Recorder, the actor that judges episodes and collects the results of a trial.
#[derive(Clone, Debug)]
pub(crate) struct Config {
    /// Starts and goals of all episodes of the trial, in order.
    pub(crate) layouts: Layouts,
    /// Index of this trial among the repeats of the experiment, from zero.
    pub(crate) repeat: u32,
    /// Scenario by whose rules, cost and behaviour episodes are judged, with ground and walls.
    pub(crate) scenario: Arc<dyn Scenario>,
    /// Whether the report has the true states of the robots at each step, and whose messages each robot then uses.
    pub(crate) steps: Steps,
    /// Number of other hosts that each broadcast latent should reach: the hosts with an Agent, without the sender.
    pub(crate) receivers: u64,
    /// Whether episodes are judged from true states or from readings.
    pub(crate) judged: Judged,
    /// Whether robots are placed at their starts before an episode (`true`) or drive there (`false`).
    pub(crate) placed: bool,
    /// Distance between a robot's centre and a wall below which the robot touches the wall \[m\]. Used only where
    /// readings are judged.
    pub(crate) wall_radius_m: f32,
    /// Chassis of each robot, indexed by robot id.
    pub(crate) chassis: Rc<[Chassis]>,
}

/// Time since a robot's last control step after which it counts as using no messages.
const HEARING_TIMEOUT: Span = Span::from_millis(250);

/// Recorder: the actor that judges the episodes of a trial and sends their results, totals and steps as [`Out`]. The
/// totals have a digest (trace) that is equal for equal runs.
pub(crate) struct Recorder {
    config: Config,
    digest: Xxh3,
    messages: u64,
    published: [Published; KINDS.len()],
    team: Vec<Option<Sample>>,
    /// For each robot: whether its true state has arrived since the last complete step of the team.
    seen: Vec<bool>,
    commanded: Vec<Time>,
    /// Last link counts of each host. A restarted Network begins at zero again.
    counts: BTreeMap<HostId, LinkCounts>,
    radio: BTreeMap<LinkId, RadioCounts>,
    /// Last counts of each robot's guard.
    safety: BTreeMap<RobotId, SafetyCounts>,
    oldest_command: Span,
    sightings: Sightings,
    listener: Listener,
    /// For each robot: time of its last control step, and the neighbours whose messages it used, with their ages.
    heard: Vec<(Time, Vec<(RobotId, Span)>)>,
    sensings: Sensings,
    round: Round,
    phase: Phase,
    since: Time,
    reset: Span,
    judge: Option<EpisodeJudge>,
    /// Reason of the last episode that the state server has aborted, with the episode's index.
    aborted: Option<(u32, AbortReason)>,
    /// Index of the first episode without a verdict.
    open: u32,
    finished: bool,
}

impl Recorder {
    /// Creates the Recorder of a trial with `robots` robots.
    pub(crate) fn new(config: Config, robots: usize) -> Recorder {
        Recorder {
            listener: Listener::new(config.receivers),
            config,
            digest: Xxh3::new(),
            messages: 0,
            published: [Published::default(); KINDS.len()],
            team: vec![None; robots],
            seen: vec![false; robots],
            commanded: vec![Time::ZERO; robots],
            counts: BTreeMap::new(),
            radio: BTreeMap::new(),
            safety: BTreeMap::new(),
            oldest_command: Span::ZERO,
            sightings: Sightings::new(robots),
            heard: vec![(Time::ZERO, Vec::new()); robots],
            sensings: Sensings::default(),
            round: Round::default(),
            phase: Phase::NeedReset,
            since: Time::ZERO,
            reset: Span::ZERO,
            judge: None,
            aborted: None,
            open: 0,
            finished: false,
        }
    }

    fn tap(&mut self, now: Time, frame: &Frame, out: &mut Vec<Out>) {
        self.messages += 1;
        self.digest.update(&now.as_nanos().to_le_bytes());
        self.digest.update(frame);
        let content = codec::first(frame).expect("a Network publishes whole datagrams");
        if let Content::Message(kind) = content {
            let counts = &mut self.published[kind as usize];
            (counts.messages, counts.bytes) = (counts.messages + 1, counts.bytes + frame.len() as u64);
        }
        if content == Content::Message(Kind::Latent) && self.follows_messages() {
            let (header, message) = codec::decode(frame).expect("a Network publishes whole datagrams");
            self.listener.published(now, datagram(&header), message.robot());
        }
        if content == Content::Message(Kind::Sensed) && self.config.steps == Steps::WithHearing {
            self.sensings.take(codec::decode(frame).expect("a Network publishes whole datagrams").1, &self.team);
        }
        if !matches!(content, Content::Message(Kind::Mode | Kind::MotorCommand)) {
            return;
        }
        self.receive(now, &codec::decode(frame).expect("a Network publishes whole datagrams").1, out);
    }

    /// Whether each latent is followed from its publication to the control steps that use it: in running episodes, if
    /// the report needs it.
    fn follows_messages(&self) -> bool {
        self.config.steps.follow_messages() && self.phase == Phase::Running
    }

    fn receive(&mut self, now: Time, message: &Wire, out: &mut Vec<Out>) {
        match message {
            Wire::Mode(mode) => self.follow(now, mode.round, mode.phase, out),
            Wire::MotorCommand(command) => self.commanded[command.robot.index()] = now,
            _ => {}
        }
    }

    fn follow(&mut self, now: Time, round: Round, phase: Phase, out: &mut Vec<Out>) {
        if (round, phase) == (self.round, self.phase) || self.finished {
            return;
        }
        // An earlier episode without a verdict was given up; a verdict is final.
        let behind = if phase == Phase::AbortRunning { round.episode + 1 } else { round.episode };
        while self.open < behind.min(self.config.layouts.len()) {
            let after = now.since(self.since);
            let lapsed = self.config.judged == Judged::Readings && self.sightings.lapsed(now);
            let finding = match &self.judge {
                Some(judge) => judge.rules.end(after, if lapsed { Verdict::Unseen } else { Verdict::Aborted }),
                None => Judgement { verdict: Verdict::Aborted, after, min_separation_m: f32::INFINITY, cost: None },
            };
            self.close(now, finding, out);
        }
        if phase == Phase::Waiting {
            // A host has left: the episode will be repeated, and judged then.
            self.judge = None;
        }
        let goes_on = (phase, round.episode) == (self.phase, self.round.episode);
        if phase == Phase::Running && self.judge.is_none() && round.episode == self.open {
            let tasks = self.config.layouts.episode(round.episode);
            let episode = (self.config.repeat, round.episode);
            self.judge = Some(EpisodeJudge::begun(&self.config.scenario, episode, &self.config.layouts));
            let starts: Vec<Vec2> = tasks.iter().map(|task| task.start).collect();
            self.sightings.begin(now, Some(&starts[..]).filter(|_| self.config.placed));
            self.reset = if self.phase == Phase::Resetting { now.since(self.since) } else { Span::ZERO };
        }
        if phase == Phase::EpisodesFinished {
            self.finished = true;
            out.push(Out::Finished(self.totals(now)));
        }
        if !goes_on {
            self.heard.iter_mut().for_each(|(_, heard)| heard.clear());
        }
        // A restarted server that repeats the instruction does not begin the phase anew.
        self.since = if goes_on { self.since } else { now };
        (self.round, self.phase) = (round, phase);
    }

    /// Returns the totals of the trial so far: numbers of messages, trace, and counts of links, radio and guards.
    fn totals(&self, now: Time) -> Totals {
        Totals {
            messages: self.messages,
            published: self.published,
            end: now,
            trace: self.digest.digest128(),
            oldest_command: self.team.iter().all(Option::is_some).then_some(self.oldest_command),
            links: self.counts.values().copied().sum(),
            radio: self.radio.values().copied().sum(),
            safety: self.safety.values().copied().sum(),
            listening: self.listener.listening(),
        }
    }

    fn close(&mut self, now: Time, finding: Judgement, out: &mut Vec<Out>) {
        let success = finding.verdict == Verdict::Success;
        let aborted = finding.verdict == Verdict::Aborted;
        let episode = Episode {
            repeat: self.config.repeat,
            episode: self.open,
            verdict: finding.verdict,
            makespan_s: success.then(|| finding.after.as_secs()),
            reset_s: self.reset.as_secs(),
            min_separation_m: finding.min_separation_m,
            judged: self.config.judged,
            cost: finding.cost,
            reason: self.aborted.filter(|(episode, _)| aborted && *episode == self.open).map(|(_, reason)| reason),
        };
        out.push(Out::Episode(episode, self.totals(now)));
        self.judge = None;
        self.reset = Span::ZERO;
        self.open += 1;
    }

    fn take_truth(&mut self, now: Time, truth: &Truth, out: &mut Vec<Out>) {
        for sample in truth.samples.iter() {
            let (p, v, c) = (sample.motion.position, sample.motion.velocity, sample.command);
            self.digest.update(&truth.time.as_nanos().to_le_bytes());
            for float in [p.x, p.y, v.x, v.y, c.x, c.y] {
                self.digest.update(&float.to_bits().to_le_bytes());
            }
            if c.x != 0.0 || c.y != 0.0 {
                let age = now.since(self.commanded[sample.robot.index()]);
                self.oldest_command = self.oldest_command.max(age);
            }
            let robot = sample.robot.index();
            let mut sample = *sample;
            // Keep contacts of an earlier sample that were not judged yet.
            if let Some(before) = self.team[robot].filter(|_| self.seen[robot]) {
                sample.contacts.wall |= before.contacts.wall;
                sample.contacts.robot |= before.contacts.robot;
            }
            self.team[robot] = Some(sample);
            self.seen[robot] = true;
        }
        // Worlds may step at different instants. The team's step is complete once each World has sent its robots.
        if self.seen.iter().all(|&seen| seen) {
            self.seen.fill(false);
            self.judge_step(now, out);
        }
    }

    /// Judges a step for which the true states of all robots are known, and sends it as [`Out`] if steps are kept.
    fn judge_step(&mut self, now: Time, out: &mut Vec<Out>) {
        let samples: Vec<Sample> = self.team.iter().flatten().copied().collect();
        if self.phase == Phase::Running
            && self.config.judged == Judged::Truth
            && let Some(judge) = &mut self.judge
        {
            let seen = |sample: &Sample| {
                let point = self.config.chassis[sample.robot.index()].point_of(sample);
                let Motion { position, velocity } = sample.motion;
                JudgedRobot { position, point, velocity, contacts: sample.contacts }
            };
            let seen: Vec<JudgedRobot> = samples.iter().map(seen).collect();
            if let Some(finding) = judge.update(now.since(self.since), &seen) {
                self.close(now, finding, out);
            }
        }
        if self.config.steps.kept() {
            let (hearing, sensed) = (self.hearing(now), self.sensings.all());
            out.push(Out::Step(Step { episode: self.round.episode, phase: self.phase, samples, hearing, sensed }));
        }
    }

    /// Handles a robot's reading. If it completes a sighting of robots at one instant, passes that to the judge.
    fn take_reading(&mut self, now: Time, reading: &Reading, out: &mut Vec<Out>) {
        let centre = self.config.chassis[reading.robot.index()].centre(reading);
        let Some(Sighting { at, robots, lapsed }) = self.sightings.see(now, reading, centre) else { return };
        let (fixed, episode) = (self.config.scenario.arena(), self.round.episode);
        let running = (self.phase == Phase::Running).then(|| at.since(self.since));
        let arena = self.config.layouts.arena(episode).map_or(fixed, |arena| &**arena).at(running);
        let radius_m = self.config.wall_radius_m;
        let seen = |(robot, Spot { centre, point, velocity }): (RobotId, Spot)| {
            let contacts = Contacts { wall: arena.clearance(centre) <= radius_m, robot: false };
            (robot, JudgedRobot { position: centre, point, velocity, contacts })
        };
        let Some(judge) = self.judge.as_mut().filter(|_| self.phase == Phase::Running) else { return };
        if lapsed {
            judge.rules.fail(Verdict::Unseen);
        }
        let seen: Vec<(RobotId, JudgedRobot)> = robots.into_iter().map(seen).collect();
        if let Some(finding) = judge.rules.update_some(at.since(self.since), &seen) {
            self.close(now, finding, out);
        }
    }

    /// Returns for each message that a robot uses at `now` its receiver, sender and age. Empty outside running episodes
    /// and unless the steps are kept `WithHearing`.
    fn hearing(&self, now: Time) -> Vec<Hearing> {
        if self.config.steps != Steps::WithHearing || self.phase != Phase::Running {
            return Vec::new();
        }
        let recent =
            RobotId::team(self.heard.len()).zip(&self.heard).filter(|(_, (at, _))| now.since(*at) <= HEARING_TIMEOUT);
        recent
            .flat_map(|(robot, (at, heard))| {
                heard.iter().map(move |(of, age)| Hearing { robot, of: *of, age: *age + now.since(*at) })
            })
            .collect()
    }
}

/// Returns the identity of a datagram from its header: sender, incarnation, sequence number, and whether it was sent to
/// one host. Copies of a datagram have the same identity.
fn datagram(header: &Header) -> Datagram {
    (header.sender, header.incarnation, header.sequence, header.flags.has(Flags::DIRECT))
}

impl Core for Recorder {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Tap(frame) => self.tap(now, &frame, out),
            In::Received(message) => self.receive(now, &message, out),
            In::Truth(truth) => self.take_truth(now, &truth, out),
            In::Counts(host, counts) => {
                self.counts.insert(host, *counts);
            }
            In::Radio(link, counts) => {
                self.radio.insert(link, *counts);
            }
            In::Safety(robot, counts) => {
                self.safety.insert(robot, counts);
            }
            In::Reading(reading) => self.take_reading(now, &reading, out),
            In::Aborted(episode, reason) => self.aborted = Some((episode, reason)),
            In::Closing => out.push(Out::Closed(self.totals(now))),
            In::Arrived(to, frame) => {
                // A corrupted datagram does not count as received. A datagram published in time counts even if it
                // arrives after the episode.
                if let Ok(header) = codec::peek(&frame) {
                    self.listener.arrived(now, to, datagram(&header));
                }
            }
            In::Perceived(at, robot, heard) => {
                if self.follows_messages() {
                    self.heard[robot.index()] = (now, self.listener.stepped(now, at, &heard));
                }
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        None
    }

    fn wake(&mut self, _: Time, _: &mut Vec<Out>) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::latch::Latch;
    use crate::messages::wire::Mode;
    use crate::scenario::{Settings, build};

    fn recorder(judged: Judged) -> Recorder {
        let passage = build("passage", &Settings::of(2)).unwrap();
        let layouts = Layouts::of_scenario(&*passage, 1, 3);
        let config = Config {
            layouts,
            repeat: 4,
            scenario: Arc::clone(&passage),
            steps: Steps::Discarded,
            receivers: 1,
            judged,
            placed: false,
            wall_radius_m: 0.16,
            chassis: [Chassis::default(); 2].into(),
        };
        Recorder::new(config, 2)
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn say(recorder: &mut Recorder, ms: u64, episode: u32, phase: Phase) -> Vec<Out> {
        let round = Round { term: 1, episode };
        let tasks = recorder.config.layouts.episode(0).into();
        let mode = Wire::Mode(Mode { round, repeat: 4, phase, first: RobotId(0), tasks, latch: Latch::default() });
        let header = Header { flags: Flags::default(), team: 0, sender: HostId(0), incarnation: 1, sequence: 0 };
        let frame = codec::encode(&header, &mode).unwrap();
        let mut out = Vec::new();
        recorder.handle(at_ms(ms), In::Tap(frame), &mut out);
        out
    }

    /// Reports the position of one robot from a World of its own.
    fn see(recorder: &mut Recorder, ms: u64, robot: u16, position: Vec2) -> Vec<Out> {
        let (time, motion) = (at_ms(ms), Motion::at_rest(position));
        let (command, contacts) = (Vec2::zeros(), Contacts::default());
        let sample = Sample { robot: RobotId(robot), time, motion, heading: 0.0, yaw_rate: 0.0, command, contacts };
        let mut out = Vec::new();
        recorder.handle(time, In::Truth(Truth { time, samples: [sample].into() }), &mut out);
        out
    }

    /// Reports a reading, measured at its arrival.
    fn read(recorder: &mut Recorder, ms: u64, robot: u16, position: Vec2) -> Vec<Out> {
        let mut out = Vec::new();
        let reading = Reading::of_point(RobotId(robot), at_ms(ms).as_nanos(), Motion::at_rest(position));
        recorder.handle(at_ms(ms), In::Reading(reading), &mut out);
        out
    }

    fn verdicts(out: &[Out]) -> Vec<(u32, Verdict, Option<f64>)> {
        let result = |said: &Out| match said {
            Out::Episode(episode, _) => Some((episode.episode, episode.verdict, episode.makespan_s)),
            _ => None,
        };
        out.iter().filter_map(result).collect()
    }

    #[test]
    fn two_worlds_are_judged_as_one_and_makespan_counts_from_the_instruction_to_run() {
        let mut recorder = recorder(Judged::Truth);
        let goals: Vec<Vec2> = recorder.config.layouts.episode(0).iter().map(|task| task.goal).collect();
        say(&mut recorder, 100, 0, Phase::Resetting);
        say(&mut recorder, 1000, 0, Phase::Running);
        assert!(verdicts(&see(&mut recorder, 1050, 0, goals[0])).is_empty(), "half of the team says nothing");
        assert!(verdicts(&see(&mut recorder, 1050, 1, goals[1] - Vec2::new(1.0, 0.0))).is_empty());
        see(&mut recorder, 1100, 0, goals[0]);
        let out = see(&mut recorder, 1100, 1, goals[1]);
        assert_eq!(verdicts(&out), [(0, Verdict::Success, Some(0.1))]);
        assert!(matches!(&out[0], Out::Episode(episode, _) if episode.reset_s == 0.9 && episode.repeat == 4));
        assert!(verdicts(&say(&mut recorder, 1200, 1, Phase::Resetting)).is_empty(), "it has its result");
    }

    #[test]
    fn an_episode_that_is_left_behind_was_aborted_and_the_end_comes_once() {
        let mut recorder = recorder(Judged::Truth);
        say(&mut recorder, 0, 0, Phase::Resetting);
        let aborted = |episode| (episode, Verdict::Aborted, None);
        assert_eq!(verdicts(&say(&mut recorder, 100, 0, Phase::AbortRunning)), [aborted(0)]);
        assert!(verdicts(&say(&mut recorder, 200, 1, Phase::Running)).is_empty());
        let out = say(&mut recorder, 300, 3, Phase::EpisodesFinished);
        assert_eq!(verdicts(&out), [aborted(1), aborted(2)]);
        assert!(matches!(out.last(), Some(Out::Finished(totals)) if totals.messages == 4 && totals.end == at_ms(300)));
        assert!(say(&mut recorder, 400, 3, Phase::EpisodesFinished).is_empty());
    }

    #[test]
    fn readings_come_to_verdicts_and_what_nobody_has_seen_is_no_success() {
        let mut recorder = recorder(Judged::Readings);
        let tasks = recorder.config.layouts.episode(0).to_vec();
        let goals: Vec<Vec2> = tasks.iter().map(|task| task.goal).collect();
        say(&mut recorder, 0, 0, Phase::Running);
        read(&mut recorder, 50, 0, goals[0]);
        see(&mut recorder, 50, 0, goals[0]);
        assert!(verdicts(&see(&mut recorder, 50, 1, goals[1])).is_empty(), "true states are not judged");
        let out = read(&mut recorder, 100, 1, goals[1]);
        assert_eq!(verdicts(&out), [(0, Verdict::Success, Some(0.1))]);
        assert!(matches!(&out[0], Out::Episode(episode, _) if episode.judged == Judged::Readings));
        let goals: Vec<Vec2> = recorder.config.layouts.episode(1).iter().map(|task| task.goal).collect();
        say(&mut recorder, 1000, 1, Phase::Running);
        read(&mut recorder, 1050, 0, goals[0]);
        for ms in (1050..2100).step_by(50) {
            assert!(verdicts(&read(&mut recorder, ms, 1, goals[1] - Vec2::new(1.0, 0.0))).is_empty());
        }
        assert!(verdicts(&read(&mut recorder, 2200, 1, goals[1])).is_empty(), "robot 0 may still be seen in this step");
        let out = read(&mut recorder, 2250, 1, goals[1]);
        assert_eq!(verdicts(&out), [(1, Verdict::Unseen, None)], "robot 0 may have been anywhere");
        say(&mut recorder, 3000, 2, Phase::Running);
        assert_eq!(verdicts(&say(&mut recorder, 3900, 2, Phase::AbortRunning)), [(2, Verdict::Aborted, None)]);
    }

    #[test]
    fn robots_without_true_states_have_no_command_age() {
        let mut recorder = recorder(Judged::Readings);
        say(&mut recorder, 0, 0, Phase::Running);
        see(&mut recorder, 50, 0, Vec2::zeros());
        let out = say(&mut recorder, 5000, 3, Phase::EpisodesFinished);
        assert_eq!(verdicts(&out)[0], (0, Verdict::Unseen, None), "no reading has ever come");
        assert!(matches!(out.last(), Some(Out::Finished(totals)) if totals.oldest_command.is_none()));
    }
}
