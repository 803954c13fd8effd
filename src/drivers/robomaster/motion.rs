//! Choice of the next line that moves the wheels: the newest velocity, or standing.

use super::link::Hold;
use super::protocol::{ChassisSpeed, Line};
use super::times::STAND_PERIOD;
use crate::time::{Span, Time};

/// Motion of one robot: the newest velocity that is wanted, and the one that the robot was last told.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Shortest time between two velocities.
    pace: Span,
    /// Newest wanted velocity and the time of its expiry; `None` if the robot is to stand.
    wanted: Option<(ChassisSpeed, Time)>,
    /// Whether the newest velocity has still to be sent.
    fresh: bool,
    /// Whether the last line that moves wheels told the robot to stand.
    standing: bool,
    /// Time of the last line that moves wheels.
    told: Time,
}

impl Motion {
    /// Makes a standing robot, and the largest rate of velocities \[Hz\].
    pub fn new(most_hz: u8) -> Motion {
        let pace = Span::from_secs(1.0 / f64::from(most_hz));
        Motion { pace, wanted: None, fresh: false, standing: true, told: Time::ZERO }
    }

    /// Stands, without a line: at a new connection, whose set-up has that line.
    pub fn reset(&mut self) {
        (self.wanted, self.fresh, self.standing) = (None, false, true);
    }

    /// Sets the wanted velocity and the time of its expiry.
    pub fn want(&mut self, speed: ChassisSpeed, until: Time) {
        (self.wanted, self.fresh) = (Some((speed, until)), true);
    }

    /// Wants to stand. Returns whether the robot has to be told at once.
    pub fn stop(&mut self) -> bool {
        (self.wanted, self.fresh) = (None, false);
        !self.standing
    }

    /// Whether a newer velocity waits to be sent while the robot still follows an older one.
    pub fn waits(&self) -> bool {
        self.fresh && !self.standing
    }

    /// Time at which the wanted velocity expires; `None` if the robot is to stand.
    pub fn expires(&self) -> Option<Time> {
        self.wanted.map(|(_, until)| until)
    }

    /// Time of the next line, once no line is in flight; `None` if the robot already does what is wanted.
    pub fn due(&self) -> Option<Time> {
        match self.wanted {
            None => Some(self.told + STAND_PERIOD),
            Some(_) if !self.fresh => None,
            // From standing to moving there is nothing to wait for.
            Some(_) if self.standing => Some(self.told),
            Some(_) => Some(self.told + self.pace),
        }
    }

    /// Returns the next line. A velocity that has expired is standing.
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

    /// The robot is told a line.
    pub fn tell(&mut self, now: Time, line: &Line) {
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
        motion.tell(at(ms), &next.0);
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
