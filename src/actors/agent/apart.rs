//! Agent whose policies are computed on a thread of their own, because a step may take long, fail or never end: the
//! part on the control thread, and the worker.
//!
//! The part on the control thread collects the percepts of a step, asks the worker, and passes its answer on. The
//! answer is an input of the host like a datagram, so that a record holds it and a replay does not compute it. Only one
//! step is asked for at a time. One without an answer at its deadline counts as none: its robots stand, the policies'
//! state is as before it, and an answer that comes later is dropped.

use std::collections::{BTreeMap, VecDeque};

use serde::{Deserialize, Serialize};

use super::{Agent, In, Out as AgentOut};
use crate::actor::Core;
use crate::edge::{Answering, Packet, Worker};
use crate::messages::ids::RobotId;
use crate::messages::local::{Action, Percept, Progress, Remembered};
use crate::messages::round::RoundFollower;
use crate::messages::wire::{Latent, Mode, Phase, Round};
use crate::time::{Span, Time};

/// Largest number of instructions that wait for the next step; the newest ones count. They are repeated several times a
/// second, so it is as much as comes while a worker hangs for a minute.
const MAX_MODES: usize = 256;

/// One step that the worker is asked for.
#[derive(Debug, Serialize, Deserialize)]
struct Request {
    /// Number of the step, from 1.
    number: u64,
    /// Time of the step on the host's clock.
    now: Time,
    /// Whether the step before counts as none, so that the policies' state is that before it.
    undo: bool,
    /// Instructions of the state server since the last step, each with the time of its arrival, in their order.
    modes: Vec<(Time, Mode)>,
    /// Percepts of the robots that take part in the step, in the order of their ids.
    percepts: Vec<Percept>,
}

/// Result of one step.
#[derive(Debug, Serialize, Deserialize)]
struct Answer {
    /// Number of the step.
    number: u64,
    actions: Vec<Action>,
    latents: Vec<Latent>,
    #[serde(default)]
    remembered: Vec<Remembered>,
}

/// Output message of the part of an Agent that is on the control thread.
#[derive(Clone, Debug)]
pub enum Out {
    /// Latent or action, as of any Agent.
    Agent(AgentOut),
    /// Packet for the worker: a step to compute.
    Ask(Packet),
}

/// Step that was asked for.
#[derive(Debug)]
struct Asked {
    /// Time of the step.
    at: Time,
    /// Time at which it counts as none.
    until: Time,
    round: Round,
    phase: Phase,
    percepts: Vec<Percept>,
}

/// Part of an Agent on the control thread, whose policies are computed by a worker.
#[derive(Debug)]
pub struct Apart {
    /// Longest wait of a joint step for the last percept.
    max_wait: Span,
    /// Longest times to an answer: from the step, and from the control tick.
    deadlines: [Span; 2],
    /// Newest percept of each robot of the Agent for the next step.
    percepts: BTreeMap<RobotId, Option<Percept>>,
    waiting_since: Option<Time>,
    /// Instructions since the last step that the worker was asked for, with the times of their arrival.
    modes: VecDeque<(Time, Mode)>,
    /// Round and phase that an Agent with these instructions follows.
    rounds: RoundFollower,
    phase: Phase,
    /// Number of the newest step that the worker was asked for.
    number: u64,
    /// Whether the worker has not answered the newest step yet.
    busy: bool,
    /// The newest step, until its answer or its deadline.
    asked: Option<Asked>,
    /// Whether the newest step counts as none.
    undo: bool,
    /// Number of steps that counted as none since the last answer in time.
    missed: u64,
}

impl Apart {
    /// Creates the part on the control thread of an Agent of `robots`. A joint step waits at most `max_wait` for late
    /// percepts. An answer is late that comes more than the first of `deadlines` after the step, or more than the
    /// second after its control tick was due.
    pub fn new(robots: &[RobotId], max_wait: Span, deadlines: [Span; 2]) -> Apart {
        Apart {
            max_wait,
            deadlines,
            percepts: robots.iter().map(|robot| (*robot, None)).collect(),
            waiting_since: None,
            modes: VecDeque::new(),
            rounds: RoundFollower::default(),
            phase: Phase::NeedReset,
            number: 0,
            busy: false,
            asked: None,
            undo: false,
            missed: 0,
        }
    }

