//! Check of a source: what is measured of each robot's readings during `doctor`, and the judgement of it.
//!
//! The judgement says what the host of the robot would do with the same readings: where they are too old, its Cache
//! gives no percept and the robot stands. Does no I/O, and reads no clock.

use crate::fitness::{Finding, Fitness};
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Largest accepted deviation from 1 of the advance of the readings' stamps per time between their arrivals. Clocks
/// deviate by far less; jitter over a second of readings causes a few percent.
const SKEW: f64 = 0.1;
/// Shortest time between a robot's first and last reading from which the advance of the stamps is compared with the
/// time between the arrivals.
const COMPARED: Span = Span::from_millis(400);
/// Largest difference between the advance of a stamp and the time between two arrivals that is no clock that was set
/// \[s\].
const CLOCK_SET_S: f64 = 1.0;
/// Shortest time without a reading at the end of the check that counts as silence. A loaded machine reads late.
const SILENCE: Span = Span::from_millis(500);
/// Number of mean periods without a reading at the end of the check that counts as silence.
const PERIODS: f64 = 3.0;
/// Share of the time without a fresh reading from which a robot mostly stands.
const MOSTLY: f64 = 0.5;
/// Rates of readings beyond which they are more than a policy needs, and more than a team can share \[Hz\]. Each is a
/// message to other hosts, and policies act at 20 Hz.
const RATES_HZ: (f64, f64) = (250.0, 1000.0);
/// Subject of the findings.
const READINGS: &str = "readings";
/// Factor by which a place is further out than the edge of the ground, for its numbers to have another unit.
const FAR: f32 = 10.0;
/// Distance from the edge of the ground to which a robot is not yet noticed off it \[m\]: robots are put there by hand.
const BESIDE_M: f32 = 0.5;
/// Smallest distance of two robots' centres \[m\]. Hulls have a larger radius.
const APART_M: f32 = 0.05;

/// What a robot's readings have to be for its host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Needs {
    /// Largest age of a robot's newest reading; with an older one it stands.
    pub own_state: Span,
    /// Half the size of the ground along x and y \[m\].
    pub half_extent: Vec2,
}

/// Statistics of the readings of one robot, from a source or from the robot's odometry.
#[derive(Clone, Debug)]
pub struct Track {
    own_state: Span,
    first: (Time, u64),
    last: Reading,
    /// Arrival of the last reading with a new stamp.
    at: Time,
    /// Number of all readings, including those with the same stamp as the reading before.
    count: u32,
    /// Number of readings with the same stamp as the reading before, and of those since the last new one.
    repeated: (u32, u32),
    /// Longest time between the arrivals of two successive readings with different stamps.
    gap: Span,
    /// Time in which the newest reading was older than `own_state`.
    stale: Span,
    /// Largest difference between the advance of a stamp and the time between two arrivals \[s\].
    step_s: f64,
}

impl Track {
    /// Begins the statistics with a robot's first reading, which has arrived at `now`. Its readings must not be older
    /// than `own_state`.
    pub fn new(own_state: Span, now: Time, reading: Reading) -> Track {
        let (first, step_s) = ((now, reading.stamp_ns), 0.0);
        let (gap, stale) = (Span::ZERO, Span::ZERO);
        Track { own_state, first, last: reading, at: now, count: 1, repeated: (0, 0), gap, stale, step_s }
    }

    /// Adds a reading that has arrived at `now`.
    pub fn note(&mut self, now: Time, reading: &Reading) {
        self.count += 1;
        if reading.stamp_ns == self.last.stamp_ns {
            self.repeated = (self.repeated.0 + 1, self.repeated.1 + 1);
        } else {
            let gap = now.since(self.at);
            self.gap = self.gap.max(gap);
            self.stale = self.stale + beyond(gap, self.own_state);
            let step_s = (reading.stamp_ns as f64 - self.last.stamp_ns as f64) * 1e-9 - gap.as_secs();
            if step_s.abs() > self.step_s.abs() {
                self.step_s = step_s;
            }
            (self.at, self.repeated.1) = (now, 0);
        }
        self.last = reading.clone();
    }

