//! Findings of `doctor` about the devices of a host: what its source of readings and its drivers report while the
//! robots stand.

use std::collections::BTreeMap;

use crate::actors::verdict::Verdict;
use crate::deploy::team::Team;
use crate::graph::bench::Event;
use crate::messages::ids::RobotId;
use crate::messages::wire::{Hardware, Health, Reading, Reason};
use crate::time::{Span, Time};

use super::{Found, Status, Subject, notes};

/// Largest accepted deviation from 1 of the advance of the readings' stamps per time between their arrivals; a larger
/// one is a warning. Clocks deviate by far less; jitter over a second of readings causes a few percent.
const SKEW: f64 = 0.1;
/// Shortest time between a robot's first and last reading from which the advance of the stamps is compared with the
/// time between the arrivals.
const COMPARED: Span = Span::from_millis(400);

/// Statistics of the readings of one robot, from the host's source or from the robot's odometry: number, first and last
/// reading, longest gap.
#[derive(Clone, Debug)]
struct Track {
    first: (Time, u64),
    last: Reading,
    at: Time,
    /// Number of all readings, including those with the same stamp as the reading before.
    count: u32,
    /// Number of readings with the same stamp as the reading before.
    repeated: u32,
    /// Longest time between the arrivals of two successive readings with different stamps.
    gap: Span,
}

impl Track {
    fn new(now: Time, reading: Reading) -> Track {
        Track { first: (now, reading.stamp_ns), last: reading, at: now, count: 1, repeated: 0, gap: Span::ZERO }
    }

    fn note(&mut self, now: Time, reading: &Reading) {
        self.count += 1;
        if reading.stamp_ns == self.last.stamp_ns {
            self.repeated += 1;
        } else {
            self.gap = self.gap.max(now.since(self.at));
            self.at = now;
        }
        self.last = reading.clone();
    }

    /// Returns the rate of readings with new stamps \[Hz\].
    fn rate_hz(&self) -> f64 {
        f64::from(self.count - 1 - self.repeated) / self.at.since(self.first.0).as_secs().max(1e-9)
    }

    /// Returns by how much the stamps advance \[s\] in one second of the receiver's clock; 1 if both clocks run equally
    /// fast. `None` if the readings span too little time (`COMPARED`).
    fn pace(&self) -> Option<f64> {
        let arrived = self.at.since(self.first.0);
        let stamped = self.last.stamp_ns as f64 - self.first.1 as f64;
        (arrived >= COMPARED).then(|| stamped * 1e-9 / arrived.as_secs())
    }

    fn pose(&self) -> String {
        let at = self.last.pose.position;
        let heading = self.last.pose.heading.map_or("no heading".to_owned(), |rad| format!("heading {rad:.2} rad"));
        format!("at ({:.2}, {:.2}) m, {heading}", at.x, at.y)
    }
}

/// All that a host's source and drivers have reported during `doctor`: readings, odometry, hardware conditions, and
/// results of the wiggle (a short drive of each robot).
#[derive(Debug, Default)]
pub struct Seen {
    readings: BTreeMap<RobotId, Track>,
    odometry: BTreeMap<RobotId, Track>,
    hardware: BTreeMap<RobotId, Hardware>,
    source_ended: bool,
    /// True if the host has a source of readings. Then the source's first reading starts the listening time; otherwise
    /// the first robot that is ready starts it.
    localizes: bool,
    /// Begin of the listening time: when the first reading of the host's source arrived or, if the host has no source,
    /// when a driver first reported that its robot is ready. `None` before.
    pub began: Option<Time>,
    /// Results of the wiggle (a short drive of each robot): the judgement of each driven robot's motion, in the order
    /// of the drives.
    pub results: Vec<(RobotId, Verdict)>,
    /// True if the wiggle (a short drive of each robot) has ended.
    pub over: bool,
}

fn note(tracks: &mut BTreeMap<RobotId, Track>, now: Time, reading: Reading) {
    match tracks.get_mut(&reading.robot) {
        Some(track) => track.note(now, &reading),
        None => drop(tracks.insert(reading.robot, Track::new(now, reading))),
    }
}