    /// Asks the worker for a step with the percepts that have come. If it still computes the step before, this one
    /// counts as none.
    fn ask(&mut self, now: Time, out: &mut Vec<Out>) {
        self.waiting_since = None;
        let percepts: Vec<Percept> = self.percepts.values_mut().filter_map(Option::take).collect();
        if !matches!(self.phase, Phase::Resetting | Phase::Running) {
            return;
        }
        let (round, phase) = (self.rounds.round(), self.phase);
        let due = percepts.iter().map(|percept| percept.due).min().unwrap_or(now);
        let [of_step, of_tick] = self.deadlines;
        let until = (now + of_step).min(due + of_tick).max(now);
        let asked = Asked { at: now, until, round, phase, percepts };
        if self.busy {
            self.miss(&asked, out);
            return;
        }
        self.number += 1;
        let modes = std::mem::take(&mut self.modes).into();
        let undo = std::mem::take(&mut self.undo);
        let request = Request { number: self.number, now, undo, modes, percepts: asked.percepts.clone() };
        out.push(Out::Ask(packet(&request)));
        self.busy = true;
        self.asked = Some(asked);
    }

    /// Stops the robots of a step that counts as none.
    fn miss(&mut self, asked: &Asked, out: &mut Vec<Out>) {
        if self.missed == 0 {
            let robots: Vec<String> = asked.percepts.iter().map(|percept| percept.robot.to_string()).collect();
            let robots = robots.join(", ");
            tracing::error!(robots, "the policy has not answered in time; its robots stand until it does");
        }
        self.missed += 1;
        let stand = |percept: &Percept| Action {
            robot: percept.robot,
            round: asked.round,
            phase: asked.phase,
            due: percept.due,
            velocity: None,
            estimate: percept.estimate,
            others: Vec::new(),
            progress: Progress::Underway,
        };
        out.extend(asked.percepts.iter().map(stand).map(AgentOut::Action).map(Out::Agent));
    }

    /// Ends the step that the worker computes without an answer: it counts as none.
    fn ended(&mut self, out: &mut Vec<Out>) {
        self.busy = false;
        if let Some(asked) = self.asked.take() {
            self.undo = true;
            self.miss(&asked, out);
        }
    }

    fn follow(&mut self, now: Time, mode: Mode) {
        if self.rounds.admits(mode.round) {
            self.rounds.follow(mode.round);
            self.phase = mode.phase;
        }
        // Those that are not admitted, too: the Agent admits a round by what came before it.
        self.modes.push_back((now, mode));
        if self.modes.len() > MAX_MODES {
            self.modes.pop_front();
        }
    }

    fn answered(&mut self, now: Time, packet: &Packet, out: &mut Vec<Out>) {
        let answer: Answer = match rmp_serde::from_slice(packet) {
            Ok(answer) => answer,
            Err(error) => {
                tracing::error!(%error, "an answer of the policy cannot be read; its step counts as none");
                self.ended(out);
                return;
            }
        };
        if answer.number != self.number || !self.busy {
            return;
        }
        self.busy = false;
        // Without one it was late.
        let Some(asked) = self.asked.take() else { return };
        tracing::debug!(step = self.number, us = now.since(asked.at).as_nanos() / 1000, "the policy has answered");
        if self.missed > 0 {
            tracing::warn!(missed = self.missed, "the policy answers again");
            self.missed = 0;
        }
        // An answer from a record may be about robots of other Agents.
        let own = |robot: RobotId| self.percepts.contains_key(&robot);
        let actions = answer.actions.into_iter().filter(|action| own(action.robot)).map(AgentOut::Action);
        let latents = answer.latents.into_iter().filter(|latent| own(latent.robot)).map(AgentOut::Latent);
        // As of any Agent: actuation latency matters more.
        let remembered = answer.remembered.into_iter().filter(|said| own(said.robot)).map(AgentOut::Remembered);
        out.extend(actions.chain(latents).chain(remembered).map(Out::Agent));
    }
}

impl Core for Apart {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Mode(mode) => self.follow(now, mode),
            In::Percept(percept) => {
                let Some(slot) = self.percepts.get_mut(&percept.robot) else { return };
                *slot = Some(percept);
                if self.percepts.values().all(Option::is_some) {
                    self.ask(now, out);
                } else {
                    self.waiting_since.get_or_insert(now);
                }
            }
            In::Answer(packet) => self.answered(now, &packet, out),
            In::Ended => self.ended(out),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let joint = self.waiting_since.map(|since| since + self.max_wait);
        joint.into_iter().chain(self.asked.as_ref().map(|asked| asked.until)).min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.asked.as_ref().is_some_and(|asked| asked.until <= now) {
            let asked = self.asked.take().expect("it was just looked at");
            self.undo = true;
            self.miss(&asked, out);
        }
        if self.waiting_since.is_some_and(|since| since + self.max_wait <= now) {
            self.ask(now, out);
        }
    }
}