    /// Returns the last position of the robot \[m\].
    pub fn place(&self) -> Vec2 {
        self.last.pose.position
    }

    /// Returns the rate of readings with new stamps while they came \[Hz\].
    fn rate_hz(&self) -> f64 {
        f64::from(self.count - 1 - self.repeated.0) / self.at.since(self.first.0).as_secs().max(1e-9)
    }

    /// Returns by how much the stamps advance \[s\] in one second of the receiver's clock; 1 if both clocks run equally
    /// fast. `None` if the readings span too little time (`COMPARED`).
    fn pace(&self) -> Option<f64> {
        let arrived = self.at.since(self.first.0);
        let stamped = self.last.stamp_ns as f64 - self.first.1 as f64;
        (arrived >= COMPARED).then(|| stamped * 1e-9 / arrived.as_secs())
    }

    fn pose(&self) -> String {
        let at = self.place();
        let heading = self.last.pose.heading.map_or("no heading".to_owned(), |rad| format!("heading {rad:.2} rad"));
        format!("at ({:.2}, {:.2}) m, {heading}", at.x, at.y)
    }

    /// Returns whether the robot has no reading at `end` any more, by the rate at which they came.
    fn is_silent(&self, end: Time) -> bool {
        let new = self.count - 1 - self.repeated.0;
        let mean = if new == 0 { 0.0 } else { self.at.since(self.first.0).as_secs() / f64::from(new) };
        let longest = Span::from_secs(PERIODS * mean).max(self.own_state).max(SILENCE);
        end.since(self.at) > longest
    }

    /// Judges the readings until `end`, the time at which the check ends.
    pub fn judge(&self, end: Time, needs: &Needs) -> Finding {
        let tail = end.since(self.at);
        let (rate, gap_ms) = (self.rate_hz(), self.gap.max(tail).as_secs() * 1e3);
        let said = format!("{rate:.0} Hz, {}, longest gap {gap_ms:.0} ms", self.pose());
        let of = |fitness, found: String, advice: &str| Finding {
            fitness,
            what: READINGS,
            found,
            advice: advice.to_owned(),
        };
        let own_state_ms = needs.own_state.as_secs() * 1e3;
        if self.count > 1 && self.repeated.0 + 1 == self.count {
            let advice = "is the tracker frozen, or does it not stamp? readings of one stamp count once";
            return of(
                Fitness::Fail,
                format!("one reading, repeated {} times, {}", self.repeated.0, self.pose()),
                advice,
            );
        }
        if self.is_silent(end) {
            let what = if self.repeated.1 > 0 { "the same reading again and again" } else { "no reading" };
            let found = format!("{what} for the last {:.1} s; before: {said}", tail.as_secs());
            return of(
                Fitness::Fail,
                found,
                "the robot would stand: does its tracker run, and does it still see the robot?",
            );
        }
        if self.count == 1 {
            return of(Fitness::Warn, format!("one reading, {}", self.pose()), "listen longer");
        }
        if let Some(judgement) = self.judge_place(&said, needs) {
            return judgement;
        }
        let share = self.stale_share(end);
        match self.pace() {
            _ if rate > RATES_HZ.1 => {
                of(Fitness::Fail, said, "each reading is a message to the team: send at most 100 a second")
            }
            _ if share > MOSTLY => {
                let found = format!("{said}; {:.0} % of the time older than own_state_s", share * 100.0);
                let advice =
                    format!("the robot would mostly stand: raise own_state_s ({own_state_ms:.0} ms), or the rate");
                of(Fitness::Fail, found, &advice)
            }
            _ if self.step_s.abs() > CLOCK_SET_S => {
                let found = format!("{said}; the clock of its stamps was set by {:+.1} s", self.step_s);
                of(Fitness::Warn, found, "see what sets it; the robot goes on, and may stand for a moment each time")
            }
            Some(pace) if (pace - 1.0).abs() > SKEW => {
                let found = format!("{said}; its stamps advance by {pace:.2} s in a second");
                of(Fitness::Warn, found, "are its stamps seconds of one clock? velocities come from their differences")
            }
            _ if gap_ms > own_state_ms => {
                let advice =
                    format!("beyond own_state_s ({own_state_ms:.0} ms) the robot stops: raise it, or the rate");
                of(Fitness::Warn, said, &advice)
            }
            _ if rate > RATES_HZ.0 => of(Fitness::Warn, said, "policies act 20 times a second: fewer readings do"),
            _ => of(Fitness::Ok, said, ""),
        }
    }

