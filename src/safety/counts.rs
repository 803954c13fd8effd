//! Counts of the activations of a guard.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

use crate::messages::trigger::Trigger;

/// Number of activations of each safety trigger, for one robot or summed over robots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SafetyCounts {
    /// Number of times that the emergency stop became active.
    pub stop: u64,
    /// Number of times that the state server fell silent.
    pub silence: u64,
    /// Number of times that a policy's output became not finite.
    pub output: u64,
    /// Number of times that control ticks began to be late or missing, or to fail.
    pub late_tick: u64,
    /// Number of times that a robot's own state became too old.
    pub own_state: u64,
    /// Number of times that a robot's battery or temperature went beyond its limit.
    pub hardware: u64,
    /// Number of times that a robot's estimated position went further beyond the edge of the arena than
    /// `geofence_stop_m` allows, which stops the robot. Counted once until it is back.
    pub outside: u64,
    /// Number of times that the geofence began to limit commands.
    pub fence: u64,
    /// Number of times that the minimum distance to neighbours began to limit commands.
    pub distance: u64,
    /// Number of times that the minimum distance to walls, or the edge of the ground, began to limit commands.
    pub walls: u64,
    /// Number of times that a robot's measured pose jumped further than it can drive, which stops the robot until its
    /// pose is known again.
    pub jump: u64,
    /// Number of times that messages of another robot about its own motion began to contradict the tracker, which stops
    /// no robot.
    pub claim: u64,
}

impl SafetyCounts {
    /// Returns the number of times that `trigger` has become active.
    pub fn of(&self, trigger: Trigger) -> u64 {
        match trigger {
            Trigger::Stop => self.stop,
            Trigger::Silence => self.silence,
            Trigger::Output => self.output,
            Trigger::LateTick => self.late_tick,
            Trigger::OwnState => self.own_state,
            Trigger::Hardware => self.hardware,
            Trigger::Outside => self.outside,
            Trigger::Fence => self.fence,
            Trigger::Distance => self.distance,
            Trigger::Walls => self.walls,
            Trigger::Jump => self.jump,
            Trigger::Claim => self.claim,
        }
    }

    /// Returns a mutable reference to the number of times that `trigger` has become active.
    pub(crate) fn of_mut(&mut self, trigger: Trigger) -> &mut u64 {
        match trigger {
            Trigger::Stop => &mut self.stop,
            Trigger::Silence => &mut self.silence,
            Trigger::Output => &mut self.output,
            Trigger::LateTick => &mut self.late_tick,
            Trigger::OwnState => &mut self.own_state,
            Trigger::Hardware => &mut self.hardware,
            Trigger::Outside => &mut self.outside,
            Trigger::Fence => &mut self.fence,
            Trigger::Distance => &mut self.distance,
            Trigger::Walls => &mut self.walls,
            Trigger::Jump => &mut self.jump,
            Trigger::Claim => &mut self.claim,
        }
    }

    /// Returns the sum of the counts of all triggers.
    pub fn total(&self) -> u64 {
        Trigger::ALL.into_iter().map(|trigger| self.of(trigger)).sum()
    }

    /// Returns the counts above zero, each with the short name of its trigger for reports.
    pub fn reasons(&self) -> impl Iterator<Item = (u64, &'static str)> {
        let all = Trigger::ALL.map(|trigger| (self.of(trigger), trigger.name()));
        all.into_iter().filter(|(times, _)| *times > 0)
    }

    /// Returns the triggers that have acted since `before`, earlier counts of the same guard.
    pub fn begun_since(&self, before: &SafetyCounts) -> impl Iterator<Item = Trigger> {
        let (now, before) = (*self, *before);
        Trigger::ALL.into_iter().filter(move |trigger| now.of(*trigger) > before.of(*trigger))
    }
}

impl Sum for SafetyCounts {
    fn sum<I: Iterator<Item = SafetyCounts>>(all: I) -> SafetyCounts {
        all.fold(SafetyCounts::default(), |sum, one| SafetyCounts {
            stop: sum.stop + one.stop,
            silence: sum.silence + one.silence,
            output: sum.output + one.output,
            late_tick: sum.late_tick + one.late_tick,
            own_state: sum.own_state + one.own_state,
            hardware: sum.hardware + one.hardware,
            outside: sum.outside + one.outside,
            fence: sum.fence + one.fence,
            distance: sum.distance + one.distance,
            walls: sum.walls + one.walls,
            jump: sum.jump + one.jump,
            claim: sum.claim + one.claim,
        })
    }
}
