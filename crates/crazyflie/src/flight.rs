//! Flight of a Crazyflie: taking off and landing by the robot's high-level commander, with the change between it and
//! the low-level setpoints, which have priority in the firmware until they are ended.

use murmurate::messages::wire::Flight;
use murmurate::time::{Span, Time};

use crate::packet::Packet;
use crate::requests;

/// Period at which an order to the high-level commander is repeated that the robot has not followed yet.
const REPEAT: Span = Span::from_millis(100);
/// Time for which the end of the setpoints and the landing are repeated in any case: firmware that does not say which
/// commander flies may have lost some of them.
const INSIST: Span = Span::from_millis(500);
/// Height above the one of the order's time from which on the robot has left the ground, or is on its way down \[m\].
const MOVED_M: f32 = 0.05;
/// Height below which a robot that has landed stands \[m\]: the estimate's error near the ground.
const GROUND_M: f32 = 0.1;
/// Distance from its height at which a robot has risen \[m\].
const ARRIVED_M: f32 = 0.1;
/// Time after which a robot that has not left the ground does not rise.
const STUCK: Span = Span::from_millis(2000);
/// Time after the planned end of a rise or a landing for which the robot may still be on its way.
const LATE: Span = Span::from_millis(1500);
/// Time for which the supervisor has to say that the robot does not fly, for it to be on the ground.
const DOWN: Span = Span::from_millis(300);
/// Shortest time that is planned for a rise or a landing \[s\].
const LEAST_S: f32 = 1.0;

/// State of the robot, as far as it is known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// Height by its estimate \[m\]; `None` before the first.
    pub height_m: Option<f32>,
    /// Whether its supervisor sees it fly; `None` before it is heard.
    pub flies: Option<bool>,
    /// Whether the high-level commander flies it; false if that is unknown.
    pub led: bool,
    /// Whether nothing was heard of it for long.
    pub silent: bool,
}

/// Course of a flight.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Course {
    Grounded,
    /// Rises, since a time, from a height \[m\]; whether it has left the ground.
    Rising {
        since: Time,
        from_m: f32,
        left: bool,
    },
    Flying,
    /// Lands, since a time, from a height \[m\].
    Landing {
        since: Time,
        from_m: f32,
    },
}

/// Flight of one robot.
#[derive(Clone, Debug)]
pub struct Flights {
    course: Course,
    /// Speed of rising and landing \[m/s\].
    speed_m_s: f32,
    /// Height at which the robot flies \[m\].
    pub height_m: f32,
    /// Time of the last order to the high-level commander.
    ordered: Option<Time>,
    /// Time since which the supervisor says that the robot does not fly.
    down: Option<Time>,
    /// State that was reported last.
    told: Option<Flight>,
}

impl Flights {
    /// Makes the flight of a robot of which nothing is known, which rises and lands at a speed \[m/s\].
    pub fn new(speed_m_s: f32) -> Flights {
        Flights { course: Course::Grounded, speed_m_s, height_m: 0.0, ordered: None, down: None, told: None }
    }

    /// Returns the state of the flight.
    pub fn state(&self) -> Flight {
        match self.course {
            Course::Grounded => Flight::Grounded,
            Course::Rising { .. } => Flight::Rising,
            Course::Flying => Flight::Flying,
            Course::Landing { .. } => Flight::Landing,
        }
    }

    /// Returns the state of the flight if it has changed since it was taken last.
    pub fn news(&mut self) -> Option<Flight> {
        let state = self.state();
        (self.told.replace(state) != Some(state)).then_some(state)
    }

    /// Makes the state be reported again.
    pub fn tell(&mut self) {
        self.told = None;
    }

    /// Time that a landing from where the robot is takes \[s\].
    pub fn landing_s(&self, seen: &Seen) -> f32 {
        (seen.height_m.unwrap_or(self.height_m).max(0.0) / self.speed_m_s).max(LEAST_S)
    }

    fn rising_s(&self) -> f32 {
        (self.height_m / self.speed_m_s).max(LEAST_S)
    }

    /// Begins to rise to a height \[m\], if the robot is on the ground.
    pub fn rise(&mut self, now: Time, height_m: f32, seen: &Seen) {
        if self.course == Course::Grounded {
            self.height_m = height_m;
            self.course = Course::Rising { since: now, from_m: seen.height_m.unwrap_or(0.0), left: false };
            (self.ordered, self.down) = (None, None);
        }
    }

