//! Screen: judges every reading of a source of real robots before it is published, and answers people who say where a
//! robot is.
//!
//! It has a `Track` for each robot, and sees what one robot alone cannot show: several robots that jump by one motion,
//! since the frame of their source has changed, and two that are exchanged.

use std::collections::{BTreeMap, VecDeque};

use super::alignment::Alignment;
use super::plausibility::{Fix, Limits, Plausibility, Quality, Track};
use super::{Out, Source, odometry};
use crate::messages::geometry::Pose;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::place::{Located, Place, PlaceAnswer, Placed, Whereabouts};
use crate::messages::wire::{MAX_BLOCK, Reading};
use crate::time::{Span, Time};

/// Period at which a host repeats which of its robots are lost.
const REPEAT: Span = Span::from_millis(200);
/// Longest time between the jumps of two robots that may have one cause.
const TOGETHER: Span = Span::from_millis(300);
/// Largest change of the distance of two robots that have jumped by one motion, beside the noise \[m\].
const RIGID_M: f64 = 0.05;
/// Largest change that is allowed for the motion of the two meanwhile \[m\].
const DRIVEN_M: f64 = 0.5;
/// Distance from another robot's last pose within which a robot counts as exchanged with it \[m\]: nearer they touch.
const EXCHANGED_M: f64 = 0.2;
/// Time for which a robot has to have stood before a person's word is taken.
const STOOD: Span = Span::from_millis(500);
/// Age of the last measurement from which a robot counts as not measured.
const SILENT: Span = Span::from_millis(1000);
/// Speed \[m/s\] and yaw rate \[rad/s\] above which a robot moves, whatever its poses say.
const MOVES: (f32, f32) = (0.1, 0.2);
/// Distance \[m\] and angle \[rad\], beside the noise, by which the poses of a robot that stands may differ.
const STANDS: (f64, f64) = (0.02, 0.1);
/// Distance \[m\] and angle \[rad\] within which a source agrees with a person, who looks at the floor.
const BY_EYE: (f64, f64) = (0.5, 0.5);

/// Number of answers that are kept for people who repeat their statement.
const ANSWERS: usize = 16;

/// Reason for which a pose is refused.
const OUT_OF_REACH: &str = "a pose is further away than its robot can have driven";

/// Whether a robot stands, from what was measured of it.
#[derive(Clone, Debug, Default)]
struct Rest {
    /// Pose from which the robot has not moved since; `None` before the first measurement.
    from: Option<Fix>,
    newest: Time,
}

impl Rest {
    fn take(&mut self, fix: Fix, reading: &Reading) {
        self.newest = fix.at;
        let turns = reading.twist.yaw_rate.is_some_and(|rate| rate.abs() > MOVES.1);
        let moves = fix.has_speed() && (reading.twist.velocity.norm() > MOVES.0 || turns);
        let stays = |from: &Fix| {
            let near = from.distance(&fix) <= STANDS.0 + from.noise_m(&fix);
            near && from.turn(&fix).is_none_or(|turn| turn <= STANDS.1 + from.noise_rad(&fix))
        };
        if moves || !self.from.as_ref().is_some_and(stays) {
            self.from = Some(fix);
        }
    }

    /// Returns whether the robot has moved in the time `STOOD`, as far as is known.
    fn moves(&self, now: Time) -> bool {
        self.from.is_some_and(|from| now.since(from.at) < STOOD)
    }
}

/// What a Screen knows of one robot.
#[derive(Clone, Debug, Default)]
struct Watched {
    limits: Limits,
    track: Track,
    /// Motion by the source's readings, and by the robot's own odometry.
    by_source: Rest,
    by_odometry: Rest,
    /// Newest pose of the source, in its own frame; `None` before the first.
    measured: Option<Fix>,
    /// Pose of a dead-reckoning source's frame since a person has said where the robot is.
    frame: Option<Alignment>,
    /// What was last sent of the robot.
    told: Option<Whereabouts>,
}

/// Judge of the readings of one source of real robots.
#[derive(Clone, Debug)]
pub struct Screen {
    host: HostId,
    robots: BTreeMap<RobotId, Watched>,
    /// Answers to the last statements of people, which repeat them.
    answered: VecDeque<Placed>,
    /// Time of the next repetition of which robots are lost; `None` while none is.
    next: Option<Time>,
}

impl Screen {
    /// Makes the screen of the source of the host `host`, which measures `robots` with these limits of their motion.
    pub fn new(host: HostId, robots: BTreeMap<RobotId, Limits>) -> Screen {
        let watched = |(robot, limits)| (robot, Watched { limits, ..Watched::default() });
        Screen { host, robots: robots.into_iter().map(watched).collect(), answered: VecDeque::new(), next: None }
    }

