//! Scenarios `coverage` and `coverage-table`: a team spreads over a ground so that what is important is near a robot.
//!
//! Robots have no goals. The goals of their tasks are the means of the Gaussians of the density instead, so that every
//! part of a run knows the density of an episode from its tasks. A policy sees of it what a robot's sensor covers, the
//! channel `density`, and what the robot has seen so far, the channels `map` and `coarse-map`. The whole density is the
//! channel `means`, for baselines.

use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::observation::{Channel, PolicyFrame};
use murmurate::random::{RngExt, Seed};
use murmurate::scenario::{Arena, Cost, Entry, Progress, Rules, Scenario, ScenarioError, Settings};

use crate::ground::{Fitted, NO_WALLS, price};

use super::{
    channels,
    cost::cost,
    field::{Field, place},
    size::{PUBLISHED, Size, TABLE, TRUNCATION},
};

/// Entry of the scenario of the published size.
pub const COVERAGE: Entry = Entry {
    name: PUBLISHED.basics.name,
    about: "a team spreads over 1024 m so that what is important is near a robot; robots have no goals",
    build: |settings| build(&PUBLISHED, settings, |team, goals| mean_square(&PUBLISHED, team, goals)),
};

/// Entry of the scenario for a table.
pub const COVERAGE_TABLE: Entry = Entry {
    name: TABLE.basics.name,
    about: "the same for a few small robots on 2 m",
    build: |settings| build(&TABLE, settings, |team, goals| mean_square(&TABLE, team, goals)),
};

/// Share of the ground that robots may occupy with the room that they keep free, so that places for all are found soon.
const CROWDED: f32 = 0.5;

/// Scenario of coverage.
#[derive(Debug)]
struct Coverage {
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
    let (robots, robot_radius_m) = (fitted.robots, fitted.robot_radius_m);
    let half_m = size.grid.side_m() as f32 / 2.0 - robot_radius_m;
    let occupied = robots as f32 * std::f32::consts::PI * 4.0 * robot_radius_m * robot_radius_m;
    if half_m <= 0.0 || occupied > CROWDED * 4.0 * half_m * half_m {
        let why = "has no room for so many robots of this hull: take fewer or smaller ones";
        return Err(size.basics.refused("hull_m", why));
    }
    let arena = fitted.arena(Vec2::repeat(half_m));
    Ok(Arc::new(Coverage { size, fitted, arena, cost }))
}

/// Returns the mean squared distance \[m²\] of what is important from the nearest robot: the coverage cost relative to
/// the sum of the density.
fn mean_square(size: &Size, team: &[Motion], goals: &[Vec2]) -> f64 {
    let features = size.features(goals.iter().copied());
    let field = Field::of_features(size.grid, &features, TRUNCATION).expect("goals are places");
    let mass: f64 = (0..size.grid.cells).map(|row| field.sums(row, 0..size.grid.cells).mass).sum();
    let robots: Vec<_> = team.iter().map(|motion| size.on_ground(motion.position)).collect();
    if mass > 0.0 { cost(&field, &robots) / mass } else { 0.0 }
}

impl Scenario for Coverage {
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
        let mut stream = Seed::of_run(seed).stream(&format!("coverage/layout/{episode}"));
        let half_m = self.arena.half_extent.x;
        let apart_m = 2.0 * self.arena.robot_radius_m * 1.001;
        let place_of = || Vec2::new(stream.random_range(-half_m..half_m), stream.random_range(-half_m..half_m));
        let starts = self.fitted.starts(apart_m, place_of);
        let goal = |start: Vec2| Task { start, goal: self.size.in_world(place(self.size.grid, &mut stream)) };
        starts.into_iter().map(goal).collect()
    }

    fn cost(&self) -> Option<Cost> {
        Some(Cost { name: "mean squared distance", unit: "m2", of: self.cost })
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    fn channels(&self) -> Vec<Channel> {
        let Coverage { size, fitted, .. } = self;
        let means = channels::means(fitted.robots);
        vec![channels::density(size), channels::map(size), channels::coarse_map(size), means]
    }

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

    fn built(entry: &Entry) -> Arc<dyn Scenario> {
        (entry.build)(&Settings::default()).expect("the default team")
    }

    #[test]
    fn both_scenarios_keep_what_trials_and_training_require() {
        for entry in [COVERAGE, COVERAGE_TABLE] {
            contract::check(&entry).expect("a sound scenario");
        }
    }

    #[test]
    fn the_cost_falls_as_robots_go_to_what_is_important() {
        let scenario = built(&COVERAGE_TABLE);
        let tasks = scenario.tasks(1, 0);
        let goals: Vec<Vec2> = tasks.iter().map(|task| task.goal).collect();
        let cost = |places: &[Vec2]| {
            let team: Vec<Motion> = places.iter().map(|at| Motion::at_rest(*at)).collect();
            (scenario.cost().expect("it has no goals").of)(&team, &goals)
        };
        let starts: Vec<Vec2> = tasks.iter().map(|task| task.start).collect();
        assert!(cost(&goals) < cost(&starts), "{} {}", cost(&goals), cost(&starts));
        // With a robot at each mean, what remains is within the deviations.
        assert!(cost(&goals) < 2.0 * 0.25 * 0.25);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let refused = |settings: Settings| (COVERAGE_TABLE.build)(&settings).expect_err("a refusal").to_string();
        assert!(refused(Settings { scale: Some(2.0), ..Settings::default() }).contains("1024 m"));
        assert!(refused(Settings { hull_m: Some(0.3), ..Settings::default() }).contains("smaller"));
        assert!(refused(Settings::of(9)).contains("2 to 8"));
        assert!(refused(Settings { gap_m: Some(1.0), ..Settings::default() }).contains("no walls"));
    }
}
