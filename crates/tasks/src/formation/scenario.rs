//! Scenarios `formation` and `formation-table`: a team takes a wedge and keeps it on its way past waypoints.
//!
//! Robots have no goals. The goal of a robot's task is its place when the point of the wedge is at the second waypoint.

use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::observation::PolicyFrame;
use murmurate::random::{RngExt, Seed};
use murmurate::scenario::{Arena, Cost, Entry, Progress, Rules, Scenario, ScenarioError, Settings};

use crate::ground::{Fitted, NO_WALLS, price};

use super::size::{FORMATION, Size, TABLE};

/// Entry of the scenario for robots as in `passage`.
pub const FORMATION_ENTRY: Entry = Entry {
    name: FORMATION.basics.name,
    about: "a team keeps a wedge behind its leader on the way past waypoints; robots have no goals",
    build: |settings| build(&FORMATION, settings, |team, _| deviation(&FORMATION, team)),
};

/// Entry of the scenario for a table.
pub const TABLE_ENTRY: Entry = Entry {
    name: TABLE.basics.name,
    about: "the same for a few small robots on 3.2 m",
    build: |settings| build(&TABLE, settings, |team, _| deviation(&TABLE, team)),
};

/// Time in which the team falls behind by what it lacks of its speed, in the cost \[s\].
const BEHIND_S: f64 = 1.0;

/// Scenario of a formation.
#[derive(Debug)]
struct Formation {
    size: &'static Size,
    fitted: Fitted,
    arena: Arena,
    cost: fn(&[Motion], &[Vec2]) -> f64,
}

fn build(
    size: &'static Size,
    settings: &Settings,
    cost: fn(&[Motion], &[Vec2]) -> f64,
) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let fitted = size.basics.fit(settings, NO_WALLS)?;
    if fitted.hull_m > 1.3 * size.basics.hull_m {
        let why = "has places too near to each other for robots of this hull: take smaller ones";
        return Err(size.basics.refused("hull_m", why));
    }
    let arena = fitted.arena(Vec2::from(size.half_extent_m));
    Ok(Arc::new(Formation { size, fitted, arena, cost }))
}

/// Returns the middle one of the numbers, or the lower one of two.
fn median(mut numbers: Vec<f32>) -> f32 {
    numbers.sort_by(f32::total_cmp);
    numbers[(numbers.len() - 1) / 2]
}

/// Returns the mean squared distance of the robots from their places in the wedge \[m²\], plus the square of the way
/// that the team lacks in a second. The wedge is where the median of the robots has it, so that a lost robot moves it
/// little.
fn deviation(size: &Size, team: &[Motion]) -> f64 {
    let points: Vec<Vec2> = team.iter().enumerate().map(|(robot, at)| at.position - size.place(robot)).collect();
    let middle = |of: &dyn Fn(usize) -> Vec2| {
        let along = |axis: usize| median((0..team.len()).map(|robot| of(robot)[axis]).collect());
        Vec2::new(along(0), along(1))
    };
    let point = middle(&|robot| points[robot]);
    let velocity = middle(&|robot| team[robot].velocity);
    let squares = points.iter().map(|at| f64::from((at - point).norm_squared().min(size.farthest_m * size.farthest_m)));
    let lacks_m = f64::from(size.speed_m_s - velocity.norm()) * BEHIND_S;
    squares.sum::<f64>() / team.len() as f64 + lacks_m * lacks_m
}

impl Scenario for Formation {
    fn name(&self) -> &str {
        self.fitted.name
    }

    fn robots(&self) -> usize {
        self.fitted.robots
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
        let mut stream = Seed::of_run(seed).stream(&format!("{}/layout/{episode}", self.fitted.name));
        let [radius_m, spacing_m] = self.size.start_m;
        let mut place = || {
            let offset = Vec2::new(stream.random_range(-1.0..=1.0), stream.random_range(-1.0..=1.0));
            self.size.waypoint(0) + offset * radius_m
        };
        let is_on_ground = |at: &Vec2| (at.abs() - self.arena.half_extent).max() <= 0.0;
        let on_ground = || std::iter::repeat_with(&mut place).find(is_on_ground).expect("the ground has places");
        let starts = self.fitted.starts(spacing_m, on_ground);
        let goal = |robot: usize| self.size.waypoint(1) + self.size.place(robot);
        starts.into_iter().enumerate().map(|(robot, start)| Task { start, goal: goal(robot) }).collect()
    }

    fn cost(&self) -> Option<Cost> {
        Some(Cost { name: "deviation from the wedge", unit: "m2", of: self.cost })
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    /// Returns minus 1 for a contact.
    fn reward(&self, _: &Task, _: &Motion, contacts: Contacts, _: &mut Progress) -> Option<f32> {
        Some(-price(contacts))
    }

    fn rules(&self) -> Rules {
        self.fitted.rules()
    }
}

#[cfg(test)]
mod tests {
    use murmurate::scenario::contract;

    use super::*;

    #[test]
    fn both_scenarios_keep_what_trials_and_training_require() {
        for entry in [FORMATION_ENTRY, TABLE_ENTRY] {
            contract::check(&entry).expect("a sound scenario");
        }
    }

    #[test]
    fn a_wedge_that_moves_costs_nothing_and_a_lost_robot_costs_its_own_share() {
        let at = |robot: usize, off: Vec2| Motion {
            position: Vec2::new(1.0, 2.0) + FORMATION.place(robot) + off,
            velocity: Vec2::new(0.0, FORMATION.speed_m_s),
        };
        let mut team: Vec<Motion> = (0..5).map(|robot| at(robot, Vec2::zeros())).collect();
        assert!(deviation(&FORMATION, &team) < 1e-10);
        team[0] = Motion::at_rest(Vec2::new(9.0, 9.0));
        assert!((deviation(&FORMATION, &team) - 0.2).abs() < 1e-6, "{}", deviation(&FORMATION, &team));
        let standing: Vec<Motion> = (0..5).map(|robot| Motion::at_rest(FORMATION.place(robot))).collect();
        assert!((deviation(&FORMATION, &standing) - 0.16).abs() < 1e-6);
    }
}