    /// Begins to land, if the robot is in the air.
    pub fn land(&mut self, now: Time, seen: &Seen) {
        if matches!(self.course, Course::Rising { .. } | Course::Flying) {
            let from_m = seen.height_m.unwrap_or(self.height_m);
            (self.course, self.ordered) = (Course::Landing { since: now, from_m }, None);
        }
    }

    /// Takes note that the motors were cut.
    pub fn cut(&mut self) {
        (self.course, self.ordered) = (Course::Grounded, None);
    }

    /// Takes note of a robot that was found in the air, which lands.
    pub fn found(&mut self, now: Time, seen: &Seen) {
        if self.course == Course::Grounded && seen.flies == Some(true) && seen.height_m > Some(GROUND_M) {
            self.course = Course::Flying;
            self.land(now, seen);
        }
    }

    /// Returns the orders to the high-level commander that are due at `now`, by what was `seen`.
    pub fn due(&mut self, now: Time, seen: &Seen) -> Vec<Packet> {
        self.down = (seen.flies == Some(false)).then(|| self.down.unwrap_or(now));
        let down = self.down.is_some_and(|since| now.since(since) >= DOWN);
        let height_m = seen.height_m.unwrap_or(0.0);
        // It may have been switched off and on: then setpoints would make it take off from the ground.
        if seen.silent {
            self.land(now, seen);
        }
        match self.course {
            Course::Grounded => Vec::new(),
            Course::Rising { since, from_m, left } => {
                let left = left || height_m > from_m + MOVED_M || seen.flies == Some(true);
                self.course = Course::Rising { since, from_m, left };
                self.rises(now, since, left, down, height_m)
            }
            Course::Flying if down && height_m < GROUND_M => {
                self.course = Course::Grounded;
                vec![requests::motors_off()]
            }
            Course::Flying => Vec::new(),
            Course::Landing { since, from_m } => self.lands(now, (since, from_m), down, seen),
        }
    }

    fn rises(&mut self, now: Time, since: Time, left: bool, down: bool, height_m: f32) -> Vec<Packet> {
        let planned = Span::from_secs(f64::from(self.rising_s()));
        let age = now.since(since);
        if !left && age >= STUCK {
            tracing::warn!("it was told to take off, and has not left the ground");
            self.course = Course::Grounded;
            return vec![requests::motors_off()];
        }
        // It has come down again by itself.
        if left && down && height_m < GROUND_M && age >= STUCK {
            self.course = Course::Grounded;
            return vec![requests::motors_off()];
        }
        let arrived = age >= planned && (self.height_m - height_m).abs() < ARRIVED_M;
        if left && (arrived || (age >= planned + LATE && height_m > GROUND_M)) {
            self.course = Course::Flying;
            return Vec::new();
        }
        if left || !self.is_due(now) {
            return Vec::new();
        }
        vec![requests::end_setpoints(), requests::take_off(self.height_m, self.rising_s())]
    }

    fn lands(&mut self, now: Time, (since, from_m): (Time, f32), down: bool, seen: &Seen) -> Vec<Packet> {
        let planned = Span::from_secs(f64::from((from_m.max(0.0) / self.speed_m_s).max(LEAST_S)));
        let age = now.since(since);
        let low = seen.height_m.is_none_or(|height_m| height_m < GROUND_M);
        // Without its supervisor its state is unknown: then it still lands.
        let stands = seen.flies.is_some() && low && age >= planned + LATE;
        if (down && age >= DOWN) || stands {
            self.course = Course::Grounded;
            return vec![requests::motors_off(); 3];
        }
        let follows = seen.led || seen.height_m.is_some_and(|height_m| height_m < from_m - MOVED_M);
        let again = age < INSIST || !follows || age >= planned + LATE;
        if !again || !self.is_due(now) {
            return Vec::new();
        }
        vec![requests::end_setpoints(), requests::land(self.landing_s(seen))]
    }

    /// Whether an order may be repeated at `now`, which then is its time.
    fn is_due(&mut self, now: Time) -> bool {
        let due = self.ordered.is_none_or(|at| now.since(at) >= REPEAT);
        if due {
            self.ordered = Some(now);
        }
        due
    }
}