impl Seen {
    /// Creates the collection of device reports, without any report. `localizes` is true if the host has a source of
    /// readings.
    pub fn new(localizes: bool) -> Seen {
        Seen { localizes, ..Seen::default() }
    }

    /// Records `event`, which a device of the host or the wiggle has reported at the time `now`.
    pub fn note(&mut self, now: Time, event: Event) {
        let begins = match &event {
            Event::Reading(_) => self.localizes,
            Event::Hardware(_, hardware) => !self.localizes && hardware.health == Health::Ready,
            _ => false,
        };
        if begins {
            self.began.get_or_insert(now);
        }
        match event {
            Event::Reading(reading) => note(&mut self.readings, now, reading),
            Event::Odometry(reading) => note(&mut self.odometry, now, reading),
            Event::Hardware(robot, hardware) => {
                let known = self.hardware.remove(&robot);
                let kept = |of: fn(&Hardware) -> Option<u8>| known.as_ref().and_then(of);
                let battery = hardware.battery.or(kept(|known| known.battery));
                self.hardware.insert(robot, Hardware { battery, ..hardware });
            }
            Event::SourceEnded => self.source_ended = true,
            Event::Begins(_) => {}
            Event::Result(robot, verdict) => self.results.push((robot, verdict)),
            Event::Over => self.over = true,
        }
    }

    /// Returns the findings about the devices of the host `team.host`, which were observed for `seconds` \[s\]: one or
    /// more about its source, and for each robot that it drives those about the driver and the odometry.
    pub fn findings(&self, team: &Team, seconds: f64) -> Vec<Found> {
        let host = &team.deployment.hosts[usize::from(team.host.0)];
        let ids = |robots: &[u16]| robots.iter().copied().map(RobotId).collect::<Vec<_>>();
        let mut found = self.tracker(team, &ids(&host.localizes), seconds);
        for robot in ids(&host.actuates) {
            found.push(self.robot(team, robot));
            found.extend(self.odometry.get(&robot).map(|track| self.own_odometry(team, robot, track)));
        }
        found
    }

    /// Returns the findings about the host's source of readings, which was observed for `seconds` \[s\]: a failure that
    /// names those of `robots` without a reading, and a finding about the readings of each other robot.
    fn tracker(&self, team: &Team, robots: &[RobotId], seconds: f64) -> Vec<Found> {
        let host = &team.deployment.hosts[usize::from(team.host.0)];
        let name = host.source.as_ref().map_or("", |source| &source.name);
        let missing: Vec<String> =
            robots.iter().filter(|robot| !self.readings.contains_key(robot)).map(RobotId::to_string).collect();
        let mut found = Vec::new();
        if !missing.is_empty() {
            let (ended, note) = (self.source_ended, notes::newest(&["source", "localizer"]));
            let why = note.map_or(String::new(), |note| format!(": {note}"));
            let end = if ended { ", its worker has ended" } else { "" };
            let all = missing.len() == robots.len();
            let said = format!("no reading of {} in {seconds} s{end}{why}", missing.join(", "));
            let advice = match all {
                true => "does the tracker run, on this network, and does it measure these robots?",
                false => "are they in its sight, and under these names or numbers?",
            };
            found.push((Status::Fail, subject(&format!("source {name}")), said, advice.to_owned()));
        }
        let heard = robots.iter().filter_map(|robot| Some((robot, self.readings.get(robot)?)));
        found.extend(heard.map(|(robot, track)| about_track(team, &format!("{robot}, source {name}"), track)));
        found
    }

