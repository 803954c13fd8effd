//! Body: one robot's motors, as its driver reaches them. It lives where they hang: on the robot, or beside the World
//! that simulates it.
//!
//! A Body stops its motors when the last command's validity lapses, whichever actor has died upstream, and follows the
//! emergency stop by itself: a command that is released late drives nobody. Nothing bypasses it.

use crate::actor::Core;
use crate::drivers::{self, Driver};
use crate::messages::geometry::{Pose, Vec2};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::{Latch, LatchFollower};
use crate::messages::local::Drive;
use crate::messages::wire::{Health, MotorCommand, Reading, Stop};
use crate::time::{Span, Time};

/// How often a Body tells a state server that knows less of the emergency stop than it does.
const CORRECTION_PERIOD: Span = Span::from_millis(200);

/// What a Body accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// What its motors are to do.
    MotorCommand(MotorCommand),
    /// Where it was measured, for a driver that has to know its heading.
    Reading(Reading),
    /// Something that its driver's worker has said.
    Packet(Box<[u8]>),
    /// Its driver's worker has ended.
    WorkerEnded,
    /// The emergency stop, engaged or taken back.
    Stop(Stop),
    /// The latch as the state server repeats it.
    Latch(Latch),
    /// Its host is told to end.
    Leave,
}

/// What a Body says.
#[derive(Clone, Debug)]
pub enum Out {
    /// To its World.
    Drive(Drive),
    /// To its driver's worker.
    Tell(Box<[u8]>),
    /// To the host's Status: how the robot is, and what is left of its battery \[%\].
    Condition(Health, Option<u8>),
    /// To the host's Status: the latch that it follows.
    Follows(Latch),
    /// To everyone: the state server has forgotten a stop.
    Stop(Stop),
}

/// One robot's body.
pub struct Body {
    robot: RobotId,
    /// The host that it lives on.
    host: HostId,
    driver: Box<dyn Driver>,
    said: Vec<drivers::Out>,
    /// Where the robot was measured last.
    pose: Option<Pose>,
    /// What could not be understood of the driver's worker so far.
    refused: u64,
    /// When the command in force lapses.
    lapses: Option<Time>,
    latch: LatchFollower,
    /// When a state server was last corrected.
    corrected: Option<Time>,
    /// Whether its host is about to end.
    leaves: bool,
}

impl Body {
    /// A body at rest, driven by this driver.
    pub fn new((host, robot): (HostId, RobotId), driver: Box<dyn Driver>) -> Body {
        Body {
            robot,
            host,
            driver,
            said: Vec::new(),
            pose: None,
            refused: 0,
            lapses: None,
            latch: LatchFollower::default(),
            corrected: None,
            leaves: false,
        }
    }

    /// Whether its motors may turn: the state server was heard, no stop is engaged or held, and its host stays.
    fn may_move(&self) -> bool {
        self.latch.is_informed() && self.latch.latch().is_clear() && !self.leaves
    }

    fn obey(&mut self, now: Time, command: &MotorCommand, out: &mut Vec<Out>) {
        // No faster than the robot can, in the same direction.
        let most = self.driver.limits().speed_m_s;
        let velocity = if self.may_move() { command.velocity.cap_magnitude(most) } else { Vec2::zeros() };
        let until = now + command.valid_for;
        self.lapses = Some(until);
        self.drive(now, Drive { robot: self.robot, velocity, until }, out);
    }

    fn stand(&mut self, now: Time, out: &mut Vec<Out>) {
        self.lapses = None;
        self.drive(now, Drive { robot: self.robot, velocity: Vec2::zeros(), until: now }, out);
    }

    fn drive(&mut self, now: Time, drive: Drive, out: &mut Vec<Out>) {
        self.driver.drive(now, &drive, self.pose.as_ref(), &mut self.said);
        self.pass_on(out);
    }

    fn pass_on(&mut self, out: &mut Vec<Out>) {
        for said in self.said.drain(..) {
            match said {
                drivers::Out::Drive(drive) => out.push(Out::Drive(drive)),
                drivers::Out::Tell(packet) => out.push(Out::Tell(packet)),
                drivers::Out::Condition(health, battery) => out.push(Out::Condition(health, battery)),
                drivers::Out::Refused(why) => {
                    self.refused += 1;
                    // The first, and then less and less often: a broken robot says nothing else.
                    if self.refused.is_power_of_two() {
                        tracing::warn!(refused = self.refused, "what the driver's worker says is refused: {why}");
                    }
                }
            }
        }
    }

    fn latched(&mut self, now: Time, changed: bool, out: &mut Vec<Out>) {
        if changed && !self.may_move() {
            self.stand(now, out);
        }
    }

    /// A state server that was started afresh may know less than this body; a hold that only bodies remember holds.
    fn correct(&mut self, now: Time, said: Latch, out: &mut Vec<Out>) {
        let own = self.latch.latch();
        let due = self.corrected.is_none_or(|at| now.since(at) >= CORRECTION_PERIOD);
        if !own.is_clear() && own > said && due {
            self.corrected = Some(now);
            out.push(Out::Stop(Stop { by: self.host, latch: own }));
        }
    }
}

