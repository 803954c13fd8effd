//! State of one robot of a team as a process knows it from the messages that it receives.

use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::messages::latch::Latch;
use murmurate::messages::place::Whereabouts;
use murmurate::messages::telemetry::GuardReport;
use murmurate::messages::trigger::Trigger;
use murmurate::messages::wire::{Flight, Phase};
use murmurate::safety::guard::SafetyCounts;
use murmurate::time::{Span, Time};

/// Time without a message of a robot after which the log calls it silent.
pub const SILENT: Span = Span::from_millis(1500);
/// Time after which the last action of a robot's guard is no longer shown.
const GUARD_AGE: Span = Span::from_millis(60_000);

/// State of one robot as known from received messages.
#[derive(Clone, Debug, Default)]
pub struct RobotView {
    /// Position of the robot \[m\], world frame; `None` before one was heard.
    pub position: Option<Vec2>,
    /// Heading \[rad\] and its time; `None` before one was heard.
    pub heading: Option<(Time, f32)>,
    /// Whether the position is the true one of a simulated robot.
    pub is_true: bool,
    /// Whether the robot touches another robot or a wall.
    pub touches: bool,
    /// Phase of the episode that the robot reported last.
    pub phase: Option<Phase>,
    /// Time of the last message about the robot.
    pub heard: Option<Time>,
    /// Time of the last message that shows that the process of its agent lives: a heartbeat if any was heard, or else
    /// any message of that host. Positions do not count: others measure them.
    pub agent: Option<Time>,
    /// Whether `agent` is of heartbeats.
    pub beats: bool,
    /// Time of its last latent.
    pub latent: Option<Time>,
    /// Whether the process of its agent has died and is not back yet.
    pub down: bool,
    /// Whether the log has reported the robot as silent.
    pub silent: bool,
    /// Emergency stop latch that its Controller follows.
    pub controller: Option<Latch>,
    /// Emergency stop latch that its Body follows.
    pub body: Option<Latch>,
    /// Battery charge \[%\].
    pub battery: Option<u8>,
    /// State of the flight of a robot that flies.
    pub flight: Option<Flight>,
    /// Age of the oldest link, as the robot's host has reported it, and the time of the report.
    pub oldest_link: Option<(Time, Span)>,
    /// Counts of its guard's actions.
    pub safety: SafetyCounts,
    /// Whether the host that measures the robot knows its pose.
    pub whereabouts: Whereabouts,
    /// Last action of the robot's guard, and its time if it is known.
    pub guard: Option<(Trigger, Option<Time>)>,
    /// Whether counts of the robot's guard, or a telemetry report of it, were received.
    pub guarded: bool,
    /// Number of times that the guard has acted, from telemetry.
    pub acted: u16,
    /// Another robot whose messages contradict the tracker, as this robot's host finds.
    pub suspect: Option<RobotId>,
    /// Whether the team's roster does not name the host of the robot's agent.
    pub revoked: bool,
}

impl RobotView {
    /// Returns the age of the robot's oldest link \[ms\] at the time `now`, from a report of its host; `None` without a
    /// recent one.
    pub fn link_age_ms(&self, now: Time) -> Option<u32> {
        let (at, age) = self.oldest_link.filter(|(at, _)| now.since(*at) < SILENT)?;
        Some(((age + now.since(at)).as_nanos() / 1_000_000) as u32)
    }

    /// Returns the time since the robot's agent was last heard, or any message about the robot if no agent is heard
    /// here; `None` if nothing was heard. `running` is the time since which the team runs an episode, in which an
    /// agent sends latents.
    pub fn age(&self, now: Time, running: Option<Time>) -> Option<Span> {
        let latents = self.latent.zip(running).map(|(last, since)| now.since(last.max(since)));
        let agent = self.agent.map(|at| now.since(at));
        latents.max(agent).or(self.heard.map(|at| now.since(at)))
    }

    /// Takes over whether the robot's pose is known. Returns what to log after the robot's name; `None` if nothing is
    /// new.
    pub fn locate(&mut self, whereabouts: Whereabouts) -> Option<String> {
        let before = std::mem::replace(&mut self.whereabouts, whereabouts);
        let said = match whereabouts.is_lost() {
            true => format!(" stands: {}; {}", whereabouts.reason(), whereabouts.remedy()),
            false => ": its pose is known again".to_owned(),
        };
        (before != whereabouts).then_some(said)
    }

    /// Takes over a telemetry report of the robot's guard. Returns the cause of the newest action; `None` if nothing is
    /// new. Of the actions between two reports only the last cause is known.
    pub fn reported(&mut self, now: Time, report: GuardReport) -> Option<Trigger> {
        let news = report.last.filter(|_| self.guarded && report.acted != self.acted);
        let first = report.last.filter(|_| !self.guarded).map(|trigger| (trigger, None));
        let guard = news.map(|trigger| (trigger, Some(now))).or(first).or(self.guard);
        (self.acted, self.guarded, self.guard) = (report.acted, true, guard);
        self.safety.late_tick = report.late_ticks.into();
        news
    }

    /// Takes over which other robot this robot's host suspects of false claims. Returns what to log; `None` if nothing
    /// is new.
    pub fn suspects(&mut self, suspect: Option<RobotId>) -> Option<String> {
        let before = std::mem::replace(&mut self.suspect, suspect);
        let said = match (suspect, before) {
            (Some(other), _) => format!("{other} is not where it says it is"),
            (None, other) => format!("{} is again where it says it is", other?),
        };
        (before != suspect).then_some(said)
    }

    /// Takes over whether the team's roster names the host of the robot `at`. Returns what to log; `None` if nothing is
    /// new.
    pub fn membership(&mut self, at: usize, revoked: bool) -> Option<String> {
        let before = std::mem::replace(&mut self.revoked, revoked);
        let said = if revoked { "was revoked: it may move uncontrolled" } else { "is in the roster again" };
        (before != revoked).then(|| format!("robot {at} {said}"))
    }

    /// Returns the last action of the robot's guard with its age \[s\], as long as it is relevant.
    pub fn last_guard(&self, now: Time) -> Option<(&'static str, Option<f64>)> {
        let (trigger, at) = self.guard?;
        let age = at.map(|at| now.since(at));
        let past = match trigger {
            Trigger::Stop => self.controller.is_some_and(|latch| latch.is_clear()),
            _ => age.is_some_and(|age| age >= GUARD_AGE),
        };
        (!past).then(|| (trigger.name(), age.map(Span::as_secs)))
    }
}
