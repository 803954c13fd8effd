//! Controller: the last say over one robot's velocity, and its place in the episode.
//!
//! It limits what the policy wants, stops when the policy's output is no velocity or when the state server
//! has fallen silent, and tells the state server how far the robot has come.

use super::Core;
use crate::messages::geometry::{Vec2, is_finite};
use crate::messages::ids::RobotId;
use crate::messages::local::{Action, Progress};
use crate::messages::wire::{Heartbeat, Mode, MotorCommand, Phase, Round};
use crate::time::{Span, Time};
use crate::world::Clamp;

/// How often a robot tells where it stands.
pub const HEARTBEAT_PERIOD: Span = Span::from_millis(200);
/// How long the state server may be silent before a robot stops: ten of its periods.
pub const MAX_SILENCE: Span = Span::from_millis(1000);

/// What a Controller accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// What the policy wants.
    Action(Action),
    /// The state server's instruction.
    Mode(Mode),
}

/// What a Controller says.
#[derive(Clone, Debug)]
pub enum Out {
    /// To the robot's Body.
    MotorCommand(MotorCommand),
    /// To the StateServer.
    Heartbeat(Heartbeat),
}

/// How a Controller is set up.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// The robot.
    pub robot: RobotId,
    /// Largest speed along each axis \[m/s\].
    pub limit_m_s: f32,
    /// How the policy's velocity is limited, in episodes and in resets.
    pub clamp: Clamp,
    /// How long a command holds.
    pub valid_for: Span,
    /// When in each period it beats.
    pub phase: Span,
}

/// One robot's controller.
#[derive(Debug)]
pub struct Controller {
    config: Config,
    round: Round,
    /// What the team does.
    team: Phase,
    /// How far this robot has come in it.
    own: Phase,
    server_heard: Option<Time>,
    next_beat: Time,
}

impl Controller {
    /// A controller that has heard of nothing yet.
    pub fn new(config: Config) -> Controller {
        Controller {
            config,
            round: Round::default(),
            team: Phase::NeedReset,
            own: Phase::NeedReset,
            server_heard: None,
            next_beat: Time::ZERO + config.phase,
        }
    }

    fn follow(&mut self, now: Time, mode: &Mode, out: &mut Vec<Out>) {
        if mode.round < self.round || mode.task_of(self.config.robot).is_none() {
            return;
        }
        self.server_heard = Some(now);
        if (mode.round, mode.phase) == (self.round, self.team) {
            return;
        }
        (self.round, self.team) = (mode.round, mode.phase);
        self.own = match mode.phase {
            Phase::Resetting | Phase::Running | Phase::EpisodesFinished => mode.phase,
            _ => Phase::NeedReset,
        };
        if !matches!(self.team, Phase::Resetting | Phase::Running) {
            self.command(Vec2::zeros(), out);
        }
    }

    fn obey(&mut self, action: &Action, out: &mut Vec<Out>) {
        let moving = matches!(self.team, Phase::Resetting | Phase::Running) && self.own != Phase::AbortRunning;
        let meant = (action.round, action.phase) == (self.round, self.team);
        if !moving || !meant || self.server_heard.is_none() {
            return;
        }
        if !is_finite(action.velocity) {
            tracing::error!("the policy's output is no velocity; the robot stops and the episode is given up");
            self.own = Phase::AbortRunning;
            self.command(Vec2::zeros(), out);
            return;
        }
        self.own = match (self.team, action.progress) {
            (Phase::Resetting, Progress::Reached) => Phase::FinishedResetting,
            (Phase::Resetting, Progress::Underway) => Phase::Resetting,
            // Who has once arrived has arrived.
            (_, Progress::Reached) => Phase::FinishedRunning,
            (_, Progress::Underway) => self.own,
        };
        let Config { clamp, limit_m_s, .. } = self.config;
        self.command(clamp.limit(action.velocity, action.measured, limit_m_s), out);
    }

    fn command(&self, velocity: Vec2, out: &mut Vec<Out>) {
        let Config { robot, valid_for, .. } = self.config;
        out.push(Out::MotorCommand(MotorCommand { robot, velocity, valid_for }));
    }

    fn silence_ends(&self) -> Option<Time> {
        self.server_heard.map(|heard| heard + MAX_SILENCE)
    }
}

impl Core for Controller {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Mode(mode) => self.follow(now, &mode, out),
            In::Action(action) => self.obey(&action, out),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        [Some(self.next_beat), self.silence_ends()].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.silence_ends().is_some_and(|at| at <= now) {
            tracing::warn!("the state server has been silent for {MAX_SILENCE}; the robot stops");
            self.server_heard = None;
            if matches!(self.own, Phase::Running | Phase::FinishedRunning) {
                self.own = Phase::AbortRunning;
            }
            self.command(Vec2::zeros(), out);
        }
        if self.next_beat <= now {
            let Config { robot, phase, .. } = self.config;
            out.push(Out::Heartbeat(Heartbeat { robot, round: self.round, phase: self.own }));
            self.next_beat = now.next_on_grid(phase, HEARTBEAT_PERIOD);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Task;

    /// How the robot moves in every action \[m/s\].
    const MEASURED: Vec2 = Vec2::new(0.5, 0.0);

    fn controller() -> Controller {
        clamping(Clamp::Training)
    }

    fn clamping(clamp: Clamp) -> Controller {
        Controller::new(Config {
            robot: RobotId(1),
            limit_m_s: 1.5,
            clamp,
            valid_for: Span::from_millis(200),
            phase: Span::ZERO,
        })
    }

    fn mode(episode: u32, phase: Phase) -> In {
        let task = Task { start: Vec2::zeros(), goal: Vec2::zeros() };
        let round = Round { epoch: 1, episode };
        In::Mode(Mode { round, repeat: 0, phase, first: RobotId(0), tasks: [task; 3].into() })
    }

    fn action(episode: u32, phase: Phase, x: f32, progress: Progress) -> In {
        let round = Round { epoch: 1, episode };
        let (velocity, measured) = (Vec2::new(x, 0.0), MEASURED);
        In::Action(Action { robot: RobotId(1), round, phase, velocity, measured, progress })
    }

    fn commanded(controller: &mut Controller, input: In) -> Option<f32> {
        let mut out = Vec::new();
        controller.handle(Time::ZERO, input, &mut out);
        out.iter().find_map(|said| match said {
            Out::MotorCommand(command) => Some(command.velocity.x),
            Out::Heartbeat(_) => None,
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
        controller.wake(Time::ZERO + MAX_SILENCE, &mut out);
        assert!(matches!(&out[0], Out::MotorCommand(command) if command.velocity == Vec2::zeros()));
        assert!(matches!(&out[1], Out::Heartbeat(beat) if beat.phase == Phase::AbortRunning));
        assert_eq!(commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway)), None);
    }

    #[test]
    fn who_has_once_arrived_has_arrived() {
        let mut controller = controller();
        commanded(&mut controller, mode(0, Phase::Running));
        commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Reached));
        commanded(&mut controller, action(0, Phase::Running, 1.0, Progress::Underway));
        assert_eq!(controller.own, Phase::FinishedRunning);
    }
}
