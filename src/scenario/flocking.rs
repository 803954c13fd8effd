//! Scenario `flocking`: a team that starts with random velocities agrees on one; robots have no goals. After Tolstaya,
//! Gama, Paulos, Pappas, Kumar and Ribeiro, CoRL 2019, arXiv 1903.10527.
//!
//! The robots start on an open disc. It is so large that a robot has six others within 2 m on average, and those links
//! connect the team. Each robot starts with a velocity of its own, drawn from a disc, and one that all have in common.
//! After ten seconds the episode ends, and its cost is the mean of the variance of the velocities. The reference acts
//! by acceleration; policies here command the measured velocity plus an acceleration times the period.
//!
//! A scale changes distances between robots, and not velocities.
//!
//! A robot's initial velocity is in its task: the goal is the place that it would reach in one second. No robot has to
//! go there.

use std::f64::consts::PI;
use std::sync::Arc;

use super::cost::velocity_variance;
use super::{Arena, Cost, Progress, Rules, Scenario, ScenarioError, Settings, Size, TeamAfterStep, TeamSizes};
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::observation::PolicyFrame;
use crate::random::{self, Seed, Stream};
use crate::time::Span;

/// Distance within which two robots are neighbours \[m\] at scale 1: for the density of the team, and for its
/// connectedness at the start.
pub const RADIUS_M: f32 = 2.0;
/// Mean number of neighbours of a robot at the start.
const NEIGHBOURS: f64 = 6.0;
/// Smallest distance between two robots at the start \[m\] at scale 1.
const SPACING_M: f32 = 0.8;
/// Radius of the disc of velocities \[m/s\] from which each robot's own initial velocity is drawn.
const OWN_M_S: f32 = 0.8;
/// Radius of the disc of velocities \[m/s\] from which the velocity is drawn that all robots have in common at the
/// start. Together with `OWN_M_S` it is below the largest speed of the training world.
const COMMON_M_S: f32 = 0.6;
/// Time in which the goal of a robot's task is reached at the robot's initial velocity \[s\].
const AHEAD_S: f32 = 1.0;
/// Duration of an episode.
const DURATION: Span = Span::from_millis(10_000);
/// Distance from the disc of the starts to the edge of the ground \[m\]: more than a robot covers in an episode at the
/// largest initial speed.
const ROOM_M: f32 = 16.0;
/// Team sizes that the scenario supports.
const ROBOTS: TeamSizes = TeamSizes::new(20, 100);
/// Number of robots without a user's setting.
const DEFAULT_ROBOTS: usize = 50;

/// Scenario in which a team agrees on a velocity, without goals.
#[derive(Debug)]
pub struct Flocking {
    robots: usize,
    /// Radius of the disc on which the robots start \[m\].
    disc_m: f32,
    size: Size,
    arena: Arena,
}

/// Makes the scenario `flocking` with a user's `settings`; the default team has 50 robots. An error says that the team
/// size, the scale or the hull is not supported, or that a gap width is set, although the scenario has no walls.
pub fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let robots = ROBOTS.check("flocking", settings.robots.unwrap_or(DEFAULT_ROBOTS))?;
    if let Some(gap_m) = settings.gap_m {
        return Err(ScenarioError::Gap { scenario: "flocking".to_owned(), gap_m, hint: "; it has no walls" });
    }
    let size = Size::of("flocking", settings)?;
    size.check_places(("flocking", "robots at least"), settings, SPACING_M)?;
    let disc_m = size.length(disc(robots));
    let arena = Arena::new(Vec2::repeat(disc_m + ROOM_M), Vec::new(), size.robot_radius_m());
    Ok(Arc::new(Flocking { robots, disc_m, size, arena }))
}

/// Returns the radius of the disc \[m\] on which a robot of a team of `robots` robots has `NEIGHBOURS` neighbours on
/// average, if two robots are never nearer than `SPACING_M`. It is found by bisection.
fn disc(robots: usize) -> f32 {
    let neighbours = |disc_m: f64| {
        let near = |distance_m: f32| share_within(f64::from(distance_m) / disc_m);
        let too_near = near(SPACING_M);
        (robots - 1) as f64 * (near(RADIUS_M) - too_near) / (1.0 - too_near)
    };
    let (mut low, mut high) = (f64::from(RADIUS_M), 1e3);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if neighbours(middle) > NEIGHBOURS { low = middle } else { high = middle }
    }
    high as f32
}

/// Returns the probability that two random points of a disc of radius 1 are at most `distance` apart, 0 to 2 (disk line
/// picking; Solomon, Geometric Probability, 1978).
fn share_within(distance: f64) -> f64 {
    let d = distance.clamp(0.0, 2.0);
    let square = d * d;
    1.0 + 2.0 / PI * (square - 1.0) * libm::acos(d / 2.0)
        - d / PI * (1.0 + square / 2.0) * (1.0 - square / 4.0).max(0.0).sqrt()
}

