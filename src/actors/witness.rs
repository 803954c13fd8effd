//! Witness of a robot: holds what other robots say of their own motion against what a tracker measures of them.
//!
//! A robot whose host is captured can say that it is anywhere. Where a tracker measures it, its measured motion takes
//! the place of the one in its latents. Where the newest reading is old and the latents do not fit it, the robot may be
//! at either place. A robot whose latents contradict fresh readings for a while is a suspect. That alone changes
//! nothing for avoidance, so the tolerance is wide enough for honest robots: it is for the delays of both messages,
//! whose difference moves a fast robot, and not for noise alone.

use std::collections::BTreeMap;

use crate::hearing::MAX_NEIGHBOURS;
use crate::messages::geometry::Motion;
use crate::messages::ids::RobotId;
use crate::messages::local::OtherRobot;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Largest age of a reading that takes the place of what its robot says: three periods of a receiver at 10 Hz.
const FRESH: Span = Span::from_millis(300);
/// Age of a reading of a doubtful robot after which the robot counts as standing where it was last measured. Its
/// place is not known then, and a guard forgets what is older.
const KNOWN: Span = Span::from_millis(1000);
/// Longest difference between the delays of a robot's reading and of its latent that an honest robot may have: the age
/// of the reading from which it computed the latent, and the time for which links may hold messages back.
const LAG: Span = Span::from_millis(300);
/// Number of standard deviations by which a measurement may be off: one of two million is.
const DEVIATIONS: f32 = 5.0;
/// Standard deviation of a sensor that states none \[m\]: that of a satellite receiver with corrections.
const DEVIATION_M: f32 = 0.02;
/// Room for what no deviation says, such as the place of a marker on a robot \[m\].
const MARGIN_M: f32 = 0.1;
/// Time for which latents have to contradict the readings, and their least number, until their sender is a suspect. A
/// robot that is put somewhere else contradicts its readings for as long as its newest latent was on its way.
const SUSPECT_AFTER: Span = Span::from_millis(500);
const SUSPECT_LATENTS: u32 = 5;
/// Time for which the latents of a suspect have to agree with the readings until it is none.
const CLEARED_AFTER: Span = Span::from_millis(2000);

/// Change of the standing of another robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finding {
    /// The robot has contradicted the tracker for a while.
    Suspect,
    /// The robot was a suspect, and has agreed with the tracker for a while.
    Cleared,
}

/// How the latents of a robot have compared with its readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Standing {
    /// The newest latent that was compared has agreed.
    Agrees,
    /// As many latents as given have contradicted the readings, the first of them at this time.
    Contradicts(Time, u32),
    /// The robot is a suspect; its latents have agreed since this time, if they do.
    Suspect(Option<Time>),
}

/// Reading, latent and standing of one other robot.
#[derive(Clone, Copy, Debug)]
struct Known {
    /// Arrival of the newest reading, its stamp \[ns\], measured motion and standard deviation of the position \[m\].
    measured: Option<(Time, u64, Motion, f32)>,
    /// Arrival of the newest latent, and the motion that it says.
    said: Option<(Time, Motion)>,
    /// Whether the newest latent does not fit the newest reading, or its sender has contradicted readings before.
    doubtful: bool,
    standing: Standing,
}

impl Known {
    /// Returns the robot's measured motion, moved on to time `at`; `None` if there is no fresh reading at time `now`.
    fn fresh(&self, now: Time, at: Time) -> Option<Motion> {
        let (arrived, _, motion, _) = self.measured.filter(|(arrived, ..)| now.since(*arrived) <= FRESH)?;
        let since_s = (at.since(arrived).as_secs() - arrived.since(at).as_secs()) as f32;
        Some(Motion { position: motion.position + motion.velocity * since_s, ..motion })
    }

