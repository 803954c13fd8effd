//! Timeline of a record: its events in the order of time, from which the state of the team at any time is computed. The
//! code is pure.

use super::status::{Mark, MarkKind};
use super::team_view::TeamView;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::local::Truth;
use murmurate::messages::wire::Wire;
use murmurate::results::episode::Episode;
use murmurate::safety::guard::SafetyCounts;
use murmurate::time::{Span, Time};

/// Number of states of the team that a timeline stores between start and end of a record. To jump to a time, events are
/// applied to the last stored state before it.
const PICTURES: u64 = 64;
/// Largest number of marks of one kind on the timeline of a record; later ones are left out.
const MARKS: usize = 400;

/// Event of a record that changes the state of the team on the live page.
#[derive(Clone, Debug, PartialEq)]
pub enum Sight {
    /// A message that a host has published. If the record of that host is missing, one that has arrived at another
    /// host.
    Message(Wire),
    /// This robot has sent a message to this host alone. Of an imported run, which has no messages themselves.
    Sent(HostId, RobotId),
    /// A latent of this robot has arrived at this host.
    Arrived(HostId, RobotId),
    /// True states of the simulated robots at one instant.
    Truth(Truth),
    /// Result of an episode.
    Judged(Episode),
    /// Numbers of times that this robot's guard has stopped or slowed it, by cause.
    Guard(RobotId, SafetyCounts),
    /// Battery charge of this robot \[%\].
    Battery(RobotId, u8),
}

/// Events of a record in the order of time, with marks and with stored states of the team, from which the state at any
/// time is computed.
#[derive(Debug)]
pub struct Timeline {
    sights: Vec<(Time, Sight)>,
    /// Number of preceding events and the state after them, for each stored state.
    pictures: Vec<(usize, TeamView)>,
    marks: Vec<Mark>,
}

impl TeamView {
    /// Updates the state of the team with an event of a record, which happened at the time `now`.
    pub fn take(&mut self, now: Time, sight: &Sight) {
        match sight {
            Sight::Message(message) => self.receive(now, message),
            Sight::Sent(host, robot) => self.sent(*host, *robot),
            Sight::Arrived(host, robot) => self.arrived(now, *host, *robot),
            Sight::Truth(truth) => self.see(truth),
            Sight::Judged(episode) => self.judged(now, episode),
            Sight::Guard(robot, counts) => self.guarded(now, *robot, *counts),
            Sight::Battery(robot, percent) => self.charged(*robot, *percent),
        }
    }
}

impl Timeline {
    /// Returns the timeline of a record from its events, each with its time. `view` is the state of the team before the
    /// first event. Events at equal times keep their order.
    pub fn new(view: TeamView, mut sights: Vec<(Time, Sight)>) -> Timeline {
        sights.sort_by_key(|(at, _)| *at);
        let end = sights.last().map_or(Time::ZERO, |(at, _)| *at);
        let period = Span::from_nanos((end.as_nanos() / PICTURES).max(1));
        let mut timeline = Timeline { sights, pictures: vec![(0, view.clone())], marks: Vec::new() };
        let (mut view, mut due, mut latch) = (view, Time::ZERO + period, "clear");
        for (taken, (at, sight)) in timeline.sights.iter().enumerate() {
            if *at >= due {
                timeline.pictures.push((taken, view.clone()));
                due = *at + period;
            }
            let lines = view.log_count();
            view.take(*at, sight);
            let kind = match sight {
                Sight::Judged(episode) if !episode.verdict.is_failure() => Some(MarkKind::Success),
                Sight::Judged(_) => Some(MarkKind::Failure),
                Sight::Guard(..) if view.log_count() > lines => Some(MarkKind::Guard),
                Sight::Message(Wire::Mode(_) | Wire::Heartbeat(_)) if view.latch().word() != latch => {
                    latch = view.latch().word();
                    Some(MarkKind::Stop)
                }
                _ => None,
            };
            let Some(kind) = kind.filter(|kind| timeline.marks.iter().filter(|m| m.kind == *kind).count() < MARKS)
            else {
                continue;
            };
            let text = if kind == MarkKind::Stop { format!("emergency stop: {latch}") } else { view.last_line() };
            timeline.marks.push(Mark { at_s: at.as_secs(), kind, text });
        }
        timeline
    }