impl Flocking {
    /// Draws places that are `SPACING_M` apart, at scale 1 \[m\]; `None` if the next robot finds none.
    fn places(&self, stream: &mut Stream) -> Option<Vec<Vec2>> {
        /// Number of tries for the place of one robot.
        const TRIES: u32 = 1000;
        let mut places: Vec<Vec2> = Vec::with_capacity(self.robots);
        let spacing_m = self.size.length(SPACING_M);
        let free =
            |places: &[Vec2], at: Vec2| places.iter().all(|other| (other - at).norm_squared() >= spacing_m * spacing_m);
        for _ in 0..self.robots {
            let mut tries = (0..TRIES).map(|_| Vec2::from(random::in_disc(self.disc_m, stream)));
            places.push(tries.find(|at| free(&places, *at))?);
        }
        Some(places)
    }
}

/// Returns whether links between all robots within `radius_m` \[m\] of each other connect the team.
fn connected(places: &[Vec2], radius_m: f32) -> bool {
    let mut reached = vec![false; places.len()];
    let mut open = vec![0];
    reached[0] = true;
    while let Some(robot) = open.pop() {
        for (other, at) in places.iter().enumerate() {
            if !reached[other] && (at - places[robot]).norm_squared() <= radius_m * radius_m {
                reached[other] = true;
                open.push(other);
            }
        }
    }
    reached.iter().all(|&reached| reached)
}

impl Scenario for Flocking {
    fn name(&self) -> &'static str {
        "flocking"
    }

    fn robots(&self) -> usize {
        self.robots
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
        let mut stream = Seed::of_run(seed).stream(&format!("flocking/layout/{episode}"));
        let radius_m = self.size.length(RADIUS_M);
        let places = loop {
            if let Some(places) = self.places(&mut stream).filter(|places| connected(places, radius_m)) {
                break places;
            }
        };
        let mut in_disc = |radius: f32| Vec2::from(random::in_disc(radius, &mut stream));
        let common = in_disc(COMMON_M_S);
        let task = |start: Vec2| Task { start, goal: start + (common + in_disc(OWN_M_S)) * AHEAD_S };
        places.into_iter().map(task).collect()
    }

    fn cost(&self) -> Option<Cost> {
        Some(Cost { name: "velocity variance", unit: "m2/s2", of: |team, _| velocity_variance(team) })
    }

    fn start_velocity(&self, task: &Task) -> Vec2 {
        (task.goal - task.start) / AHEAD_S
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    /// Returns a robot's own part of the reward: minus 1 for a contact. `rewards` adds that of the team.
    fn reward(&self, _: &Task, _: &Motion, contacts: Contacts, _: &mut Progress) -> Option<f32> {
        Some(if contacts.robot || contacts.wall { -1.0 } else { 0.0 })
    }

    /// Writes the reward of each robot: minus the squared distance of its velocity from the team's mean \[m²/s²\],
    /// minus 1 for a contact.
    fn rewards(&self, team: TeamAfterStep, rewards: &mut [f32]) {
        let sum = team.velocity.iter().fold(Vec2::zeros(), |sum, velocity| sum + *velocity);
        let mean = sum / team.velocity.len().max(1) as f32;
        for ((reward, velocity), contacts) in rewards.iter_mut().zip(team.velocity).zip(team.contacts) {
            let touched = contacts.robot || contacts.wall;
            *reward = -(velocity - mean).norm_squared() - if touched { 1.0 } else { 0.0 };
        }
    }

    fn rules(&self) -> Rules {
        Rules { arrival_m: 0.0, separation_m: self.size.separation_m(), limit: DURATION }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_has_six_neighbours_on_average_and_the_team_is_connected() {
        for robots in [20, 50, 100] {
            let flocking = build(&Settings::of(robots)).unwrap();
            let (mut links, mut layouts) = (0, 0);
            for seed in 0..20 {
                let starts: Vec<Vec2> = flocking.tasks(seed, 0).iter().map(|task| task.start).collect();
                let near = |one: usize, other: usize| (starts[one] - starts[other]).norm() <= RADIUS_M;
                links += (0..robots)
                    .map(|one| (0..robots).filter(|&other| other != one && near(one, other)).count())
                    .sum::<usize>();
                layouts += 1;
                assert!(connected(&starts, RADIUS_M));
            }
            let mean = links as f64 / (layouts * robots) as f64;
            assert!((mean - NEIGHBOURS).abs() < 0.5, "{mean} neighbours of {robots}");
        }
        assert!(!connected(&[Vec2::zeros(), Vec2::new(2.1, 0.0)], RADIUS_M));
    }

    #[test]
    fn initial_velocities_are_uniform_on_a_disc_about_a_common_one() {
        let flocking = build(&Settings::of(100)).unwrap();
        let (mut variance, mut common) = (0.0, 0.0);
        for seed in 0..50 {
            let motion = |task: &Task| Motion { position: task.start, velocity: flocking.start_velocity(task) };
            let team: Vec<Motion> = flocking.tasks(seed, 3).iter().map(motion).collect();
            assert!(team.iter().all(|motion| motion.velocity.norm() <= OWN_M_S + COMMON_M_S + 1e-4));
            variance += velocity_variance(&team) / 50.0;
            let mean = team.iter().fold(Vec2::zeros(), |sum, motion| sum + motion.velocity) / 100.0;
            common += f64::from(mean.norm_squared()) / 50.0;
        }
        // Half of the squared radius of each disc.
        assert!((variance - 0.32).abs() < 0.02, "{variance}");
        assert!((common - 0.18).abs() < 0.06, "{common}");
    }
}