    /// Returns where a robot is an obstacle at time `now` by its reading; empty if its reading is old and its latents
    /// are not doubtful.
    fn obstacles(&self, robot: RobotId, now: Time) -> impl Iterator<Item = OtherRobot> + use<> {
        let measured = self.measured.map(|(arrived, _, motion, _)| (now.since(arrived), motion));
        let fresh = measured.is_some_and(|(age, _)| age <= FRESH);
        let last = measured.filter(|_| fresh || self.doubtful).map(|(age, motion)| match age <= KNOWN {
            true => OtherRobot { robot, motion, age },
            false => OtherRobot { robot, motion: Motion::at_rest(motion.position), age: Span::ZERO },
        });
        let said = self.said.filter(|_| last.is_some() && !fresh);
        let said = said.map(|(arrived, motion)| OtherRobot { robot, motion, age: now.since(arrived) });
        last.into_iter().chain(said)
    }
}

/// Witness of one robot: what a tracker measures of the others, and what they say of themselves.
#[derive(Debug)]
pub(super) struct Witness {
    /// Largest speed of a robot \[m/s\].
    speed_m_s: f32,
    others: BTreeMap<RobotId, Known>,
}

impl Witness {
    /// Makes a witness that has received nothing yet. `limit_m_s` is the largest speed of the robots along each axis
    /// \[m/s\].
    pub(super) fn new(limit_m_s: f32) -> Witness {
        Witness { speed_m_s: limit_m_s * std::f32::consts::SQRT_2, others: BTreeMap::new() }
    }

    /// Takes a reading of another robot that arrives at time `now`. A repeated stamp is the same measurement.
    pub(super) fn measured(&mut self, now: Time, reading: &Reading) {
        if self.others.len() >= MAX_NEIGHBOURS && !self.others.contains_key(&reading.robot) {
            return;
        }
        let new = Known { measured: None, said: None, doubtful: false, standing: Standing::Agrees };
        let known = self.others.entry(reading.robot).or_insert(new);
        if known.measured.is_none_or(|(_, stamp_ns, ..)| stamp_ns != reading.stamp_ns) {
            let deviation_m = reading.deviation.position_m.unwrap_or(DEVIATION_M);
            known.measured = Some((now, reading.stamp_ns, reading.motion(), deviation_m));
        }
    }

    /// Holds the motion in a latent of `robot`, which arrives at time `now`, against its readings. Returns a change of
    /// its standing, with the distance between the said and the measured position \[m\].
    pub(super) fn heard(&mut self, now: Time, robot: RobotId, said: Motion) -> Option<(Finding, f32)> {
        // Of a robot that is never measured, there is nothing to hold against it.
        let known = self.others.get_mut(&robot)?;
        known.said = Some((now, said));
        let (arrived, _, motion, deviation_m) = known.measured?;
        let age_s = now.since(arrived).as_secs() as f32;
        let ahead_s = age_s.min(FRESH.as_secs() as f32);
        let distance_m = (said.position - motion.position - motion.velocity * ahead_s).norm();
        // Both the reading and what the robot says of itself are measured with noise.
        let noise_m = DEVIATIONS * deviation_m * std::f32::consts::SQRT_2;
        let tolerance_m = MARGIN_M + noise_m + self.speed_m_s * (LAG.as_secs() as f32 + age_s);
        let agrees = distance_m <= tolerance_m;
        let mut found = None;
        if now.since(arrived) <= FRESH {
            (known.standing, found) = judged(known.standing, now, agrees);
        }
        known.doubtful = !agrees || known.standing != Standing::Agrees;
        found.map(|found| (found, distance_m))
    }

    /// Returns the motion to believe of `robot` at time `at`, the arrival of its latent, which says that it was `said`:
    /// the measured one where there is a fresh reading at time `now`.
    pub(super) fn believed(&self, now: Time, robot: RobotId, (at, said): (Time, Motion)) -> Motion {
        self.others.get(&robot).and_then(|known| known.fresh(now, at)).unwrap_or(said)
    }

    /// Returns the motions of other robots that take the place of those in their latents at time `now`, in the order of
    /// ids: the measured one of each robot with a fresh reading, and of a doubtful robot without one the last measured
    /// and the one that it says.
    pub(super) fn obstacles(&self, now: Time) -> Vec<OtherRobot> {
        self.others.iter().flat_map(|(robot, known)| known.obstacles(*robot, now)).collect()
    }
}