    /// Judges the robot's place by the ground; `None` if it is on the ground.
    fn judge_place(&self, said: &str, needs: &Needs) -> Option<Finding> {
        let (place, half) = (self.place(), needs.half_extent);
        let within = |half: Vec2| place.x.abs() <= half.x && place.y.abs() <= half.y;
        if within(half.add_scalar(BESIDE_M)) {
            return None;
        }
        let found = format!("{said}; the ground reaches to \u{b1}{:.1} m, \u{b1}{:.1} m", half.x, half.y);
        let (fitness, advice) = match () {
            () if within(half * FAR) => {
                (Fitness::Warn, "off the ground the guard stops it: is it there, and is the frame right?")
            }
            () => (
                Fitness::Fail,
                "are its positions millimetres, which have to be metres? else see the origin of its frame",
            ),
        };
        Some(Finding { fitness, what: READINGS, found, advice: advice.to_owned() })
    }

    /// Returns the share of the time until `end` in which the newest reading was older than `own_state`.
    fn stale_share(&self, end: Time) -> f64 {
        let stale = self.stale + beyond(end.since(self.at), self.own_state);
        stale.as_secs() / end.since(self.first.0).as_secs().max(1e-9)
    }
}

/// Returns by how much `gap` exceeds `most`; zero if it does not.
fn beyond(gap: Span, most: Span) -> Span {
    Span::from_nanos(gap.as_nanos().saturating_sub(most.as_nanos()))
}