impl Core for Body {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::MotorCommand(command) => self.obey(now, &command, out),
            In::Reading(reading) => self.pose = Some(reading.pose),
            In::WorkerEnded => {
                tracing::error!(
                    "the driver of {} has ended: it cannot be driven any more; restart the host",
                    self.robot
                );
                out.push(Out::Condition(Health::Silent, None));
            }
            In::Packet(packet) => {
                self.driver.told(now, &packet, &mut self.said);
                self.pass_on(out);
            }
            In::Stop(stop) => {
                let changed = self.latch.apply(stop.latch);
                self.latched(now, changed, out);
                out.push(Out::Follows(self.latch.latch()));
            }
            In::Latch(said) => {
                let changed = self.latch.update(said);
                self.latched(now, changed, out);
                self.correct(now, said, out);
                if changed {
                    out.push(Out::Follows(self.latch.latch()));
                }
            }
            In::Leave => {
                self.leaves = true;
                self.stand(now, out);
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        self.lapses
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.lapses.is_some_and(|lapses| lapses <= now) {
            self.stand(now, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drivers::simulated::Simulated;

    fn body() -> Body {
        let mut body = Body::new((HostId(3), RobotId(0)), Box::new(Simulated));
        body.handle(Time::ZERO, In::Latch(Latch::default()), &mut Vec::new());
        body
    }

    fn command(x: f32) -> In {
        let velocity = Vec2::new(x, 0.0);
        In::MotorCommand(MotorCommand { robot: RobotId(0), velocity, valid_for: Span::from_millis(200) })
    }

    fn handle(body: &mut Body, ms: u64, input: In) -> Vec<Out> {
        let mut out = Vec::new();
        body.handle(Time::ZERO + Span::from_millis(ms), input, &mut out);
        out
    }

    /// How fast it is driven by a command of 1 m/s.
    fn driven(body: &mut Body, ms: u64) -> f32 {
        let out = handle(body, ms, command(1.0));
        let [Out::Drive(drive)] = &out[..] else { panic!("{out:?}") };
        drive.velocity.x
    }

    #[test]
    fn a_command_that_is_released_after_a_stop_drives_nobody_until_a_resume() {
        let mut body = body();
        assert_eq!(driven(&mut body, 0), 1.0);
        let out = handle(&mut body, 10, In::Stop(Stop::engage(HostId(9), Latch::default())));
        assert!(matches!(&out[0], Out::Drive(drive) if drive.velocity == Vec2::zeros()), "at once");
        assert!(matches!(&out[1], Out::Follows(latch) if latch.is_engaged()));
        assert_eq!(driven(&mut body, 45_000), 0.0);
        handle(&mut body, 45_010, In::Stop(Stop::rearm(HostId(9), Latch::engaged(1))));
        assert_eq!(driven(&mut body, 45_020), 0.0, "held");
        handle(&mut body, 45_030, In::Latch(Latch::clear(3)));
        assert_eq!(driven(&mut body, 45_040), 1.0);
    }

    #[test]
    fn a_fresh_body_moves_nothing_before_the_state_server_is_heard() {
        let mut body = Body::new((HostId(3), RobotId(0)), Box::new(Simulated));
        assert_eq!(driven(&mut body, 0), 0.0);
        handle(&mut body, 10, In::Latch(Latch::default()));
        assert_eq!(driven(&mut body, 20), 1.0);
        handle(&mut body, 30, In::Leave);
        assert_eq!(driven(&mut body, 40), 0.0, "its host is about to end");
    }

    #[test]
    fn a_state_server_that_has_forgotten_a_hold_is_told() {
        let mut body = body();
        handle(&mut body, 0, In::Latch(Latch::held(2)));
        let told = |out: &[Out]| out.iter().any(|said| matches!(said, Out::Stop(s) if s.latch == Latch::held(2)));
        assert!(told(&handle(&mut body, 100, In::Latch(Latch::default()))));
        assert!(!told(&handle(&mut body, 200, In::Latch(Latch::default()))), "not with every instruction");
        assert!(told(&handle(&mut body, 300, In::Latch(Latch::default()))));
        assert!(!told(&handle(&mut body, 600, In::Latch(Latch::held(2)))), "it knows");
    }

    #[test]
    fn the_motors_stop_when_the_command_lapses() {
        let mut body = body();
        let mut out = Vec::new();
        body.handle(Time::ZERO, command(1.0), &mut out);
        body.handle(Time::ZERO + Span::from_millis(50), command(0.5), &mut out);
        let lapse = Time::ZERO + Span::from_millis(250);
        assert_eq!(body.wake_at(), Some(lapse), "the newest command counts");
        body.wake(lapse, &mut out);
        assert!(matches!(out[2], Out::Drive(drive) if drive.velocity == Vec2::zeros()));
        assert_eq!(body.wake_at(), None);
    }
}