    /// Tells the source the limits of each robot.
    pub(crate) fn introduce(&self, source: &mut dyn Source) {
        self.robots.iter().for_each(|(robot, watched)| source.limit(*robot, &watched.limits));
    }

    /// Notes odometry of a robot, which shows whether the robot moves.
    pub(crate) fn odometry(&mut self, now: Time, reading: &Reading) {
        if let Some(watched) = self.robots.get_mut(&reading.robot) {
            watched.by_odometry.take(Fix::of(now, reading, Quality::RECKONED), reading);
        }
    }

    /// Judges an output of the source. Returns it unless it is a reading that is refused.
    pub(crate) fn judge(&mut self, now: Time, out: Out, quality: impl Fn(RobotId) -> Quality) -> Out {
        match out {
            Out::Reading(reading) => {
                let quality = quality(reading.robot);
                self.reading(now, reading, quality)
            }
            Out::Lost(robot, why) => {
                if let Some(watched) = self.robots.get_mut(&robot) {
                    watched.track.lose(why);
                }
                Out::RefusedOf(robot, why.reason())
            }
            refused @ (Out::Refused(_) | Out::RefusedOf(..)) => refused,
        }
    }

    fn reading(&mut self, now: Time, reading: Reading, quality: Quality) -> Out {
        let robot = reading.robot;
        let Some(watched) = self.robots.get_mut(&robot) else { return Out::Reading(reading) };
        let quality = match watched.limits.drifts {
            // Of a source that does not know that it is odometry.
            Some(true) if !quality.reckoned => odometry::quality(&reading.pose),
            Some(drifts) => Quality { reckoned: drifts, ..quality },
            None => quality,
        };
        let measured = Fix::of(now, &reading, quality);
        watched.by_source.take(measured, &reading);
        watched.measured = Some(measured);
        let reading = match watched.frame.filter(|_| quality.reckoned) {
            Some(frame) => frame.reading(&reading),
            None => reading,
        };
        if let Some(why) = reading.unfit() {
            return Out::RefusedOf(robot, why);
        }
        let limits = watched.limits;
        match watched.track.take(Fix::of(now, &reading, quality), &limits) {
            Plausibility::Accepted | Plausibility::Settled => Out::Reading(reading),
            Plausibility::Refused => {
                self.find_cause(robot);
                Out::RefusedOf(robot, OUT_OF_REACH)
            }
        }
    }

    /// Finds out whether the jump of a robot has a cause that concerns other robots, too, and marks all of them.
    fn find_cause(&mut self, robot: RobotId) {
        let Some(watched) = self.robots.get(&robot).filter(|watched| watched.track.whereabouts().is_lost()) else {
            return;
        };
        let Some((own, jumped)) = watched.track.accepted().zip(watched.track.refused()) else { return };
        if watched.track.whereabouts() != Whereabouts::Jumped {
            return;
        }
        let (mut causes, mut own_cause) = (Vec::new(), None);
        for (other, theirs) in self.robots.iter().filter(|(other, _)| **other != robot) {
            let Some(before) = theirs.track.accepted() else { continue };
            if jumped.distance(before) < EXCHANGED_M && jumped.distance(own).min(own.distance(before)) > EXCHANGED_M {
                own_cause = Some(Whereabouts::Exchanged);
                continue;
            }
            let Some(after) = theirs.track.refused() else { continue };
            let together = jumped.at.since(after.at).max(after.at.since(jumped.at)) <= TOGETHER;
            let change_m = (jumped.distance(after) - own.distance(before)).abs();
            // Both have driven on since they were last seen in their places.
            let driven_s = jumped.at.since(own.at).max(after.at.since(before.at)).as_secs();
            let driven_m = (2.0 * watched.limits.speed_m_s.max(theirs.limits.speed_m_s) * driven_s).min(DRIVEN_M);
            if together && change_m <= RIGID_M + driven_m + jumped.noise_m(after) {
                own_cause = own_cause.or(Some(Whereabouts::Shifted));
                causes.push(*other);
            }
        }
        if let Some(why) = own_cause {
            self.robots.get_mut(&robot).into_iter().for_each(|watched| watched.track.blame(why));
        }
        for other in causes {
            let theirs = self.robots.get_mut(&other).filter(|w| w.track.whereabouts() == Whereabouts::Jumped);
            theirs.into_iter().for_each(|watched| watched.track.blame(Whereabouts::Shifted));
        }
    }