/// Returns the standing of a robot after one more latent at time `now`, and a change of it to report.
fn judged(before: Standing, now: Time, agrees: bool) -> (Standing, Option<Finding>) {
    match (before, agrees) {
        (Standing::Suspect(since), true) => {
            let since = since.unwrap_or(now);
            match now.since(since) >= CLEARED_AFTER {
                true => (Standing::Agrees, Some(Finding::Cleared)),
                false => (Standing::Suspect(Some(since)), None),
            }
        }
        (Standing::Suspect(_), false) => (Standing::Suspect(None), None),
        (_, true) => (Standing::Agrees, None),
        (Standing::Agrees, false) => (Standing::Contradicts(now, 1), None),
        (Standing::Contradicts(since, latents), false) => {
            match now.since(since) >= SUSPECT_AFTER && latents + 1 >= SUSPECT_LATENTS {
                true => (Standing::Suspect(None), Some(Finding::Suspect)),
                false => (Standing::Contradicts(since, latents + 1), None),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use crate::messages::geometry::Vec2;
    use crate::random::{Seed, normals};

    const OTHER: RobotId = RobotId(3);
    /// Noise of measured positions \[m\].
    const NOISE_M: f32 = 0.02;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn reading(stamp_ms: u64, motion: Motion) -> Reading {
        let mut reading = Reading::of_point(OTHER, stamp_ms * 1_000_000, motion);
        reading.deviation.position_m = Some(NOISE_M);
        reading
    }

    /// Motion eastward at a speed \[m/s\], at the time `ms` \[ms\].
    fn east(ms: u64, speed_m_s: f32) -> Motion {
        let position = Vec2::new(speed_m_s * ms as f32 / 1000.0, 0.0);
        Motion { position, velocity: Vec2::new(speed_m_s, 0.0) }
    }

    /// Returns the motion, moved north by `off_m` \[m\].
    fn off(motion: Motion, off_m: f32) -> Motion {
        Motion { position: motion.position + Vec2::new(0.0, off_m), ..motion }
    }

    /// Motions of a robot every millisecond that drives at 1.5 m/s and turns to another direction at once, after a time
    /// of 0.1 to 1 s each.
    fn zigzag(seconds: u64, seed: u64) -> Vec<Motion> {
        let mut stream = Seed::of_run(seed).stream("zigzag");
        let (mut motion, mut turns_at) = (Motion::default(), 0);
        (0..seconds * 1000)
            .map(|ms| {
                if ms == turns_at {
                    let angle = stream.random_range(0.0..std::f32::consts::TAU);
                    motion.velocity = Vec2::new(1.5 * libm::cosf(angle), 1.5 * libm::sinf(angle));
                    turns_at = ms + stream.random_range(100..1000);
                }
                motion.position += motion.velocity * 1e-3;
                motion
            })
            .collect()
    }

    #[test]
    fn an_honest_robot_is_never_doubted_whatever_its_turns_noise_and_lag() {
        // Period of the readings, and delay of readings and of latents up to their arrival \[ms\].
        for (period, late, said_late) in [(10, 10, 50), (50, 0, 50), (100, 100, 150), (100, 0, 250)] {
            let way = zigzag(2000, period + said_late);
            let mut stream = Seed::of_run(said_late).stream("noise");
            let mut noisy = |motion: Motion| {
                let [x, y] = normals(&mut stream);
                Motion { position: motion.position + Vec2::new(x as f32, y as f32) * NOISE_M, ..motion }
            };
            let mut witness = Witness::new(1.5);
            for ms in 300..way.len() as u64 {
                if ms % period == 0 {
                    witness.measured(at_ms(ms), &reading(ms, noisy(way[(ms - late) as usize])));
                }
                if ms % 50 == 0 {
                    let said = noisy(way[(ms - said_late) as usize]);
                    assert_eq!(witness.heard(at_ms(ms), OTHER, said), None, "at {ms} ms");
                    assert!(!witness.others[&OTHER].doubtful, "{period} ms, {said_late} ms: at {ms} ms");
                }
            }
        }
    }

    #[test]
    fn a_liar_is_a_suspect_within_a_second_and_until_it_has_agreed_for_two() {
        for speed_m_s in [0.0, 0.5, 1.5] {
            let (mut witness, mut found) = (Witness::new(1.5), Vec::new());
            for ms in (0..8000).step_by(50) {
                witness.measured(at_ms(ms), &reading(ms, east(ms, speed_m_s)));
                let said = off(east(ms, speed_m_s), if (1000..4000).contains(&ms) { 2.0 } else { 0.0 });
                found.extend(witness.heard(at_ms(ms), OTHER, said).map(|(found, distance_m)| (ms, found, distance_m)));
                let place = witness.believed(at_ms(ms), OTHER, (at_ms(ms), said));
                assert_eq!(place.position.y, 0.0, "it is where it is measured");
                let obstacles = witness.obstacles(at_ms(ms));
                assert_eq!(obstacles, [OtherRobot { robot: OTHER, motion: east(ms, speed_m_s), age: Span::ZERO }]);
            }
            assert_eq!(found, [(1500, Finding::Suspect, 2.0), (6000, Finding::Cleared, 0.0)], "{speed_m_s} m/s");
        }
    }

    #[test]
    fn a_robot_that_is_carried_away_in_an_instant_is_no_suspect() {
        let mut witness = Witness::new(1.5);
        for ms in (0..4000).step_by(50) {
            witness.measured(at_ms(ms), &reading(ms, off(Motion::default(), if ms < 2000 { 0.0 } else { 5.0 })));
            let said = off(Motion::default(), if ms < 2300 { 0.0 } else { 5.0 });
            assert_eq!(witness.heard(at_ms(ms), OTHER, said), None);
        }
    }

    #[test]
    fn a_tracker_that_falls_silent_leads_to_doubt_and_not_to_an_accusation() {
        let mut witness = Witness::new(1.5);
        witness.measured(at_ms(0), &reading(0, Motion::default()));
        assert_eq!(witness.heard(at_ms(50), OTHER, Motion::default()), None);
        assert_eq!(witness.obstacles(at_ms(400)), [], "what it says is no longer measured, and not doubtful");
        let said = off(Motion::default(), 2.0);
        let at = |ms| OtherRobot { robot: OTHER, motion: Motion::default(), age: Span::from_millis(ms) };
        for ms in (400..500).step_by(50) {
            assert_eq!(witness.heard(at_ms(ms), OTHER, said), None);
            let both = [at(ms), OtherRobot { motion: said, ..at(0) }];
            assert_eq!(witness.obstacles(at_ms(ms)), both, "it may be at either place");
            assert_eq!(witness.believed(at_ms(ms), OTHER, (at_ms(ms), said)), said);
        }
        for ms in (500..9000).step_by(50) {
            assert_eq!(witness.heard(at_ms(ms), OTHER, said), None, "its place is not known");
        }
        assert_eq!(witness.obstacles(at_ms(9000)), [], "in that time it can have driven there");
    }

    #[test]
    fn a_suspect_stays_an_obstacle_where_it_was_last_measured() {
        let mut witness = Witness::new(1.5);
        let said = off(Motion::default(), 2.0);
        for ms in (0..1000).step_by(50) {
            witness.measured(at_ms(ms), &reading(ms, Motion::default()));
            witness.heard(at_ms(ms), OTHER, said);
        }
        witness.heard(at_ms(60_000), OTHER, said);
        let last = OtherRobot { robot: OTHER, motion: Motion::default(), age: Span::ZERO };
        assert_eq!(witness.obstacles(at_ms(60_000)), [last, OtherRobot { motion: said, ..last }]);
    }

    #[test]
    fn a_robot_that_is_measured_and_says_nothing_is_an_obstacle_and_a_repeated_stamp_is_old() {
        let mut witness = Witness::new(1.5);
        witness.measured(at_ms(0), &reading(7, east(0, 1.0)));
        witness.measured(at_ms(200), &reading(7, east(0, 1.0)));
        let other = OtherRobot { robot: OTHER, motion: east(0, 1.0), age: Span::from_millis(250) };
        assert_eq!(witness.obstacles(at_ms(250)), [other]);
        assert_eq!(witness.obstacles(at_ms(301)), []);
        assert_eq!(witness.heard(at_ms(0), RobotId(4), east(0, 1.0)), None, "it is not measured");
    }
}
