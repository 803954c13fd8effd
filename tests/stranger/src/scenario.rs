//! The scenario `round`: robots stand on a circle with one free place, and each moves to the next place.

use std::f32::consts::TAU;
use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::observation::{Channel, PolicyFrame, Quantity, Unit};
use murmurate::random::{Rng, Seed};
use murmurate::scenario::{Arena, Entry, Progress, Rules, Scenario, ScenarioError, Settings, TeamSizes};
use murmurate::time::Span;

/// Entry in a registry.
pub const ROUND: Entry = Entry { name: "round", about: "robots on a circle go on to the next place", build };

/// Distance of the places from the centre \[m\].
const RADIUS_M: f32 = 1.5;

#[derive(Debug)]
struct Round {
    robots: usize,
    arena: Arena,
}

fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let robots = TeamSizes::new(1, 8).check(ROUND.name, settings.robots.unwrap_or(5))?;
    if let Some(gap_m) = settings.gap_m {
        return Err(ScenarioError::Gap { scenario: ROUND.name.to_owned(), gap_m, hint: "; it has no walls" });
    }
    Ok(Arc::new(Round { robots, arena: Arena::new(Vec2::new(2.5, 2.5), Vec::new(), 0.25) }))
}

impl Round {
    /// Returns the place of a robot before this episode \[m\].
    fn place(&self, seed: u64, episode: u32, robot: usize) -> Vec2 {
        let turned = Seed::of_run(seed).stream("round/turned").next_u32() as f32 / u32::MAX as f32;
        let angle = TAU * (turned + (robot as f32 + episode as f32) / (self.robots + 1) as f32);
        Vec2::new(angle.cos(), angle.sin()) * RADIUS_M
    }
}

impl Scenario for Round {
    fn name(&self) -> &'static str {
        ROUND.name
    }

    fn robots(&self) -> usize {
        self.robots
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
        let place = |episode, robot| self.place(seed, episode, robot);
        (0..self.robots).map(|robot| Task { start: place(episode, robot), goal: place(episode + 1, robot) }).collect()
    }

    fn channels(&self) -> Vec<Channel> {
        let shape = (vec![2], Unit::Metre, Quantity::Vector);
        vec![Channel::new("chord", "from the robot to its goal", shape, |known, out| {
            out.copy_from_slice((known.own.goal - known.own.motion.position).as_slice());
        })]
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    /// Returns the speed toward the goal, minus one for a contact.
    fn reward(&self, task: &Task, after: &Motion, contacts: Contacts, stage: &mut Progress) -> Option<f32> {
        if self.reached(task, after.position) {
            *stage = Progress(1);
        }
        let way = (task.goal - after.position).try_normalize(1e-6).unwrap_or_default();
        Some(way.dot(&after.velocity) - if contacts.robot || contacts.wall { 1.0 } else { 0.0 })
    }

    fn rules(&self) -> Rules {
        Rules { arrival_m: 0.25, separation_m: 0.32, limit: Span::from_secs(25.0) }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_scenario_keeps_the_contract_of_scenarios() {
        murmurate::scenario::contract::check(&super::ROUND).unwrap();
    }
}
