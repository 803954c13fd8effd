//! Exchange of messages among the robots of one Agent within a step: who is near whom, the hops of policies with
//! several, and what policies are told that compute the steps of all robots together.

use super::slot::{Outcome, Slot};
use super::{Agent, SharedData};
use crate::cells::{self, Cells};
use crate::messages::geometry::Vec2;
use crate::messages::local::NEAR_M;
use crate::observation::Observation;

impl Agent {
    /// Returns a grid of the positions of all robots with a percept, so that each robot examines only those nearby.
    /// Returns `None` for few robots and for a range drawn per message, which has no bound.
    pub(super) fn locate(&self) -> Option<Cells> {
        let ranges = || self.slots.iter().map(|slot| slot.policies.range);
        if self.slots.len() <= cells::LINEAR_SEARCH_MAX || ranges().any(|range| range.std_m > 0.0) {
            return None;
        }
        let farthest_m = ranges().fold(NEAR_M, |most, range| most.max(range.mean_m));
        let nowhere = Vec2::repeat(f32::NAN);
        let at = |shared: &Option<SharedData>| shared.map_or(nowhere, |shared| shared.motion.position);
        Cells::new(farthest_m, self.shared.iter().map(at))
    }

    /// Stores the slots of the robots near `position`, and perhaps others, in `near`.
    pub(super) fn find_near(&mut self, position: Vec2) {
        match &self.grid {
            Some(grid) => grid.near(position, &mut self.near),
            None => {
                self.near.clear();
                self.near.extend(0..self.slots.len());
            }
        }
    }

    /// Completes the latents of policies with several hops: the input of each hop is computed from the neighbours'
    /// newest input of the hop before. Those of the Agent's own robots are of this step, all others of the messages
    /// that have arrived, so nothing waits.
    pub(super) fn relay(&mut self) {
        let phase = self.phase;
        let hops = self.slots.iter_mut().map(|slot| slot.policies.of(phase).hops()).max().unwrap_or(1);
        for hop in 1..hops {
            (0..self.slots.len()).for_each(|at| self.relay_hop(hop, at));
            // All robots have read what the others shared; now the new inputs replace it.
            for (slot, shared) in self.slots.iter_mut().zip(&mut self.shared) {
                let Some(SharedData { features, .. }) = shared else { continue };
                let Some([begins, ends]) = features.map(|range| range.map(|at| at as usize)) else { continue };
                if slot.outcome == Outcome::Held {
                    continue;
                }
                slot.encoded(phase);
                if slot.outcome == Outcome::Sound {
                    self.features[begins..ends].copy_from_slice(&slot.features);
                } else {
                    *features = None;
                }
            }
        }
    }

    fn relay_hop(&mut self, hop: usize, at: usize) {
        let Some(SharedData { motion, features: Some(_), .. }) = self.shared[at] else { return };
        self.find_near(motion.position);
        let phase = self.phase;
        let slot = &mut self.slots[at];
        if slot.outcome == Outcome::Held {
            return;
        }
        let step = slot.step((self.round, phase), &self.features);
        let Slot { policies, percept: Some(percept), own, values, features, .. } = slot else { return };
        let companions = self.near.iter().filter(|other| **other != at).filter_map(|&other| self.shared[other]);
        // A message is drawn as received or not once a step, whatever the number of hops: by the same numbers.
        let mut ranges = policies.ranges.clone();
        let neighbours = step.neighbours(percept, companions, &mut ranges);
        let seen = Observation { values, ..*own };
        let policy = policies.of(phase);
        if hop < policy.hops() {
            policy.relay(hop, &seen, features, &neighbours);
        }
    }

    /// Tells the policy of the robot in slot `at` what its `act` gets.
    pub(super) fn prepare_act(&mut self, at: usize) {
        let Some(SharedData { motion, .. }) = self.shared[at] else { return };
        self.find_near(motion.position);
        let slot = &mut self.slots[at];
        let step = slot.step((self.round, self.phase), &self.features);
        let Slot { policies, percept: Some(percept), task: Some(_), own, values, features, outcome, .. } = slot else {
            return;
        };
        if !matches!(outcome, Outcome::Sound | Outcome::Silent) {
            return;
        }
        let companions = self.near.iter().filter(|other| **other != at).filter_map(|&other| self.shared[other]);
        // `act` draws the same numbers.
        let neighbours = step.neighbours(percept, companions, &mut policies.ranges.clone());
        policies.run.prepare_act(&Observation { values, ..*own }, features, &neighbours);
    }
}