    /// Returns the time of the last event of the record; zero if there is none.
    pub fn end(&self) -> Time {
        self.sights.last().map_or(Time::ZERO, |(at, _)| *at)
    }

    /// Returns the marks on the timeline of the record, in the order of time.
    pub fn marks(&self) -> &[Mark] {
        &self.marks
    }

    /// Returns the state of the team at the time `at` of the record, and the number of events up to it.
    pub fn picture(&self, at: Time) -> (TeamView, usize) {
        let wanted = self.sights.partition_point(|(time, _)| *time <= at);
        let before = self.pictures.partition_point(|(taken, _)| *taken <= wanted) - 1;
        let (mut taken, mut view) = self.pictures[before].clone();
        self.advance(&mut view, &mut taken, at);
        (view, taken)
    }

    /// Advances `view`, the state of the team, to the later time `to`. `taken` is the number of events that the state
    /// includes, and is updated.
    pub fn advance(&self, view: &mut TeamView, taken: &mut usize, to: Time) {
        while let Some((at, sight)) = self.sights.get(*taken).filter(|(at, _)| *at <= to) {
            view.take(*at, sight);
            *taken += 1;
        }
    }

    /// Returns the time of the next change of the robots' states after `now`; if `back` is true, the time of the last
    /// change before `now`. Without such a change, returns the end or the start of the record.
    pub fn step(&self, now: Time, back: bool) -> Time {
        let moves = |(_, sight): &&(Time, Sight)| match sight {
            Sight::Truth(_) => true,
            Sight::Message(message) => matches!(message, Wire::Latent(_) | Wire::Reading(_) | Wire::Telemetry(_)),
            _ => false,
        };
        if back {
            let before = self.sights.partition_point(|(at, _)| *at < now);
            self.sights[..before].iter().rev().find(moves).map_or(Time::ZERO, |(at, _)| *at)
        } else {
            let after = self.sights.partition_point(|(at, _)| *at <= now);
            self.sights[after..].iter().find(moves).map_or(self.end(), |(at, _)| *at)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::Scene;
    use murmurate::messages::geometry::{Motion, Vec2};
    use murmurate::messages::wire::{Features, Latent, Phase, Round};

    fn latent(robot: u16, x: f32) -> Sight {
        let motion = Motion::at_rest(Vec2::new(x, 0.0));
        let (round, phase) = (Round::default(), Phase::Running);
        let features = Features(Vec::new().into());
        Sight::Message(Wire::Latent(Latent { robot: RobotId(robot), round, phase, motion, features, part: None }))
    }

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn timeline() -> Timeline {
        let scene = Scene { robots: 2, hears_links: true, ..Scene::default() };
        let view = TeamView::new(scene, vec![HostId(0), HostId(1)], 2);
        let mut sights = Vec::new();
        for step in 0..400 {
            let robot = (step % 2) as u16;
            sights.push((at(50 * step), latent(robot, step as f32 / 100.0)));
            sights.push((at(50 * step + 20), Sight::Arrived(HostId(1 - robot), RobotId(robot))));
        }
        let counts = SafetyCounts { fence: 1, ..SafetyCounts::default() };
        sights.push((at(7000), Sight::Guard(RobotId(1), counts)));
        Timeline::new(view, sights)
    }

    #[test]
    fn a_jump_shows_what_playing_to_there_shows() {
        let timeline = timeline();
        let (mut view, mut taken) = timeline.picture(Time::ZERO);
        for ms in (0..=20_500).step_by(130) {
            timeline.advance(&mut view, &mut taken, at(ms));
            let (jumped, count) = timeline.picture(at(ms));
            assert_eq!((jumped.snapshot(at(ms)), count), (view.snapshot(at(ms)), taken), "at {ms} ms");
        }
        assert_eq!(taken, 801);
        assert_eq!(timeline.marks().len(), 1);
        assert_eq!((timeline.marks()[0].at_s, &*timeline.marks()[0].text), (7.0, "robot 1: geofence"));
    }

    #[test]
    fn a_step_goes_to_the_next_state_and_back() {
        let timeline = timeline();
        assert_eq!(timeline.step(at(120), false), at(150));
        assert_eq!(timeline.step(at(150), true), at(100));
        assert_eq!(timeline.step(at(0), true), Time::ZERO);
        assert_eq!(timeline.step(at(19_960), false), timeline.end());
    }
}
