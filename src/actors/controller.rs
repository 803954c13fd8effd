//! Controller: last stage before the motors of one robot. It also tracks the robot's progress in the episode.
//!
//! Its guard (`safety::guard`) checks every action and grants all motor commands. The Controller follows the
//! instructions of the state server, and reports the robot's progress and latch to it in heartbeats. When its host
//! shuts down, it stops the robot for good.

use crate::actor::Core;
use crate::messages::ids::RobotId;
use crate::messages::latch::Latch;
use crate::messages::local::{Action, Progress};
use crate::messages::place::Whereabouts;
use crate::messages::round::RoundFollower;
use crate::messages::wire::{Flight, Heartbeat, Marks, Mode, MotorCommand, Phase, Stop};
use crate::safety::filter;
use crate::safety::guard::{Decision, Granted, Guard, SafetyCounts};
use crate::safety::hardware::Permit;
use crate::scenario::Goals;
use crate::scenario::layout::Layouts;
use crate::time::{Span, Time};

/// Period at which a robot sends heartbeats (reports to the state server).
pub(crate) const HEARTBEAT_PERIOD: Span = Span::from_millis(200);

/// Input message of a Controller, the actor that passes one robot's actions through its guard to its motors.
#[derive(Clone, Debug)]
pub enum In {
    /// Action (desired velocity) from the robot's Agent.
    Action(Action),
    /// Notice that a new reading of the robot has arrived at its Cache.
    Fresh,
    /// Instruction of the state server: round and phase of the episode, and the emergency stop state.
    Mode(Mode),
    /// Emergency stop message: engage, re-arm or resume.
    Stop(Stop),
    /// Permission to move from the robot's Body on the same host; it depends on battery and temperature.
    Permit(Permit),
    /// State of the flight of a robot that flies, from its Body.
    Aloft(Flight),
    /// Whether the robot's pose is known to the host that measures it.
    Located(Whereabouts),
    /// The messages of another robot have begun to contradict the tracker.
    Suspect,
    /// The Controller's host is shutting down; the Controller stops the robot for good.
    Leave,
}

/// Output message of a Controller, the actor that passes one robot's actions through its guard to its motors.
#[derive(Clone, Debug)]
pub enum Out {
    /// Velocity command for the robot's Body.
    MotorCommand(MotorCommand),
    /// Heartbeat (phase of the robot and its emergency stop state) for the state server.
    Heartbeat(Heartbeat),
    /// Emergency stop latch that the Controller follows, for the host's Status.
    Follows(Latch),
    /// Numbers of times that the guard has stopped or slowed the robot; sent after a change, for telemetry and results.
    Counts(SafetyCounts),
}

/// Configuration of a Controller, the actor that passes one robot's actions through its guard to its motors.
#[derive(Clone, Debug)]
pub struct Config {
    /// Robot that the Controller is for.
    pub robot: RobotId,
    /// Configuration of the robot's guard, which limits its velocity for safety.
    pub guard: filter::Settings,
    /// Time after its arrival at the Body for which a motor command is valid.
    pub valid_for: Span,
    /// Time of the heartbeat within each period of heartbeats.
    pub phase: Span,
    /// Whether orders are signed where they end a stop or a hold.
    pub signed: bool,
    /// Marks of the robot's host, for its heartbeats; 0 in simulations.
    pub marks: Marks,
    /// To whom the goals of the scenario belong: arrival at one's own is for the rest of an episode.
    pub goals: Goals,
    /// Whether the robot flies: then it is driven only while its Body says that it is at its height.
    pub flies: bool,
}

/// Controller of one robot: an actor that passes the policy's actions through the robot's guard to its motors, and
/// reports the robot's progress to the state server.
#[derive(Debug)]
pub struct Controller {
    config: Config,
    guard: Guard,
    /// Arenas of the episodes, where these differ.
    layouts: Layouts,
    round: RoundFollower,
    /// Phase of the team in the last instruction.
    team: Phase,
    /// Phase of this robot, which it reports in heartbeats.
    own: Phase,
    /// Whether the host is shutting down.
    leaves: bool,
    /// Guard counts that were sent last.
    counts_sent: SafetyCounts,
    next_heartbeat: Time,
}