    /// Takes a person's statement of where a robot is. `None` if another host measures the robot.
    pub(crate) fn place(&mut self, now: Time, place: &Place, source: &mut dyn Source) -> Option<Located> {
        let watched = self.robots.get_mut(&place.robot)?;
        let mut answers = self.answered.iter();
        let known = answers.find(|answer| (answer.by, answer.number) == (place.by, place.number)).copied();
        let answer = known.unwrap_or_else(|| {
            let verdict = watched.place(now, place, source);
            let measured = watched.measured.filter(|fix| now.since(fix.at) <= SILENT).map(|fix| fix.pose());
            match verdict.is_taken() {
                true => tracing::warn!("{} is placed by operator {}: {verdict:?}", place.robot, place.by.0),
                false => tracing::warn!("{} is not placed by operator {}: {verdict:?}", place.robot, place.by.0),
            }
            Placed { by: place.by, number: place.number, robot: place.robot, verdict, measured }
        });
        if known.is_none() {
            self.answered.push_back(answer);
            if self.answered.len() > ANSWERS {
                self.answered.pop_front();
            }
        }
        let told = self.report(now);
        Some(Located {
            answer: Some(answer),
            ..told.unwrap_or(Located { host: self.host, robots: vec![], answer: None })
        })
    }

    /// Returns the message about the robots whose state has changed since the last one, or that are lost when a
    /// repetition is due. `None` if there is nothing to say.
    pub(crate) fn report(&mut self, now: Time) -> Option<Located> {
        let due = self.next.is_some_and(|next| next <= now);
        let mut robots = Vec::new();
        for (robot, watched) in &mut self.robots {
            let whereabouts = watched.track.whereabouts();
            let before = watched.told.unwrap_or(Whereabouts::Known);
            if whereabouts != before {
                match whereabouts.is_lost() {
                    true => tracing::error!("{robot} stands: {}; {}", whereabouts.reason(), whereabouts.remedy()),
                    false => tracing::warn!("{robot}: its pose is known again"),
                }
            }
            if (whereabouts != before || due && whereabouts.is_lost()) && robots.len() < MAX_BLOCK {
                watched.told = Some(whereabouts);
                robots.push((*robot, whereabouts));
            }
        }
        let lost = self.robots.values().any(|watched| watched.track.whereabouts().is_lost());
        if !robots.is_empty() || !lost {
            self.next = lost.then_some(now + REPEAT);
        }
        (!robots.is_empty()).then_some(Located { host: self.host, robots, answer: None })
    }

    /// Returns the time at which `report` is due again; `None` while no robot is lost.
    pub(crate) fn wake_at(&self) -> Option<Time> {
        self.next
    }
}

impl Watched {
    fn place(&mut self, now: Time, place: &Place, source: &mut dyn Source) -> PlaceAnswer {
        let newest = self.by_source.newest.max(self.by_odometry.newest);
        if self.by_source.from.is_none() && self.by_odometry.from.is_none() || now.since(newest) > SILENT {
            return PlaceAnswer::Unmeasured;
        }
        if self.by_source.moves(now) || self.by_odometry.moves(now) {
            return PlaceAnswer::Moves;
        }
        if source.place(now, place.robot, &place.pose) {
            let odometry = self.by_odometry.from.or(self.by_source.from).expect("one of them was measured");
            self.track.place(odometry.placed(now, &place.pose));
            return PlaceAnswer::Aligned;
        }
        let Some(measured) = self.measured.filter(|fix| now.since(fix.at) <= SILENT) else {
            return PlaceAnswer::Unmeasured;
        };
        let placed = measured.placed(now, &place.pose);
        if measured.is_reckoned() {
            let Some(frame) = self.frame_for(&measured.pose(), &place.pose) else { return PlaceAnswer::Differs };
            self.frame = Some(frame);
            self.track.place(placed);
            return PlaceAnswer::Aligned;
        }
        let near = measured.distance(&placed) <= BY_EYE.0 && measured.turn(&placed).is_none_or(|turn| turn <= BY_EYE.1);
        if near {
            self.track.place(measured);
            return PlaceAnswer::Agrees;
        }
        PlaceAnswer::Differs
    }

    /// Returns the pose of the source's frame in which a robot that is measured at `measured` is at `placed`; `None` if
    /// it is out of range.
    fn frame_for(&self, measured: &Pose, placed: &Pose) -> Option<Alignment> {
        let [from, to] = [measured, placed].map(|pose| {
            let heading = pose.heading.map(f64::from);
            ([f64::from(pose.position.x), f64::from(pose.position.y)], heading)
        });
        let yaw = from.1.zip(to.1).map(|(from, to)| to - from);
        Alignment::between(from.0, to.0, yaw.unwrap_or_else(|| self.frame.unwrap_or_default().heading(0.0)))
    }
}
