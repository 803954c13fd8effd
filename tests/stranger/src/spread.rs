//! The scenario `spread`: three robots cover three landmarks and keep off each other, as in `MPE_simple_spread_v3` of
//! JaxMARL (`jaxmarl/environments/mpe/simple_spread.py`).
//!
//! A robot has no landmark of its own: the goals of the tasks are the landmarks. The cost of a step is what the team's
//! reward lacks, so the return of an episode is minus 25 times its cost.

use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::observation::{Channel, PolicyFrame, Quantity, Unit};
use murmurate::random::{Rng, Seed};
use murmurate::scenario::{Arena, Cost, Entry, Rules, Scenario, ScenarioError, Settings, TeamSizes};

use crate::mpe::{PERIOD, TOUCH_M};

/// Entry in a registry.
pub const SPREAD: Entry = Entry { name: "spread", about: "three robots cover three landmarks, as in JaxMARL", build };

/// Number of robots, and of landmarks.
const ROBOTS: usize = 3;
/// Steps of an episode.
const STEPS: u64 = 25;
/// Radius by which robots are judged to collide \[m\]. Contacts of particles are part of the cost and fail no episode.
const HARD_M: f32 = 1e-3;

#[derive(Debug)]
struct Spread {
    arena: Arena,
}

fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    TeamSizes::new(ROBOTS, ROBOTS).check(SPREAD.name, settings.robots.unwrap_or(ROBOTS))?;
    if let Some(gap_m) = settings.gap_m {
        return Err(ScenarioError::Gap { scenario: SPREAD.name.to_owned(), gap_m, hint: "; it has no walls" });
    }
    Ok(Arc::new(Spread { arena: arena() }))
}

/// Returns the ground, whose edge no particle reaches in an episode.
pub fn arena() -> Arena {
    Arena::new(Vec2::new(20.0, 20.0), Vec::new(), HARD_M)
}

/// Returns minus the sum of the rewards of all robots for one step. Each has half of minus its contacts, and half of
/// minus the distances of all landmarks from the nearest robot.
fn cost(team: &[Motion], landmarks: &[Vec2]) -> f64 {
    let from_nearest = |landmark: &Vec2| {
        team.iter().map(|motion| f64::from((motion.position - landmark).norm())).fold(f64::INFINITY, f64::min)
    };
    let uncovered: f64 = landmarks.iter().map(from_nearest).sum();
    let touches = |one: usize, other: usize| (team[one].position - team[other].position).norm() < TOUCH_M;
    let pairs = (0..team.len()).flat_map(|one| (0..one).map(move |other| (one, other)));
    let contacts = pairs.filter(|(one, other)| touches(*one, *other)).count();
    // A contact is one of both robots.
    0.5 * 2.0 * contacts as f64 + 0.5 * team.len() as f64 * uncovered
}

impl Scenario for Spread {
    fn name(&self) -> &'static str {
        SPREAD.name
    }

    fn robots(&self) -> usize {
        ROBOTS
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
        let mut stream = Seed::of_run(seed).stream(&format!("spread/layout/{episode}"));
        let mut axis = || 2.0 * (stream.next_u32() as f32 / u32::MAX as f32) - 1.0;
        let mut point = || Vec2::new(axis(), axis());
        loop {
            let tasks: Vec<Task> = (0..ROBOTS).map(|_| Task { start: point(), goal: point() }).collect();
            let apart = |one: usize, other: usize| (tasks[one].start - tasks[other].start).norm() > 4.0 * HARD_M;
            if (1..ROBOTS).all(|one| (0..one).all(|other| apart(one, other))) {
                return tasks;
            }
        }
    }

    fn cost(&self) -> Option<Cost> {
        Some(Cost { name: "lack of reward", unit: "1", of: cost })
    }

    fn channels(&self) -> Vec<Channel> {
        let shape = (vec![ROBOTS, 2], Unit::Metre, Quantity::Vector);
        vec![Channel::new("landmarks", "from the robot to each landmark", shape, |known, out| {
            let own = known.own.motion.position;
            for (at, pair) in out.chunks_exact_mut(2).enumerate() {
                let landmark = known.team.get(at).copied().flatten().map(|task| task.goal);
                pair.copy_from_slice(landmark.map_or(Vec2::repeat(f32::NAN), |landmark| landmark - own).as_slice());
            }
        })]
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    fn reached(&self, _: &Task, _: Vec2) -> bool {
        false
    }

    fn distance_to_go(&self, _: &Task, _: Vec2) -> f32 {
        0.0
    }

    fn rules(&self) -> Rules {
        Rules { arrival_m: 0.0, separation_m: HARD_M, limit: PERIOD * STEPS }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recorded;

    #[test]
    fn the_scenario_keeps_the_contract_of_scenarios() {
        murmurate::scenario::contract::check(&SPREAD).expect("it keeps the contract");
    }

    #[test]
    fn its_cost_is_minus_the_reward_of_jaxmarl() {
        for episode in recorded::episodes() {
            let landmarks: Vec<Vec2> = episode.landmarks.iter().copied().map(Vec2::from).collect();
            for step in &episode.steps[1..] {
                let found = cost(&step.motions(), &landmarks);
                assert!((found + step.reward).abs() <= 1e-5, "{found}, {}", step.reward);
            }
        }
    }
}