/// Returns the pairs of robots that are measured at one place, where two robots cannot be: one of them is another's
/// body, topic or receiver.
pub fn at_one_place(places: &[(RobotId, Vec2)]) -> Vec<(RobotId, RobotId, Vec2)> {
    let mut pairs = Vec::new();
    for (at, (robot, place)) in places.iter().enumerate() {
        for (other, elsewhere) in &places[at + 1..] {
            if robot != other && (*place - *elsewhere).norm() < APART_M {
                pairs.push((*robot, *other, *place));
            }
        }
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;

    const NEEDS: Needs = Needs { own_state: Span::from_millis(100), half_extent: Vec2::new(2.0, 2.0) };

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn reading(stamp_ns: u64, position: Vec2) -> Reading {
        Reading::of_point(RobotId(0), stamp_ns, Motion::at_rest(position))
    }

    /// Readings at times [ms] with stamps [ms], judged at `end_ms`.
    fn judged(all: impl IntoIterator<Item = (u64, u64)>, position: Vec2, end_ms: u64) -> Finding {
        let mut all = all.into_iter().map(|(ms, stamp_ms)| (at_ms(ms), reading(stamp_ms * 1_000_000, position)));
        let (now, first) = all.next().expect("a reading");
        let mut track = Track::new(NEEDS.own_state, now, first);
        all.for_each(|(now, reading)| track.note(now, &reading));
        track.judge(at_ms(end_ms), &NEEDS)
    }

    fn regular(until_ms: u64) -> impl Iterator<Item = (u64, u64)> {
        (0..until_ms / 20).map(|k| (20 * k, 20 * k))
    }

    #[test]
    fn sound_readings_are_fit_with_their_rate_place_and_gap() {
        let sound = judged(regular(3000), Vec2::new(1.0, -1.0), 3000);
        let found = "50 Hz, at (1.00, -1.00) m, no heading, longest gap 20 ms";
        assert_eq!((sound.fitness, sound.found.as_str(), sound.advice.as_str()), (Fitness::Ok, found, ""));
    }

    #[test]
    fn silence_until_the_end_of_the_check_is_no_fitness() {
        let silent = judged(regular(2500), Vec2::zeros(), 5000);
        assert_eq!(silent.fitness, Fitness::Fail);
        assert!(silent.found.starts_with("no reading for the last 2.5 s; before: 50 Hz"), "{}", silent.found);
        assert!(silent.found.ends_with("longest gap 2520 ms"), "{}", silent.found);
        let frozen = judged((0..250).map(|k| (20 * k, 20 * k.min(100))), Vec2::zeros(), 5000);
        assert!(frozen.found.starts_with("the same reading again and again for the last 3.0 s"), "{}", frozen.found);
        assert_eq!(frozen.fitness, Fitness::Fail);
        let slow = judged((0..5).map(|k| (1000 * k, 1000 * k)), Vec2::zeros(), 4900);
        assert!(slow.fitness == Fitness::Fail && slow.advice.contains("mostly stand"), "one a second: {slow:?}");
        assert_eq!(judged([(0, 0)], Vec2::zeros(), 3000).fitness, Fitness::Fail);
        let burst = judged((0..24).map(|k| (k, k)), Vec2::zeros(), 3000);
        assert_eq!(burst.fitness, Fitness::Fail, "{burst:?}");
        let gap = judged(regular(1000).chain(regular(3000).skip(60)), Vec2::zeros(), 3000);
        assert!(gap.fitness == Fitness::Warn && gap.advice.contains("own_state_s"), "{gap:?}");
    }

    #[test]
    fn places_in_millimetres_and_floods_are_no_fitness() {
        let millimetres = judged(regular(3000), Vec2::new(-1000.0, 1000.0), 3000);
        assert!(millimetres.fitness == Fitness::Fail && millimetres.advice.contains("millimetres"), "{millimetres:?}");
        let elsewhere = judged(regular(3000), Vec2::new(6_000.0, 0.0), 3000);
        assert!(elsewhere.fitness == Fitness::Fail && elsewhere.advice.contains("origin"), "{elsewhere:?}");
        assert_eq!(judged(regular(3000), Vec2::new(3.0, 0.0), 3000).fitness, Fitness::Warn);
        let flood = |per_ms: u64| (0..3000 * per_ms).map(move |k| (k / per_ms, k));
        let flooded = judged(flood(2), Vec2::zeros(), 3000);
        assert!(flooded.fitness == Fitness::Fail && flooded.found.starts_with("2000 Hz"), "{flooded:?}");
        assert_eq!(judged((0..1500).map(|k| (2 * k, 2 * k)), Vec2::zeros(), 3000).fitness, Fitness::Warn, "500 Hz");
    }

    #[test]
    fn clocks_that_are_set_or_count_otherwise_are_a_warning() {
        let set = judged((0..150).map(|k| (20 * k, 20 * k + if k < 75 { 0 } else { 3_600_000 })), Vec2::zeros(), 3000);
        assert!(set.fitness == Fitness::Warn && set.found.contains("was set by +3600.0 s"), "{set:?}");
        let slow = judged((0..150).map(|k| (20 * k, 10 * k)), Vec2::zeros(), 3000);
        assert!(slow.fitness == Fitness::Warn && slow.found.contains("advance by 0.50 s in a second"), "{slow:?}");
    }

    #[test]
    fn two_robots_at_one_place_are_found() {
        let places = [(0, 0.0), (1, 1.0), (2, 0.02)].map(|(robot, x)| (RobotId(robot), Vec2::new(x, 0.0)));
        assert_eq!(at_one_place(&places), [(RobotId(0), RobotId(2), Vec2::zeros())]);
    }
}
