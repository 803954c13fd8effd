//! Findings of `doctor` about the devices of a host: what its source of readings and its drivers report while the
//! robots stand.

use std::collections::BTreeMap;

use murmurate::actors::drive_check::DriveCheck;
use murmurate::deploy::team::Team;
use murmurate::graph::bench::Event;
use murmurate::localization::check::{self, Needs, Track};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Hardware, Health, Reading, Reason};
use murmurate::time::{Span, Time};

use super::finding::{Found, Subject};
use super::{host_of, notes};
use murmurate::fitness::{Finding, Fitness};

/// Fault of a robot that was ready before.
#[derive(Debug, Default)]
struct Fault {
    /// Whether the robot or its driver was silent.
    silent: bool,
    /// Reason of the newest fault.
    why: String,
}

/// All that a host's source and drivers have reported during `doctor`: readings, odometry, hardware conditions, and
/// results of the wiggle (a short drive of each robot).
#[derive(Debug, Default)]
pub struct Seen {
    readings: BTreeMap<RobotId, Track>,
    odometry: BTreeMap<RobotId, Track>,
    hardware: BTreeMap<RobotId, Hardware>,
    /// Fault of each robot after it was ready for the first time.
    faults: BTreeMap<RobotId, Fault>,
    source_ended: bool,
    /// Largest age of a robot's newest reading.
    own_state: Span,
    /// End of the check; `None` before. What is reported after it is not part of the check.
    ended: Option<Time>,
    /// True if the host has a source of readings. Then the source's first reading starts the listening time; otherwise
    /// the first robot that is ready starts it.
    localizes: bool,
    /// Begin of the listening time: when the first reading of the host's source arrived or, if the host has no source,
    /// when a driver first reported that its robot is ready. `None` before.
    pub began: Option<Time>,
    /// Results of the wiggle (a short drive of each robot): the judgement of each driven robot's motion, in the order
    /// of the drives.
    pub results: Vec<(RobotId, DriveCheck)>,
    /// True if the wiggle (a short drive of each robot) has ended.
    pub over: bool,
}

fn note(tracks: &mut BTreeMap<RobotId, Track>, own_state: Span, now: Time, reading: Reading) {
    match tracks.get_mut(&reading.robot) {
        Some(track) => track.note(now, &reading),
        None => drop(tracks.insert(reading.robot, Track::new(own_state, now, reading))),
    }
}

impl Seen {
    /// Creates the collection of device reports, without any report. `localizes` is true if the host has a source of
    /// readings, and `own_state` is the largest age of a robot's newest reading.
    pub fn new(localizes: bool, own_state: Span) -> Seen {
        Seen { localizes, own_state, ..Seen::default() }
    }

    /// Ends the check at `now`.
    pub fn end(&mut self, now: Time) {
        self.ended.get_or_insert(now);
    }

    /// Returns the last position of each robot that the source has measured.
    pub fn places(&self) -> impl Iterator<Item = (RobotId, Vec2)> {
        self.readings.iter().map(|(robot, track)| (*robot, track.place()))
    }