impl Controller {
    /// Creates a Controller that has received nothing yet.
    pub fn new(config: Config) -> Controller {
        let next_heartbeat = Time::ZERO + config.phase;
        Controller {
            guard: Guard::new(config.guard.clone()).with_signed_orders(config.signed).of_a_flight(config.flies),
            layouts: Layouts::default(),
            round: RoundFollower::default(),
            team: Phase::NeedReset,
            own: Phase::NeedReset,
            leaves: false,
            counts_sent: SafetyCounts::default(),
            next_heartbeat,
            config,
        }
    }

    /// Returns the Controller with the layouts of the trial: its guard keeps the robot from the obstacles of each
    /// episode.
    pub fn with_layouts(self, layouts: Layouts) -> Controller {
        Controller { layouts, ..self }
    }

    fn follow(&mut self, now: Time, mode: &Mode, out: &mut Vec<Out>) {
        // The latch is taken from every instruction, even one for other robots or of an earlier round.
        let changed = self.guard.learn_latch(mode.latch);
        self.latched(now, changed, out);
        if !self.round.admits(mode.round) {
            return;
        }
        // Any instruction shows that the server is alive. One for other robots may be outdated.
        self.guard.server_heard(now);
        if mode.task_of(self.config.robot).is_none() {
            return;
        }
        if (mode.round, mode.phase) == (self.round.round(), self.team) {
            return;
        }
        self.guard.new_instruction();
        if let Some(arena) = self.layouts.arena(mode.round.episode) {
            self.guard.enter(arena);
        }
        self.round.follow(mode.round);
        self.team = mode.phase;
        self.guard.runs((mode.phase == Phase::Running).then_some(now));
        self.own = match mode.phase {
            Phase::Resetting | Phase::Running | Phase::EpisodesFinished | Phase::Waiting => mode.phase,
            _ => Phase::NeedReset,
        };
        if !matches!(self.team, Phase::Resetting | Phase::Running) {
            self.halt(out);
        }
    }

    fn apply(&mut self, now: Time, action: &Action, out: &mut Vec<Out>) {
        let moving = matches!(self.team, Phase::Resetting | Phase::Running) && self.own != Phase::AbortRunning;
        let meant = (action.round, action.phase) == (self.round.round(), self.team);
        let stands = self.leaves || !self.guard.latch().is_clear();
        if stands {
            // Repeat the zero command in case one is lost.
            return self.give_up(out);
        }
        if !(moving && meant) {
            return;
        }
        match self.guard.decide(now, action) {
            Decision::Drive(granted) => {
                self.own = match (self.team, action.progress) {
                    (Phase::Resetting, Progress::Reached) => Phase::FinishedResetting,
                    (Phase::Resetting, Progress::Underway) => Phase::Resetting,
                    // Arrival latches for the rest of the episode, unless another robot may need the goal.
                    (_, Progress::Reached) => Phase::FinishedRunning,
                    (Phase::Running, Progress::Underway) if self.config.goals.are_unlabelled() => Phase::Running,
                    (_, Progress::Underway) => self.own,
                };
                self.command(granted, out);
            }
            Decision::Stop => self.halt(out),
            Decision::Abort => self.give_up(out),
        }
    }

    /// Acts on a changed latch: first stops the motors, then sends a heartbeat at once.
    fn latched(&mut self, now: Time, changed: bool, out: &mut Vec<Out>) {
        if changed {
            self.next_heartbeat = now;
            if !self.guard.latch().is_clear() {
                self.give_up(out);
            }
        }
    }

    /// Stops the robot, and aborts the episode if one is running. A reset continues once the cause is gone.
    fn give_up(&mut self, out: &mut Vec<Out>) {
        if matches!(self.own, Phase::Running | Phase::FinishedRunning) {
            self.own = Phase::AbortRunning;
        }
        self.halt(out);
    }

    fn halt(&mut self, out: &mut Vec<Out>) {
        let granted = self.guard.stop();
        self.command(granted, out);
    }