fn packet(content: &impl Serialize) -> Packet {
    rmp_serde::to_vec(content).expect("plain data can be encoded").into()
}

/// Computes one step of an Agent for the part on the control thread.
///
/// # Panics
/// If the packet is not a step of that part.
pub(super) fn answer(agent: &mut Agent, request: &Packet) -> Packet {
    let Request { number, now, undo, modes, percepts } =
        rmp_serde::from_slice(request).expect("the control thread of this process has made it");
    if undo {
        agent.undo();
    }
    let mut out = Vec::new();
    modes.into_iter().for_each(|(arrived, mode)| agent.handle(arrived, In::Mode(mode), &mut out));
    percepts.into_iter().for_each(|percept| agent.handle(now, In::Percept(percept), &mut out));
    if agent.wake_at().is_some() {
        // Some robots have no percept, and the step has waited for them.
        agent.wake(now, &mut out);
    }
    let (mut actions, mut latents, mut remembered) = (Vec::new(), Vec::new(), Vec::new());
    for out in out {
        match out {
            AgentOut::Action(action) => actions.push(action),
            AgentOut::Latent(latent) => latents.push(latent),
            AgentOut::Remembered(said) => remembered.push(said),
        }
    }
    packet(&Answer { number, actions, latents, remembered })
}