    /// Records `event`, which a device of the host or the wiggle has reported at the time `now`.
    pub fn note(&mut self, now: Time, event: Event) {
        if self.ended.is_some() && matches!(event, Event::Reading(_) | Event::Odometry(_) | Event::Hardware(..)) {
            return;
        }
        let begins = match &event {
            Event::Reading(_) => self.localizes,
            Event::Hardware(_, hardware) => !self.localizes && hardware.health == Health::Ready,
            _ => false,
        };
        if begins {
            self.began.get_or_insert(now);
        }
        match event {
            Event::Reading(reading) => note(&mut self.readings, self.own_state, now, reading),
            Event::Odometry(reading) => note(&mut self.odometry, self.own_state, now, reading),
            Event::Hardware(robot, hardware) => {
                let known = self.hardware.remove(&robot);
                let was_ready = known.as_ref().is_some_and(|known| known.health == Health::Ready);
                if hardware.health != Health::Ready && (was_ready || self.faults.contains_key(&robot)) {
                    let why = hardware.reason.as_ref().map_or("no reason given", Reason::text).to_owned();
                    let fault = self.faults.entry(robot).or_default();
                    *fault = Fault { silent: fault.silent || hardware.health == Health::Silent, why };
                }
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
    /// more about its source, and for each robot that it drives those about the driver and the odometry. The team's
    /// ground reaches to `half_extent` \[m\].
    pub fn findings(&self, team: &Team, seconds: f64, half_extent: Vec2) -> Vec<Found> {
        let host = host_of(team);
        let ids = |robots: &[u16]| robots.iter().copied().map(RobotId).collect::<Vec<_>>();
        let needs = Needs { own_state: self.own_state, half_extent };
        let mut found = self.tracker(team, &ids(&host.localizes), seconds, &needs);
        // Odometry counts from where each robot was switched on, wherever that is.
        let anywhere = Needs { half_extent: Vec2::repeat(f32::INFINITY), ..needs };
        for robot in ids(&host.actuates) {
            found.push(self.robot(team, robot));
            let track = self.odometry.get(&robot);
            let end = self.ended.unwrap_or_default();
            found.extend(track.map(|track| about_track(&format!("{robot}, odometry"), track, end, &anywhere, &[])));
        }
        found
    }

    /// Returns the findings about the host's source of readings, which was observed for `seconds` \[s\]: failures that
    /// name those of `robots` without a reading, and a finding about the readings of each other robot.
    fn tracker(&self, team: &Team, robots: &[RobotId], seconds: f64, needs: &Needs) -> Vec<Found> {
        let host = host_of(team);
        let name = host.source.as_ref().map_or("", |source| &source.name);
        let end = if self.source_ended { ", its worker has ended" } else { "" };
        let whole = notes::of_whole_source();
        let mut found = Vec::new();
        let mut missing: Vec<(Vec<RobotId>, Vec<String>)> = Vec::new();
        for robot in robots.iter().filter(|robot| !self.readings.contains_key(robot)) {
            let own = notes::of_source(*robot);
            match missing.iter_mut().find(|(_, other)| *other == own) {
                Some((group, _)) => group.push(*robot),
                None => missing.push((vec![*robot], own)),
            }
        }
        let count: usize = missing.iter().map(|(group, _)| group.len()).sum();
        for (group, own) in &missing {
            let advice = match () {
                () if !own.is_empty() => "correct its source, or its settings",
                () if count == robots.len() => where_to_look(name),
                () => "are they in its sight, and under these names or numbers?",
            };
            let why = own.iter().chain(&whole).map(String::as_str).collect::<Vec<_>>().join("; ");
            let why = if why.is_empty() { why } else { format!(": {why}") };
            let names = group.iter().map(RobotId::to_string).collect::<Vec<_>>().join(", ");
            let said = format!("no reading of {names} in {seconds} s{end}{why}");
            found.push((Fitness::Fail, subject(&format!("source {name}")), said, advice.to_owned()));
        }
        if missing.is_empty() && self.source_ended {
            let advice = "see why it ended; without it all its robots stand";
            found.push((Fitness::Fail, subject(&format!("source {name}")), end[2..].to_owned(), advice.to_owned()));
        }
        if missing.is_empty() && !whole.is_empty() {
            found.push((Fitness::Warn, subject(&format!("source {name}")), whole.join("; "), String::new()));
        }
        let end = self.ended.unwrap_or_default();
        let heard = robots.iter().filter_map(|robot| Some((*robot, self.readings.get(robot)?)));
        found.extend(heard.map(|(robot, track)| {
            about_track(&format!("{robot}, source {name}"), track, end, needs, &notes::of_source(robot))
        }));
        found
    }

    /// Returns the finding about the driver of `robot`: ready or not, battery charge and temperature.
    fn robot(&self, team: &Team, robot: RobotId) -> Found {
        let host = host_of(team);
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
        let fail = |said: String, advice: &str| (Fitness::Fail, what.clone(), said, advice.to_owned());
        match known {
            Some(hardware) if hardware.health != Health::Ready => {
                let state = if hardware.health == Health::Silent { "does not answer" } else { "faulty" };
                let why = why(hardware.health, hardware.reason.as_ref(), &notes::of_driver(robot));
                let why = if why.is_empty() { why } else { format!(": {why}") };
                fail(format!("{state}{why}{}", values()), "look at the robot and at its settings")
            }
            // Whether it is ready at the moment says nothing then.
            _ if self.faults.get(&robot).is_some_and(|fault| fault.silent) => {
                let fault = self.faults[&robot].why.clone();
                let why = notes::of_driver(robot).into_iter().chain([fault]).collect::<Vec<_>>().join("; ");
                fail(
                    format!("does not answer all the time: {why}{}", values()),
                    "look at the robot and at its settings",
                )
            }
            _ if limits.battery_least.is_some() && battery.is_none() => {
                fail("it reports no charge, which battery_least needs".to_owned(), "the robot would stand")
            }
            _ if limits.temperature_most.is_some() && known.is_none_or(|known| known.temperature.is_none()) => {
                fail("it reports no temperature, which temperature_most_c needs".to_owned(), "the robot would stand")
            }
            _ => {
                let condition =
                    known.map_or("runs, and reports no condition".to_owned(), |_| format!("ready{}", values()));
                let fault = self.faults.get(&robot).map(|fault| format!("it was not ready in between: {}", fault.why));
                let warnings: Vec<String> = notes::of_driver(robot).into_iter().chain(fault).collect();
                let status = if warnings.is_empty() { Fitness::Ok } else { Fitness::Warn };
                let said = std::iter::once(condition).chain(warnings).collect::<Vec<_>>().join("; ");
                (status, what, said, String::new())
            }
        }
    }
}

/// Returns why a robot is not ready: by the reason that its driver gives, and by `notes`, the warnings about it.
fn why(health: Health, reason: Option<&Reason>, notes: &[String]) -> String {
    let text = reason.map_or("", Reason::text);
    // The warning that continues a reason which was cut.
    let begun = text.trim_end_matches('.');
    let whole = notes.iter().find(|note| reason.is_some_and(Reason::is_cut) && note.contains(begun));
    match (whole, health) {
        (Some(whole), _) => whole.clone(),
        // Warnings of the worker, which knows more than the driver that hears nothing.
        (None, Health::Silent) => {
            let own = Some(text).filter(|text| !text.is_empty() && !notes.iter().any(|note| note.contains(text)));
            notes.iter().map(String::as_str).chain(own).collect::<Vec<_>>().join("; ")
        }
        (None, _) if reason.is_none() => notes.first().cloned().unwrap_or_default(),
        (None, _) => text.to_owned(),
    }
}

fn subject(what: &str) -> Subject {
    Subject::General(what.to_owned())
}

/// Returns the finding about the readings of a robot, by its `track` and by `notes`, the reasons for which some were
/// refused.
fn about_track(what: &str, track: &Track, end: Time, needs: &Needs, notes: &[String]) -> Found {
    let Finding { fitness: mut status, mut found, advice, .. } = track.judge(end, needs);
    if !notes.is_empty() {
        found += &format!("; {}", notes.join("; "));
        status = status.max(Fitness::Warn);
    }
    (status, subject(what), found, advice)
}

/// Returns the findings about robots that are measured at one place, where two cannot be.
pub fn at_one_place(places: &[(RobotId, Vec2)]) -> Vec<Found> {
    let found = |(robot, other, place): (RobotId, RobotId, Vec2)| {
        let said = format!("both are measured at ({:.2}, {:.2}) m, where two robots cannot be", place.x, place.y);
        let advice = "do they share a body, a topic, a receiver or an origin? give each its own";
        (Fitness::Fail, subject(&format!("{robot} and {other}")), said, advice.to_owned())
    };
    check::at_one_place(places).into_iter().map(found).collect()
}

/// Returns what to look after if a source with this name has no readings and says nothing.
fn where_to_look(source: &str) -> &'static str {
    match source {
        "mavlink" => "does the autopilot send to this address, under this `system`? see `forward` of its driver",
        "gpsd" => "does gpsd run, with a receiver that has a fix?",
        "odometry" => "do the drivers of these robots report odometry?",
        "ros2" => "does anything publish its topic? see topic, type, domain and interface",
        _ => "does the tracker run, on this network, and does it measure these robots?",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::messages::geometry::Motion;
    use murmurate::messages::wire::Hardware;

    #[test]
    fn what_comes_after_the_end_of_the_check_is_not_seen_and_faults_before_it_are_kept() {
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        let mut seen = Seen::new(true, Span::from_millis(100));
        let reading = |stamp_ns| Event::Reading(Reading::of_point(RobotId(0), stamp_ns, Motion::default()));
        seen.note(at(0), reading(1));
        seen.note(at(20), reading(2));
        seen.end(at(2000));
        seen.note(at(2010), reading(3));
        let needs = Needs { own_state: Span::from_millis(100), half_extent: Vec2::repeat(2.0) };
        let judgement = seen.readings[&RobotId(0)].judge(seen.ended.unwrap(), &needs);
        assert!(judgement.fitness == Fitness::Fail && judgement.found.starts_with("no reading for the last 2.0 s"));
        let mut seen = Seen::new(false, Span::from_millis(100));
        for (ms, hardware) in [
            (0, Hardware::of(Health::Silent)),
            (10, Hardware::of(Health::Ready)),
            (20, Hardware::of(Health::Faulty).because("bumper pressed")),
            (30, Hardware::of(Health::Ready)),
        ] {
            seen.note(at(ms), Event::Hardware(RobotId(0), hardware));
        }
        let fault = |seen: &Seen| (seen.faults[&RobotId(0)].why.clone(), seen.faults[&RobotId(0)].silent);
        let pressed = "bumper pressed".to_owned();
        assert_eq!(fault(&seen), (pressed, false), "and not that it was silent before it was ready");
        seen.note(at(40), Event::Hardware(RobotId(0), Hardware::of(Health::Silent).because("unplugged")));
        seen.note(at(50), Event::Hardware(RobotId(0), Hardware::of(Health::Ready)));
        assert_eq!(fault(&seen), ("unplugged".to_owned(), true), "though it is ready again");
    }

    #[test]
    fn a_cut_reason_is_completed_by_the_warning_that_continues_it() {
        let long = "2 publishers of /r0/odom, 2 subscribers of /r0/cmd_vel: two robots have one namespace; both would \
                    be driven";
        let reason = Reason::new(long).unwrap();
        let notes = ["other (8 times or more)".to_owned(), format!("{long}; end one")];
        assert_eq!(why(Health::Faulty, Some(&reason), &notes), format!("{long}; end one"));
        let short = Reason::new("bumper pressed").unwrap();
        assert_eq!(why(Health::Faulty, Some(&short), &notes), "bumper pressed");
        let silent = Reason::new("no odometry is heard").unwrap();
        assert_eq!(why(Health::Silent, Some(&silent), &notes[..1]), "other (8 times or more); no odometry is heard");
        assert_eq!(why(Health::Silent, None, &[]), "");
    }
}