    fn command(&self, granted: Granted, out: &mut Vec<Out>) {
        let Config { robot, valid_for, .. } = self.config;
        out.push(Out::MotorCommand(MotorCommand { robot, velocity: granted.velocity(), valid_for }));
    }
}

impl Core for Controller {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Mode(mode) => self.follow(now, &mode, out),
            In::Action(action) => self.apply(now, &action, out),
            In::Fresh => self.guard.own_state(now),
            In::Stop(stop) => {
                let changed = self.guard.apply_stop(&stop);
                self.latched(now, changed, out);
                out.push(Out::Follows(self.guard.latch()));
            }
            In::Permit(permit) => {
                self.guard.hardware(permit);
                if permit == Permit::Withdrawn {
                    self.give_up(out);
                }
            }
            In::Aloft(flight) => {
                let off_height = flight != Flight::Flying;
                self.guard.set_off_height(off_height);
                if off_height {
                    self.give_up(out);
                }
            }
            In::Located(whereabouts) => {
                if self.guard.located(whereabouts) {
                    self.next_heartbeat = now;
                    self.give_up(out);
                }
            }
            In::Suspect => self.guard.suspect(),
            In::Leave => {
                self.leaves = true;
                self.give_up(out);
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        [Some(self.next_heartbeat), self.guard.wake_at()].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        match self.guard.wake(now) {
            None => {}
            Some(Decision::Abort) => self.give_up(out),
            Some(_) => self.halt(out),
        }
        if self.next_heartbeat <= now {
            let (robot, latch) = (self.config.robot, self.guard.latch());
            let beat = Heartbeat::new(robot, self.round.round(), self.own, latch);
            out.push(Out::Heartbeat(beat.of(self.config.marks)));
            out.push(Out::Follows(latch));
            let counts = self.guard.counts();
            if counts != self.counts_sent {
                self.counts_sent = counts;
                out.push(Out::Counts(counts));
            }
            self.next_heartbeat = now.next_on_grid(self.config.phase, HEARTBEAT_PERIOD);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::actors::cache::{self, Cache};
    use crate::estimation;
    use crate::hearing::{CommRange, Handling};
    use crate::messages::geometry::{Motion, Task, Vec2};
    use crate::messages::ids::HostId;
    use crate::messages::wire::Reading;
    use crate::messages::wire::Round;
    use crate::random::Seed;
    use crate::safety::{Clamp, Safety};

    /// Measured velocity of the robot in every action \[m/s\].
    const MEASURED: Vec2 = Vec2::new(0.5, 0.0);

    fn controller() -> Controller {
        clamping(Clamp::Training)
    }

    fn clamping(clamp: Clamp) -> Controller {
        Controller::new(Config {
            robot: RobotId(1),
            guard: filter::Settings {
                safety: Safety::emulated(),
                half_extent: Vec2::new(2.0, 3.0),
                walls: Default::default(),
                movers: Default::default(),
                limit_m_s: 1.5,
                clamp,
                period: Span::from_millis(50),
            },
            valid_for: Span::from_millis(200),
            phase: Span::ZERO,
            signed: false,
            marks: Marks::default(),
            goals: Goals::Labelled,
            flies: false,
        })
    }

    fn mode(episode: u32, phase: Phase) -> In {
        let task = Task { start: Vec2::zeros(), goal: Vec2::zeros() };
        let round = Round { term: 1, episode };
        In::Mode(Mode { round, repeat: 0, phase, first: RobotId(0), tasks: [task; 3].into(), latch: Latch::default() })
    }

    fn action(episode: u32, phase: Phase, x: f32, progress: Progress) -> In {
        let round = Round { term: 1, episode };
        let estimate = Motion { velocity: MEASURED, ..Motion::default() };
        let (robot, velocity, others) = (RobotId(1), Vec2::new(x, 0.0), Vec::new());
        In::Action(Action {
            robot,
            round,
            phase,
            due: Time::ZERO,
            velocity: Some(velocity),
            estimate,
            others,
            progress,
        })
    }

    fn commanded(controller: &mut Controller, input: In) -> Option<f32> {
        let mut out = Vec::new();
        controller.handle(Time::ZERO, input, &mut out);
        out.iter().find_map(|out| match out {
            Out::MotorCommand(command) => Some(command.velocity.x),
            Out::Heartbeat(_) | Out::Follows(_) | Out::Counts(_) => None,
        })
    }

    #[test]
    fn actions_are_limited_and_those_of_another_round_or_phase_are_ignored() {
        let mut controller = controller();
        assert_eq!(commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway)), None);
        commanded(&mut controller, mode(0, Phase::Running));
        assert_eq!(commanded(&mut controller, action(0, Phase::Running, 9.0, Progress::Underway)), Some(1.5));
        assert_eq!(commanded(&mut controller, action(1, Phase::Running, 1.0, Progress::Underway)), None);
        assert_eq!(commanded(&mut controller, action(0, Phase::Resetting, 1.0, Progress::Underway)), None);
    }

