//! Policies `coverage-clairvoyant` and `coverage-centralised`: baselines that know more than a robot can.
//!
//! Each robot goes to the centroid of its Voronoi cell, as in `coverage-cvt`, but it hears all others, and its cell
//! ends at the ground. The clairvoyant one knows the whole density. The centralised one knows what the team has seen so
//! far, which each robot follows from the places that it heard ([`baselines`](super::baselines)). Both take the density
//! from the channel `means`. They show what it is worth to know more, and are experts for training by imitation.

use murmurate::messages::geometry::Vec2;
use murmurate::observation::Observation;
use murmurate::policy::{Entry, Interface, Model, ModelError, Neighbour, Origin, Policy};
use murmurate::random::Stream;
use murmurate::scenario::Scenario;

use super::{
    Point,
    baselines::middle,
    channels::means,
    field::Field,
    policy::{interface, velocity},
    run::Baseline,
    seen::Seen,
    size::{Size, TRUNCATION},
    voronoi,
};
use crate::ground::size_of;

/// Entry of the policy that knows the whole density.
pub const COVERAGE_CLAIRVOYANT: Entry = Entry {
    name: "coverage-clairvoyant",
    about: "scripted coverage; each robot knows the whole density and all others (for 'coverage')",
    build: |scenario| model(COVERAGE_CLAIRVOYANT.name, scenario, Baseline::Clairvoyant),
};

/// Entry of the policy that knows what the team has seen.
pub const COVERAGE_CENTRALISED: Entry = Entry {
    name: "coverage-centralised",
    about: "scripted coverage; each robot knows what the team has seen, and all others (for 'coverage')",
    build: |scenario| model(COVERAGE_CENTRALISED.name, scenario, Baseline::Centralised),
};

fn model(name: &'static str, scenario: &dyn Scenario, baseline: Baseline) -> Result<Model, ModelError> {
    let size = size_of(scenario, Size::of(scenario.name()), "'coverage' and 'coverage-table'")?;
    let origin = Origin { requests: vec![means(scenario.robots()).request()], ..Origin::default() };
    let made = move || Privileged { size, baseline, field: None, seen: Seen::nothing(size.grid) };
    Model::of_file((name, of_all(size)), origin, None, move |_, _, _| Box::new(made())).map_err(ModelError::Refused)
}

/// Returns the interface of a policy that hears all robots.
fn of_all(size: &Size) -> Interface {
    Interface { radius_m: f32::INFINITY, ..interface(size) }
}

/// One robot's instance of a policy.
#[derive(Debug)]
struct Privileged {
    size: &'static Size,
    baseline: Baseline,
    /// Density of the episode; `None` until the tasks of all robots are known.
    field: Option<Field>,
    /// Cells that the team has seen.
    seen: Seen,
}

impl Privileged {
    /// Makes the density of the means \[m\] of its Gaussians, which are coordinates of one after the other. It stays
    /// unknown if one of them is.
    fn learn(&mut self, means: &[f32]) {
        let goals = means.chunks_exact(2).map(|mean| Vec2::new(mean[0], mean[1]));
        self.field = Field::of_features(self.size.grid, &self.size.features(goals), TRUNCATION).ok();
        if self.baseline == Baseline::Clairvoyant {
            self.seen = Seen::everything(self.size.grid);
        }
    }
}

impl Policy for Privileged {
    fn interface(&self) -> Interface {
        of_all(self.size)
    }

    fn reset(&mut self, _: u64) {
        (self.field, self.seen) = (None, Seen::nothing(self.size.grid));
    }

    fn encode(&mut self, _: &Observation, _: &mut [f32]) {}

    fn act(&mut self, own: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        let Size { grid, sensor_m, .. } = *self.size;
        if self.field.is_none() {
            self.learn(own.values);
        }
        let at = self.size.on_ground(own.motion.position);
        let others: Vec<Point> = neighbours.iter().map(|other| self.size.on_ground(other.motion.position)).collect();
        if self.baseline == Baseline::Centralised {
            others.iter().chain([&at]).for_each(|robot| self.seen.look(&grid.window(*robot, sensor_m)));
        }
        let Some(field) = &self.field else { return Vec2::zeros() };
        let cell = voronoi::own_moments(field, at, &others, &self.seen, &grid.all());
        let goal = cell.centroid().unwrap_or_else(|| middle(at, &others, grid.all().corners_m(&grid)));
        velocity(self.size, own.motion.position, goal)
    }
}

#[cfg(test)]
mod tests {
    use murmurate::messages::geometry::Motion;
    use murmurate::random::Seed;
    use murmurate::time::Span;

    use super::*;
    use crate::coverage::size::TABLE;

    fn policy(baseline: Baseline) -> Privileged {
        Privileged { size: &TABLE, baseline, field: None, seen: Seen::nothing(TABLE.grid) }
    }

    fn act(policy: &mut Privileged, at: Vec2, means: &[f32], others: &[Vec2]) -> Vec2 {
        let heard = |at: &Vec2| Neighbour { motion: Motion::at_rest(*at), features: &[], age: Span::ZERO };
        let neighbours: Vec<Neighbour> = others.iter().map(heard).collect();
        let own = Observation { values: means, ..Observation::new(Motion::at_rest(at), Vec2::zeros()) };
        policy.act(&own, &[], &neighbours, &mut Seed::of_run(0).stream("none"))
    }

    #[test]
    fn only_the_clairvoyant_one_goes_to_what_no_robot_has_seen() {
        let (at, other, mean) = (Vec2::new(0.75, 0.75), Vec2::new(0.7, -0.7), [-0.6, 0.6]);
        let mut clairvoyant = policy(Baseline::Clairvoyant);
        let way = act(&mut clairvoyant, at, &mean, &[other]);
        assert!(way.x < -0.14 && way.y.abs() < 0.05, "{way:?}");
        // The middle of the upper half of the ground is where it goes without any density.
        let way = act(&mut policy(Baseline::Centralised), at, &mean, &[other]);
        assert!(way.x < -0.1 && way.y < -0.03, "{way:?}");
    }

    #[test]
    fn the_centralised_one_knows_what_others_have_seen_until_the_next_episode() {
        let (at, near_mean, mean) = (Vec2::new(0.2, 0.9), Vec2::new(-0.6, 0.4), [-0.6, 0.4]);
        let mut centralised = policy(Baseline::Centralised);
        act(&mut centralised, at, &mean, &[near_mean]);
        // The other one has gone: what it saw is in this robot's cell.
        let way = act(&mut centralised, at, &mean, &[Vec2::new(0.7, -0.9)]);
        let expected = near_mean - at;
        assert!((way / way.norm() - expected / expected.norm()).norm() < 0.1, "{way:?}");
        centralised.reset(1);
        let after = act(&mut centralised, at, &mean, &[Vec2::new(0.7, -0.9)]);
        assert!((way - after).norm() > 0.03, "{after:?}");
    }

    #[test]
    fn without_the_density_a_robot_stays() {
        for baseline in [Baseline::Clairvoyant, Baseline::Centralised] {
            assert_eq!(act(&mut policy(baseline), Vec2::zeros(), &[f32::NAN; 2], &[]), Vec2::zeros());
        }
    }
}
