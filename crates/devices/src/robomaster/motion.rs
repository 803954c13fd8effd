//! Choice of the next line (command in the robot's text protocol) that moves the wheels: the newest velocity, or stand.

use super::link::Hold;
use super::protocol::{ChassisSpeed, Line};
use super::times::STAND_PERIOD;
use murmurate::time::{Span, Time};

/// Motion of one robot: the newest wanted velocity, and whether the last line sent told the robot to move or to stand.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Shortest time between two velocities that are sent to the robot.
    pace: Span,
    /// Newest wanted velocity and the time of its expiry; `None` if the robot is to stand.
    wanted: Option<(ChassisSpeed, Time)>,
    /// Whether the newest wanted velocity has not been sent to the robot yet.
    fresh: bool,
    /// Whether the last line that moves wheels told the robot to stand.
    standing: bool,
    /// Time at which the last line that moves wheels (a velocity or a stand command) was sent.
    told: Time,
}

impl Motion {
    /// Creates the motion of a standing robot. `most_hz` is the largest rate at which velocities are sent \[Hz\].
    pub fn new(most_hz: u8) -> Motion {
        let pace = Span::from_secs(1.0 / f64::from(most_hz));
        Motion { pace, wanted: None, fresh: false, standing: true, told: Time::ZERO }
    }

    /// Returns to the state of a standing robot without a line to send. For a new connection, whose set-up itself has a
    /// stand command.
    pub fn reset(&mut self) {
        (self.wanted, self.fresh, self.standing) = (None, false, true);
    }

    /// Sets the wanted velocity of the robot, and `until`, the time of its expiry.
    pub fn want(&mut self, speed: ChassisSpeed, until: Time) {
        (self.wanted, self.fresh) = (Some((speed, until)), true);
    }

    /// Discards the wanted velocity, so that the robot is to stand. Returns whether it was last told to move, so that a
    /// stand command has to be sent at once.
    pub fn stop(&mut self) -> bool {
        (self.wanted, self.fresh) = (None, false);
        !self.standing
    }

    /// Whether a newer velocity waits to be sent while the robot still follows an older one.
    pub fn waits(&self) -> bool {
        self.fresh && !self.standing
    }

    /// Returns the time at which the wanted velocity expires; `None` if the robot is to stand.
    pub fn expires(&self) -> Option<Time> {
        self.wanted.map(|(_, until)| until)
    }

    /// Returns the time at which the next line that moves wheels is to be sent, provided that the robot has answered
    /// the last line; `None` if the wanted velocity was already sent.
    pub fn due(&self) -> Option<Time> {
        match self.wanted {
            None => Some(self.told + STAND_PERIOD),
            Some(_) if !self.fresh => None,
            // From standing to moving there is nothing to wait for.
            Some(_) if self.standing => Some(self.told),
            Some(_) => Some(self.told + self.pace),
        }
    }

    /// Returns the next line to send: the wanted velocity, or a stand command if no velocity is wanted or it has
    /// expired at `now`. The [`Hold`] says how long the worker lets the robot move after the line.
    pub fn next(&mut self, now: Time) -> (Line, Hold) {
        match self.wanted {
            Some((speed, until)) if until > now => {
                self.fresh = false;
                (Line::Speed(speed), Hold::For(until.since(now)))
            }
            _ => {
                self.stop();
                (Line::Stand, Hold::Standing)
            }
        }
    }

    /// Stores that `line` was sent to the robot at `now`. Lines that do not move wheels have no effect.
    pub fn sent(&mut self, now: Time, line: &Line) {
        if matches!(line, Line::Speed(_) | Line::Stand) {
            self.told = now;
            self.standing = *line == Line::Stand;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEED: ChassisSpeed = ChassisSpeed { x: 0.5, y: 0.0, z: 0.0 };

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Tells the next line, and returns it.
    fn tell(motion: &mut Motion, ms: u64) -> (Line, Hold) {
        let next = motion.next(at(ms));
        motion.sent(at(ms), &next.0);
        next
    }

    #[test]
    fn velocities_are_paced_and_standing_is_repeated() {
        let mut motion = Motion::new(20);
        assert_eq!(motion.due(), Some(at(60)));
        motion.want(SPEED, at(300));
        assert_eq!(motion.due(), Some(at(0)), "at once from standing");
        assert_eq!(tell(&mut motion, 100), (Line::Speed(SPEED), Hold::For(Span::from_millis(200))));
        assert_eq!((motion.due(), motion.waits()), (None, false));
        motion.want(SPEED, at(320));
        assert_eq!((motion.due(), motion.waits()), (Some(at(150)), true));
        assert!(motion.stop(), "it has to be told");
        assert_eq!(tell(&mut motion, 130), (Line::Stand, Hold::Standing));
        assert!(!motion.stop(), "it stands");
        assert_eq!(motion.due(), Some(at(190)));
    }

    #[test]
    fn an_expired_velocity_is_never_told() {
        let mut motion = Motion::new(20);
        motion.want(SPEED, at(200));
        assert_eq!(tell(&mut motion, 200), (Line::Stand, Hold::Standing));
        assert_eq!(motion.expires(), None);
    }
}