    #[test]
    fn a_robot_whose_pose_is_lost_stands_and_gives_up_its_episode_until_a_reading_arrives() {
        let mut controller = controller();
        commanded(&mut controller, mode(0, Phase::Running));
        assert_eq!(commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway)), Some(1.0));
        assert_eq!(commanded(&mut controller, In::Located(Whereabouts::Jumped)), Some(0.0), "at once");
        assert_eq!(
            (controller.own, controller.next_heartbeat),
            (Phase::AbortRunning, Time::ZERO),
            "and is said at once"
        );
        commanded(&mut controller, mode(1, Phase::Running));
        assert_eq!(commanded(&mut controller, action(1, Phase::Running, 1.0, Progress::Underway)), Some(0.0));
        commanded(&mut controller, mode(2, Phase::Running));
        commanded(&mut controller, In::Fresh);
        assert_eq!(commanded(&mut controller, action(2, Phase::Running, 1.0, Progress::Underway)), Some(1.0));
        assert_eq!(controller.guard.counts().jump, 1);
    }

    #[test]
    fn the_deployed_clamp_stays_near_the_measured_velocity_in_episodes_and_resets() {
        let limit = |wanted, measured| {
            let commanded = Clamp::Deployed.limit(Vec2::new(wanted, -wanted), Vec2::new(measured, -measured), 1.5);
            assert_eq!(commanded.x, -commanded.y, "each axis by itself");
            commanded.x
        };
        assert_eq!(limit(9.0, 0.5), 0.75, "a quarter of a metre a second up");
        assert_eq!(limit(-1.0, 0.5), 0.25, "and down");
        assert_eq!(limit(0.625, 0.5), 0.625, "what is near is commanded");
        assert_eq!(limit(9.0, 1.375), 1.5, "no faster than the limit");
        assert_eq!(limit(0.0, 1e5), 1.5, "whatever a sensor says");
        for phase in [Phase::Running, Phase::Resetting] {
            let mut controller = clamping(Clamp::Deployed);
            commanded(&mut controller, mode(0, phase));
            assert_eq!(commanded(&mut controller, action(0, phase, -1.0, Progress::Underway)), Some(0.25));
        }
    }

    #[test]
    fn an_output_that_is_no_velocity_stops_the_robot_for_the_episode() {
        let mut controller = controller();
        commanded(&mut controller, mode(0, Phase::Running));
        assert_eq!(commanded(&mut controller, action(0, Phase::Running, f32::NAN, Progress::Underway)), Some(0.0));
        assert_eq!(controller.own, Phase::AbortRunning);
        assert_eq!(commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway)), None);
        commanded(&mut controller, mode(1, Phase::Running));
        assert_eq!(commanded(&mut controller, action(1, Phase::Running, 1.0, Progress::Underway)), Some(1.0));
    }

    #[test]
    fn silence_of_the_state_server_stops_the_robot() {
        let mut controller = controller();
        commanded(&mut controller, mode(0, Phase::Running));
        let mut out = Vec::new();
        controller.wake(Time::ZERO + Span::from_secs(Safety::emulated().silence_s), &mut out);
        assert!(matches!(&out[0], Out::MotorCommand(command) if command.velocity == Vec2::zeros()));
        assert!(matches!(&out[1], Out::Heartbeat(beat) if beat.phase == Phase::AbortRunning));
        assert!(matches!(&out[3], Out::Counts(counts) if counts.silence == 1));
        assert_eq!(commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway)), None);
    }

    #[test]
    fn an_engaged_stop_stops_the_robot_at_once_is_told_at_once_and_holds_until_a_resume() {
        let mut controller = controller();
        commanded(&mut controller, mode(0, Phase::Running));
        let (mut out, half) = (Vec::new(), Time::ZERO + Span::from_millis(50));
        controller.wake(Time::ZERO, &mut out);
        out.clear();
        controller.handle(half, In::Stop(Stop::engage(HostId(9), Latch::default())), &mut out);
        assert!(matches!(&out[0], Out::MotorCommand(command) if command.velocity == Vec2::zeros()));
        assert!(matches!(&out[1], Out::Follows(latch) if latch.is_engaged()), "operators can be told at once");
        assert_eq!(controller.wake_at(), Some(half), "its heartbeat does not wait for its turn");
        controller.wake(half, &mut out);
        let told = |beat: &Heartbeat| beat.latch == Latch::engaged(1) && beat.phase == Phase::AbortRunning;
        assert!(matches!(&out[2], Out::Heartbeat(beat) if told(beat)));
        let go = || action(1, Phase::Running, 1.0, Progress::Underway);
        assert_eq!(commanded(&mut controller, mode(1, Phase::Running)), None, "a server that has not heard of it");
        assert_eq!(commanded(&mut controller, go()), Some(0.0));
        commanded(&mut controller, In::Stop(Stop { by: HostId(9), latch: Latch::held(1) }));
        assert_eq!(commanded(&mut controller, go()), Some(0.0), "that re-arm is not later");
        commanded(&mut controller, In::Stop(Stop::rearm(HostId::operator(9), Latch::engaged(1))));
        assert_eq!(commanded(&mut controller, go()), Some(0.0), "a re-arm alone moves nobody");
        commanded(&mut controller, In::Stop(Stop::resume(HostId(9), Latch::held(2))));
        assert_eq!(commanded(&mut controller, go()), Some(0.0), "nor does a resume that the server has not granted");
        commanded(&mut controller, knowing(Latch::clear(3), mode(1, Phase::Running)));
        assert_eq!(commanded(&mut controller, go()), None, "the episode was given up");
        commanded(&mut controller, mode(2, Phase::Running));
        assert_eq!(commanded(&mut controller, action(2, Phase::Running, 1.0, Progress::Underway)), Some(1.0));
    }

    #[test]
    fn a_host_that_leaves_stops_its_robot_for_good() {
        let mut controller = controller();
        commanded(&mut controller, mode(0, Phase::Running));
        assert_eq!(commanded(&mut controller, In::Leave), Some(0.0));
        commanded(&mut controller, mode(1, Phase::Running));
        assert_eq!(commanded(&mut controller, action(1, Phase::Running, 1.0, Progress::Underway)), Some(0.0));
    }

    #[test]
    fn a_flat_battery_gives_the_episode_up_and_stops_the_robot_while_it_lasts() {
        let mut controller = controller();
        commanded(&mut controller, mode(0, Phase::Running));
        let go = |episode| action(episode, Phase::Running, 1.0, Progress::Underway);
        assert_eq!(commanded(&mut controller, In::Permit(Permit::Unknown)), None);
        assert_eq!(commanded(&mut controller, go(0)), Some(1.0));
        assert_eq!(commanded(&mut controller, In::Permit(Permit::Withdrawn)), Some(0.0));
        assert_eq!((controller.own, controller.guard.counts().hardware), (Phase::AbortRunning, 1));
        commanded(&mut controller, mode(1, Phase::Running));
        assert_eq!(commanded(&mut controller, go(1)), Some(0.0));
        commanded(&mut controller, In::Permit(Permit::Granted));
        commanded(&mut controller, mode(2, Phase::Running));
        assert_eq!(commanded(&mut controller, go(2)), Some(1.0));
    }

    /// The instruction `mode` from a state server that knows this latch.
    fn knowing(latch: Latch, mode: In) -> In {
        let In::Mode(mode) = mode else { panic!("it is one") };
        In::Mode(Mode { latch, ..mode })
    }

    #[test]
    fn a_fresh_controller_learns_of_the_stop_from_the_first_instruction() {
        let mut controller = controller();
        commanded(&mut controller, knowing(Latch::engaged(4), mode(0, Phase::Running)));
        assert_eq!(commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway)), Some(0.0));
    }

    #[test]
    fn who_has_once_arrived_has_arrived() {
        let mut controller = controller();
        commanded(&mut controller, mode(0, Phase::Running));
        commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Reached));
        commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway));
        assert_eq!(controller.own, Phase::FinishedRunning);
        controller.config.goals = Goals::Unlabelled;
        commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway));
        assert_eq!(controller.own, Phase::Running, "another robot may need the goal");
    }

    /// Runs the cores of one robot, tick by tick: the same stamp keeps arriving, and the robot stops in time.
    #[test]
    fn a_reading_that_is_repeated_for_ever_is_no_estimate() {
        let (robot, round, period) = (RobotId(0), Round { term: 1, episode: 0 }, Span::from_millis(50));
        let (range, hold, handling) = (CommRange::fixed(2.0), Span::from_millis(200), Handling::Hold);
        let config = cache::Config {
            robot,
            period,
            phase: Span::ZERO,
            range,
            hold,
            handling,
            estimator: estimation::REGISTRY[0],
            sensor_delay: Span::ZERO,
            own_age: Span::from_millis(100),
            limit_m_s: 1.5,
            senses: 0,
        };
        let mut cache = Cache::new(config, Seed::of_run(0).stream("cache"));
        let (safety, half_extent, clamp) = (Safety::deployed(), Vec2::new(2.0, 3.0), Clamp::Training);
        let (walls, movers) = (Arc::default(), Arc::default());
        let guard = filter::Settings { safety, half_extent, walls, movers, limit_m_s: 1.5, clamp, period };
        let mut controller = Controller::new(Config {
            robot,
            guard,
            valid_for: Span::from_millis(200),
            phase: Span::ZERO,
            signed: false,
            marks: Marks::default(),
            goals: Goals::Labelled,
            flies: false,
        });
        let task = Task { start: Vec2::zeros(), goal: Vec2::x() };
        let (phase, tasks, latch) = (Phase::Running, [task].into(), Latch::default());
        let mode = Mode { round, repeat: 0, phase, first: robot, tasks, latch };
        controller.handle(Time::ZERO, In::Mode(mode), &mut Vec::new());
        let mut commands: Vec<(u64, f32)> = Vec::new();
        for at in 0..400 {
            let (now, mut known, mut said) = (Time::ZERO + Span::from_millis(at), Vec::new(), Vec::new());
            if at.is_multiple_of(20) {
                let reading = Reading::of_point(robot, 7, Motion::default());
                cache.handle(now, cache::In::Reading(reading), &mut known);
            }
            if cache.wake_at().is_some_and(|due| due <= now) {
                cache.wake(now, &mut known);
            }
            for known in known {
                let input = match known {
                    cache::Out::Fresh => In::Fresh,
                    cache::Out::Found(..) => In::Suspect,
                    cache::Out::Percept(percept) => In::Action(Action {
                        robot,
                        round,
                        phase,
                        due: percept.due,
                        velocity: Some(Vec2::x()),
                        estimate: percept.estimate,
                        others: Vec::new(),
                        progress: Progress::Underway,
                    }),
                };
                controller.handle(now, input, &mut said);
            }
            if controller.wake_at().is_some_and(|due| due <= now) {
                controller.wake(now, &mut said);
            }
            commands.extend(said.iter().filter_map(|said| match said {
                Out::MotorCommand(command) => Some((at, command.velocity.x)),
                _ => None,
            }));
        }
        assert_eq!(commands, [(0, 1.0), (50, 1.0), (100, 1.0), (101, 0.0)]);
    }
}