    /// Returns the finding about the driver of `robot`: ready or not, battery charge and temperature.
    fn robot(&self, team: &Team, robot: RobotId) -> Found {
        let host = &team.deployment.hosts[usize::from(team.host.0)];
        let name = host.driver.as_ref().map_or("", |driver| &driver.name);
        let what = subject(&format!("{robot}, driver {name}"));
        let limits = team.deployment.hardware_limits(robot);
        let known = self.hardware.get(&robot);
        let battery = known.and_then(|hardware| hardware.battery);
        let values = || {
            let battery = battery.map(|battery| format!(", battery {battery} %"));
            let temperature = known.and_then(|known| known.temperature).map(|degrees| format!(", {degrees}"));
            battery.into_iter().chain(temperature).collect::<String>()
        };
        let fail = |said: String, advice: &str| (Status::Fail, what.clone(), said, advice.to_owned());
        match known {
            Some(hardware) if hardware.health != Health::Ready => {
                let state = if hardware.health == Health::Silent { "does not answer" } else { "faulty" };
                let reason = hardware.reason.as_ref().map(|reason| reason.text().to_owned());
                // The log's message is longer than the reason, which may be cut, and says what to do.
                let short = hardware.reason.as_ref().is_none_or(Reason::is_cut);
                let note = notes::newest(&[&format!("driver {}", robot.0)]).or_else(|| notes::about(robot));
                let note = note.filter(|_| hardware.health == Health::Silent || short).or(reason);
                let why = note.map_or(String::new(), |note| format!(": {note}"));
                fail(format!("{state}{why}{}", values()), "look at the robot and at its settings")
            }
            _ if limits.battery_least.is_some() && battery.is_none() => {
                fail("it reports no charge, which battery_least needs".to_owned(), "the robot would stand")
            }
            _ if limits.temperature_most.is_some() && known.is_none_or(|known| known.temperature.is_none()) => {
                fail("it reports no temperature, which temperature_most_c needs".to_owned(), "the robot would stand")
            }
            Some(_) => (Status::Ok, what, format!("ready{}", values()), String::new()),
            None => (Status::Ok, what, "runs, and reports no condition".to_owned(), String::new()),
        }
    }

    /// Returns the finding about the odometry of `robot`, whose readings are `track`: rate, gaps, stamps and pose.
    fn own_odometry(&self, team: &Team, robot: RobotId, track: &Track) -> Found {
        about_track(team, &format!("{robot}, odometry"), track)
    }
}

fn subject(what: &str) -> Subject {
    Subject::General(what.to_owned())
}

fn about_track(team: &Team, what: &str, track: &Track) -> Found {
    let (rate, gap_ms) = (track.rate_hz(), track.gap.as_secs() * 1e3);
    let said = format!("{rate:.0} Hz, {}, longest gap {gap_ms:.0} ms", track.pose());
    let of = |status, said: String, advice: &str| (status, subject(what), said, advice.to_owned());
    let own_state_ms = team.safety.own_state_s * 1e3;
    match track.pace() {
        _ if track.count > 1 && track.repeated + 1 == track.count => {
            let advice = "is the tracker frozen, or does it not stamp? readings of one stamp count once";
            of(Status::Fail, format!("one reading, repeated {} times, {}", track.repeated, track.pose()), advice)
        }
        _ if track.count == 1 => of(Status::Warn, format!("one reading, {}", track.pose()), "listen longer"),
        Some(pace) if (pace - 1.0).abs() > SKEW => {
            let said = format!("{said}; its stamps advance by {pace:.2} s in a second");
            of(Status::Warn, said, "are its stamps seconds of one clock? velocities come from their differences")
        }
        _ if gap_ms > own_state_ms => {
            let advice = format!("beyond own_state_s ({own_state_ms:.0} ms) the robot stops: raise it, or the rate");
            of(Status::Warn, said, &advice)
        }
        _ => of(Status::Ok, said, ""),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;

    fn track(stamps: impl Fn(u64) -> u64) -> Track {
        let reading = |k: u64| Reading::of_point(RobotId(0), stamps(k), Motion::default());
        let at = |k: u64| Time::ZERO + Span::from_millis(20 * k);
        let mut track = Track::new(at(0), reading(0));
        (1..=50).filter(|k| *k != 25).for_each(|k| track.note(at(k), &reading(k)));
        track
    }

    #[test]
    fn rate_gap_and_pace_are_those_of_new_readings() {
        let regular = track(|k| k * 20_000_000);
        assert!((regular.rate_hz() - 49.0).abs() < 0.01, "{}", regular.rate_hz());
        assert_eq!(regular.gap, Span::from_millis(40));
        assert!((regular.pace().unwrap() - 1.0).abs() < 1e-9);
        let milliseconds = track(|k| k * 20_000);
        assert!((milliseconds.pace().unwrap() - 0.001).abs() < 1e-9);
        let frozen = track(|_| 7);
        assert_eq!((frozen.repeated, frozen.count), (49, 50));
    }
}