/// Returns the worker of the Agent that `make` returns on the worker's thread: it computes the Agent's policies.
pub fn worker(make: impl FnOnce() -> Agent + Send + 'static) -> Box<dyn Worker> {
    Box::new(Answering::new(move || {
        let mut agent = make();
        move |request: Packet| answer(&mut agent, &request)
    }))
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, Sender, channel};

    use super::super::RobotPolicies;
    use super::*;
    use crate::edge::{Gate, Running, start};
    use crate::hearing::CommRange;
    use crate::messages::geometry::{Motion, Task, Vec2};
    use crate::messages::latch::Latch;
    use crate::observation::{Bound, Dynamics, Observation};
    use crate::policy::{Interface, Neighbour, Policy};
    use crate::random::{Seed, Stream};
    use crate::scenario::{Settings, build};

    const PERIOD: Span = Span::from_millis(50);
    const DEADLINES: [Span; 2] = [Span::from_millis(25), Span::from_millis(40)];
    const ROUND: Round = Round { term: 1, episode: 0 };

    /// Test policy that counts its steps and moves at their number in cm/s. With a receiver, each step first waits for
    /// the test.
    struct Waiting {
        go_on: Option<Receiver<()>>,
        steps: f32,
    }

    impl Policy for Waiting {
        fn interface(&self) -> Interface {
            Interface { features: 1, radius_m: 2.0, period: PERIOD, limit_m_s: 1.0, hold: PERIOD * 4 }
        }
        fn reset(&mut self, _: u64) {
            self.steps = 0.0;
        }
        fn undo(&mut self) {
            self.steps -= 1.0;
        }
        fn encode(&mut self, _: &Observation, features: &mut [f32]) {
            features[0] = 1.0;
        }
        fn act(&mut self, _: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
            // At the end of the test nothing is said any more.
            let _ = self.go_on.as_ref().map(Receiver::recv);
            self.steps += 1.0;
            Vec2::new(self.steps / 100.0, 0.0)
        }
    }

    /// Agent of these robots, of which the last one waits for the test; the others never do.
    fn agent(robots: &[u16], go_on: Receiver<()>) -> Agent {
        let passage = build("passage", &Settings::of(3)).expect("it takes three robots");
        let mut go_on = Some(go_on);
        let last = robots.last().copied();
        let policies = robots.iter().map(|&robot| {
            let waits = if Some(robot) == last { go_on.take() } else { None };
            let stream = || Seed::of_run(0).stream("agent");
            RobotPolicies {
                robot: RobotId(robot),
                dynamics: Dynamics::default(),
                range: CommRange::fixed(2.0),
                point_ahead_m: 0.0,
                every: 1,
                channels: Bound::default(),
                run: Box::new(Waiting { go_on: waits, steps: 0.0 }),
                reset: Box::new(Waiting { go_on: None, steps: 0.0 }),
                actions: stream(),
                resets: stream(),
                ranges: stream(),
            }
        });
        Agent::new(passage, Span::from_millis(12), policies.collect())
    }

    /// Part on the control thread, with a worker that waits for the test in each step.
    struct Rig {
        apart: Apart,
        gate: Gate,
        go_on: Sender<()>,
        _running: Running,
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    impl Rig {
        fn new(robots: &[u16]) -> Rig {
            let (go_on, told) = channel();
            let of_worker = robots.to_vec();
            let worker = worker(move || agent(&of_worker, told));
            let (gate, running) = start(worker, "policy").expect("a thread");
            let ids: Vec<RobotId> = robots.iter().copied().map(RobotId).collect();
            let mut rig =
                Rig { apart: Apart::new(&ids, Span::from_millis(12), DEADLINES), gate, go_on, _running: running };
            rig.mode(0, ROUND, Phase::Running);
            rig
        }

        fn mode(&mut self, ms: u64, round: Round, phase: Phase) {
            let tasks = [Task { start: Vec2::new(0.0, -1.5), goal: Vec2::new(0.0, 1.5) }; 3].into();
            let mode = Mode { round, repeat: 0, phase, first: RobotId(0), tasks, latch: Latch::default() };
            self.apart.handle(at_ms(ms), In::Mode(mode), &mut Vec::new());
        }

        /// Passes outputs to the worker, and returns the speeds of the actions [cm/s]; NaN where a robot has to stand.
        fn speeds(&mut self, out: Vec<Out>) -> Vec<f32> {
            let mut speeds = Vec::new();
            for out in out {
                match out {
                    Out::Ask(packet) => self.gate.send(packet),
                    Out::Agent(AgentOut::Action(action)) => {
                        speeds.push(action.velocity.map_or(f32::NAN, |velocity| (velocity.x * 100.0).round()));
                    }
                    Out::Agent(AgentOut::Latent(_) | AgentOut::Remembered(_)) => {}
                }
            }
            speeds
        }

        fn percept(&mut self, ms: u64, robot: u16) -> Vec<f32> {
            let estimate = Motion::at_rest(Vec2::new(f32::from(robot), -1.5));
            let percept = Percept {
                robot: RobotId(robot),
                due: at_ms(ms),
                estimate,
                deviation_m: 0.0,
                heading: None,
                yaw_rate: None,
                heard: Vec::new(),
                measured: Vec::new(),
                sensed: Vec::new(),
            };
            let mut out = Vec::new();
            self.apart.handle(at_ms(ms), In::Percept(percept), &mut out);
            self.speeds(out)
        }

        fn wake(&mut self, ms: u64) -> Vec<f32> {
            assert!(self.apart.wake_at().is_some_and(|due| due <= at_ms(ms)), "it has something to do at {ms} ms");
            let mut out = Vec::new();
            self.apart.wake(at_ms(ms), &mut out);
            self.speeds(out)
        }

        /// Lets the worker finish a step, and returns what its answer makes of it at `ms`.
        fn answer(&mut self, ms: u64) -> Vec<f32> {
            self.go_on.send(()).expect("the worker waits for it");
            let mut packets = Vec::new();
            while packets.is_empty() {
                self.gate.take(|packet| packets.push(packet));
                std::thread::yield_now();
            }
            let mut out = Vec::new();
            packets.into_iter().for_each(|packet| self.apart.handle(at_ms(ms), In::Answer(packet), &mut out));
            self.speeds(out)
        }
    }

    #[test]
    fn an_answer_in_time_moves_the_robot_and_a_late_one_counts_as_none() {
        let mut rig = Rig::new(&[0]);
        assert!(rig.percept(100, 0).is_empty(), "it waits for the worker");
        assert_eq!(rig.answer(110), [1.0]);
        assert_eq!(rig.apart.wake_at(), None);
        rig.percept(150, 0);
        assert!(rig.wake(175)[0].is_nan(), "the robot stands at the deadline");
        assert!(rig.percept(200, 0)[0].is_nan(), "the worker is busy: this step is none, too");
        assert!(rig.answer(210).is_empty(), "it is dropped");
        rig.percept(250, 0);
        assert_eq!(rig.answer(260), [2.0], "the policy's state is that of the last step that counted");
        rig.percept(300, 0);
        assert_eq!(rig.answer(310), [3.0]);
    }

    #[test]
    fn a_policy_that_never_answers_leaves_its_robot_standing() {
        let mut rig = Rig::new(&[0]);
        rig.percept(100, 0);
        assert!(rig.wake(125)[0].is_nan());
        for step in 1..100 {
            assert!(rig.percept(100 + 50 * step, 0)[0].is_nan());
            assert_eq!(rig.apart.wake_at(), None);
        }
        assert_eq!(rig.gate.dropped(), (0, 0), "nothing has piled up");
    }

    #[test]
    fn a_joint_step_goes_on_without_a_robot_that_does_not_perceive() {
        let mut rig = Rig::new(&[0, 1, 2]);
        rig.percept(100, 0);
        assert!(rig.percept(101, 2).is_empty());
        assert!(rig.wake(112).is_empty(), "the step is asked for");
        assert_eq!(rig.answer(115), [1.0, 1.0]);
        (0..3).for_each(|robot| drop(rig.percept(150, robot)));
        assert_eq!(rig.answer(155), [2.0, 1.0, 2.0]);
    }

    #[test]
    fn nothing_is_asked_for_before_and_after_an_episode_and_answers_of_junk_are_dropped() {
        let mut rig = Rig::new(&[0]);
        let later = Round { episode: 1, ..ROUND };
        rig.mode(90, later, Phase::Waiting);
        assert!(rig.percept(100, 0).is_empty());
        assert_eq!((rig.apart.wake_at(), rig.apart.number), (None, 0));
        rig.mode(110, later, Phase::Running);
        rig.percept(150, 0);
        let mut out = Vec::new();
        rig.apart.handle(at_ms(151), In::Answer(b"junk"[..].into()), &mut out);
        assert!(rig.speeds(out)[0].is_nan(), "its step counts as none");
        for junk in [&b""[..], &[0xc1; 9], &[0x93, 1, 0x90]] {
            let mut out = Vec::new();
            rig.apart.handle(at_ms(152), In::Answer(junk.into()), &mut out);
            assert!(out.is_empty());
        }
        assert!(rig.answer(160).is_empty(), "the real answer is not waited for any more");
        rig.percept(200, 0);
        assert_eq!(rig.answer(210), [1.0], "and its step was taken back");
    }

    #[test]
    fn an_episode_that_is_repeated_in_its_round_begins_anew_although_no_step_was_asked_for_between() {
        let mut rig = Rig::new(&[0]);
        for (step, speed) in [(0, 1.0), (1, 2.0)] {
            rig.percept(100 + 50 * step, 0);
            assert_eq!(rig.answer(110 + 50 * step), [speed]);
        }
        rig.mode(200, ROUND, Phase::Waiting);
        rig.percept(210, 0);
        rig.mode(220, ROUND, Phase::Running);
        rig.percept(250, 0);
        assert_eq!(rig.answer(260), [1.0]);
    }

    #[test]
    fn an_instruction_of_an_implausible_round_changes_nothing() {
        let mut rig = Rig::new(&[0]);
        rig.mode(90, Round { term: 1 << 29, episode: 0 }, Phase::Waiting);
        rig.mode(95, ROUND, Phase::Running);
        rig.percept(100, 0);
        assert_eq!(rig.answer(110), [1.0]);
    }

    #[test]
    fn of_a_late_step_only_robots_that_took_part_are_taken_back() {
        let mut rig = Rig::new(&[0, 1]);
        (0..2).for_each(|robot| drop(rig.percept(100, robot)));
        assert_eq!(rig.answer(110), [1.0, 1.0]);
        // The other robot's percept does not come, and the step of this one is late.
        rig.percept(150, 1);
        rig.wake(162);
        assert!(rig.wake(187)[0].is_nan());
        assert!(rig.answer(190).is_empty());
        (0..2).for_each(|robot| drop(rig.percept(200, robot)));
        assert_eq!(rig.answer(210), [2.0, 2.0]);
    }

    #[test]
    fn answers_about_robots_of_other_agents_move_none() {
        let mut rig = Rig::new(&[0]);
        rig.percept(100, 0);
        let stranger = |robot| Action {
            robot: RobotId(robot),
            round: ROUND,
            phase: Phase::Running,
            due: at_ms(100),
            velocity: Some(Vec2::new(0.5, 0.0)),
            estimate: Motion::default(),
            others: Vec::new(),
            progress: Progress::Underway,
        };
        let forged = Answer {
            number: 1,
            actions: vec![stranger(7), stranger(u16::MAX)],
            latents: Vec::new(),
            remembered: Vec::new(),
        };
        let mut out = Vec::new();
        rig.apart.handle(at_ms(101), In::Answer(packet(&forged)), &mut out);
        assert!(out.is_empty(), "{out:?}");
    }
}
