//! Scenarios `flocking-field` and `flocking-field-table`: a team keeps the velocity of its migration and passes between
//! obstacles, which are others in each episode.
//!
//! Robots have no goals. As in the scenario `flocking`, the goal of a robot's task is the place that it would reach in
//! one second at its initial velocity.

use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::observation::{Channel, PolicyFrame};
use murmurate::random::{self, RngExt, Seed};
use murmurate::scenario::{Arena, Cost, Entry, KeepOut, Progress, Rules, Scenario, ScenarioError, Settings};

use crate::ground::{Fitted, price};

use super::size::{FIELD, Size, TABLE};

/// Entry of the scenario for a team as in `flocking`.
pub const FLOCKING_FIELD: Entry = Entry {
    name: FIELD.basics.name,
    about: "a team migrates through a field of obstacles at one velocity; robots have no goals",
    build: |settings| build(&FIELD, settings, |team, _| deviation(team, FIELD.migration())),
};

/// Entry of the scenario for a table.
pub const FLOCKING_FIELD_TABLE: Entry = Entry {
    name: TABLE.basics.name,
    about: "the same for a few small robots on 3.2 m",
    build: |settings| build(&TABLE, settings, |team, _| deviation(team, TABLE.migration())),
};

/// Share of the disc of the starts that robots may occupy with their spacing, so that places for all are found soon.
const CROWDED: f32 = 0.45;
/// Number of draws of an obstacle's place, before there is no room for it.
const TRIES: usize = 400;

/// Scenario of flocking through a field.
#[derive(Debug)]
struct Field {
    size: &'static Size,
    fitted: Fitted,
    /// Radius of the disc on which the robots start \[m\].
    start_m: f32,
    arena: Arena,
    cost: fn(&[Motion], &[Vec2]) -> f64,
}

fn build(
    size: &'static Size,
    settings: &Settings,
    cost: fn(&[Motion], &[Vec2]) -> f64,
) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let (basics, spacing_m) = (&size.basics, size.spacing_m);
    let fitted = basics.fit(settings, "; its obstacles are drawn")?;
    if fitted.hull_m > 1.2 * basics.hull_m {
        let why = "has no room between its obstacles for robots of this hull: take smaller ones";
        return Err(basics.refused("hull_m", why));
    }
    // As dense as the team of the usual size.
    let robots = fitted.robots as f32;
    let start_m = size.start_m[1] * (robots / basics.robots[0] as f32).sqrt().max(0.5);
    if robots * spacing_m * spacing_m > CROWDED * 4.0 * start_m * start_m {
        return Err(basics.refused("robots", "has no room for so many robots at the start: take fewer"));
    }
    let arena = fitted.arena(Vec2::from(size.half_extent_m));
    Ok(Arc::new(Field { size, fitted, start_m, arena, cost }))
}

/// Returns the mean squared distance of the robots' velocities from that of the migration \[m²/s²\]: the variance of
/// the velocities, which is the cost of a flock, and the square of what the flock's velocity lacks.
fn deviation(team: &[Motion], migration: Vec2) -> f64 {
    let squares = team.iter().map(|motion| f64::from((motion.velocity - migration).norm_squared()));
    squares.sum::<f64>() / team.len() as f64
}

impl Scenario for Field {
    fn name(&self) -> &str {
        self.fitted.name
    }

    fn robots(&self) -> usize {
        self.fitted.robots
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    fn drawn_arena(&self, seed: u64, episode: u32) -> Option<Arena> {
        let Size { obstacles, radius_m, apart_m, field_m: [left, low, right, high], .. } = *self.size;
        let mut stream = Seed::of_run(seed).stream(&format!("{}/obstacles/{episode}", self.fitted.name));
        let mut keep_outs: Vec<KeepOut> = Vec::with_capacity(obstacles);
        for _ in 0..obstacles {
            let free = (0..TRIES).find_map(|_| {
                let radius_m = stream.random_range(radius_m[0]..=radius_m[1]);
                let [x, y] = [stream.random_range(left..=right), stream.random_range(low..=high)];
                let disc = KeepOut::disc(Vec2::new(x, y), radius_m);
                keep_outs.iter().all(|other| other.apart_m(&disc) >= apart_m).then_some(disc)
            });
            keep_outs.extend(free);
        }
        Some(Arena { keep_outs, ..self.arena.clone() })
    }

    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
        let mut stream = Seed::of_run(seed).stream(&format!("{}/layout/{episode}", self.fitted.name));
        let centre = Vec2::new(self.size.start_m[0], 0.0);
        let place = || centre + Vec2::from(random::in_disc(self.start_m, &mut stream));
        let starts = self.fitted.starts(self.size.spacing_m, place);
        let task = |start: Vec2| {
            let own = Vec2::from(random::in_disc(self.size.own_m_s, &mut stream));
            Task { start, goal: start + self.size.migration() + own }
        };
        starts.into_iter().map(task).collect()
    }

    fn cost(&self) -> Option<Cost> {
        Some(Cost { name: "deviation from the migration", unit: "m2/s2", of: self.cost })
    }

    fn start_velocity(&self, task: &Task) -> Vec2 {
        task.goal - task.start
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    fn channels(&self) -> Vec<Channel> {
        vec![self.size.channel()]
    }

    /// Returns minus the squared distance of a robot's velocity from that of the migration \[m²/s²\], minus 1 for a
    /// contact.
    fn reward(&self, _: &Task, after: &Motion, contacts: Contacts, _: &mut Progress) -> Option<f32> {
        Some(-(after.velocity - self.size.migration()).norm_squared() - price(contacts))
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
        for entry in [FLOCKING_FIELD, FLOCKING_FIELD_TABLE] {
            contract::check(&entry).expect("a sound scenario");
        }
    }

    #[test]
    fn the_field_has_its_obstacles_and_the_flock_starts_before_it() {
        for (entry, size) in [(FLOCKING_FIELD, FIELD), (FLOCKING_FIELD_TABLE, TABLE)] {
            let scenario = (entry.build)(&Settings::default()).expect("the default team");
            for episode in 0..20 {
                let arena = scenario.drawn_arena(3, episode).expect("each episode has its own");
                assert!(
                    arena.keep_outs.len() + 1 >= size.obstacles,
                    "{} of {}",
                    arena.keep_outs.len(),
                    size.basics.name
                );
                let apart = |task: &Task| arena.clearance(task.start) > 2.0 * arena.robot_radius_m;
                assert!(scenario.tasks(3, episode).iter().all(apart), "{}", size.basics.name);
            }
        }
    }

    #[test]
    fn the_cost_is_variance_and_what_the_flock_lacks_of_the_migration() {
        let moving = |x: f32| Motion { position: Vec2::zeros(), velocity: Vec2::new(x, 0.0) };
        let cost = deviation(&[moving(0.1), moving(0.5)], Vec2::new(0.5, 0.0));
        assert!((cost - (0.2f64.powi(2) + 0.2f64.powi(2))).abs() < 1e-6, "{cost}");
    }
}
