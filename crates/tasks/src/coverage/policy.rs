//! Policy `coverage-cvt`: the decentralised baseline of coverage as a policy of each robot.
//!
//! A robot maps what its sensor covers, and goes to the centroid of its Voronoi cell within its local map
//! ([`baselines`](super::baselines)). The cell is bounded by the robots that it hears. Messages are positions, which
//! every broadcast has: it carries no other number.

use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::observation::Observation;
use murmurate::policy::{Entry, Interface, Model, ModelError, Neighbour, Origin, Policy};
use murmurate::random::Stream;
use murmurate::scenario::Scenario;
use murmurate::time::Span;

use super::{Point, baselines::middle, channels::density, size::Size, voronoi};
use crate::ground::size_of;

/// Entry of the policy.
pub const COVERAGE_CVT: Entry = Entry {
    name: "coverage-cvt",
    about: "scripted coverage; each robot goes to the centroid of what it has seen (for 'coverage')",
    build: model,
};

/// Time between two steps: the longest that a policy may have. The benchmark has 200 ms.
pub(super) const PERIOD: Span = Span::from_millis(100);

fn model(scenario: &dyn Scenario) -> Result<Model, ModelError> {
    let size = size_of(scenario, Size::of(scenario.name()), "'coverage' and 'coverage-table'")?;
    let origin = Origin { requests: vec![density(size).request()], ..Origin::default() };
    let named = (COVERAGE_CVT.name, interface(size));
    Model::of_file(named, origin, None, move |_, _, _| Box::new(Cvt::new(size))).map_err(ModelError::Refused)
}

/// Returns the interface of the policy in a scenario of this size.
pub(super) fn interface(size: &Size) -> Interface {
    Interface {
        features: 0,
        radius_m: size.communication_m,
        period: PERIOD,
        limit_m_s: size.speed_m_s,
        hold: Span::from_millis(300),
    }
}

/// Returns the velocity \[m/s\] that brings a robot at `from` (world frame) to its goal (on the ground) in one period,
/// if the speed allows it.
pub(super) fn velocity(size: &Size, from: Vec2, goal: Point) -> Vec2 {
    ((size.in_world(goal) - from) / PERIOD.as_secs() as f32).capped(size.speed_m_s)
}

/// One robot's instance of the policy.
#[derive(Debug)]
struct Cvt {
    size: &'static Size,
    /// Importance of each cell that the robot has seen, row after row; 0 for others.
    map: Vec<f32>,
}

impl Cvt {
    fn new(size: &'static Size) -> Cvt {
        Cvt { size, map: vec![0.0; size.grid.cells * size.grid.cells] }
    }

    /// Adds what the sensor covers at the place `own` to the map.
    fn look(&mut self, own: Point, values: &[f32]) {
        let Size { grid, sensor_m, .. } = *self.size;
        let window = grid.window(own, sensor_m);
        let [below, left] = grid.outside(own, sensor_m);
        for (row, of_window) in window.rows.clone().enumerate() {
            let seen = &values[(below + row) * grid.across(sensor_m) + left..][..window.columns.len()];
            self.map[of_window * grid.cells..][window.columns.clone()].copy_from_slice(seen);
        }
    }

    /// Returns the goal \[m\] of the robot at `own`, which hears robots at `others`.
    fn goal(&self, own: Point, others: &[Point]) -> Point {
        let grid = self.size.grid;
        let window = grid.window(own, self.size.local_map_m);
        let mut cell = voronoi::Moments::default();
        for row in window.rows.clone() {
            let columns = voronoi::own_columns(grid, row, own, others, window.columns.clone());
            let x_m = grid.centre_m(row);
            for column in columns {
                cell.add_cell([x_m, grid.centre_m(column)], f64::from(self.map[row * grid.cells + column]));
            }
        }
        cell.centroid().unwrap_or_else(|| middle(own, others, window.corners_m(&grid)))
    }
}

impl Policy for Cvt {
    fn interface(&self) -> Interface {
        interface(self.size)
    }

    fn reset(&mut self, _: u64) {
        self.map.fill(0.0);
    }

    fn encode(&mut self, _: &Observation, _: &mut [f32]) {}

    fn act(&mut self, own: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        let at = self.size.on_ground(own.motion.position);
        self.look(at, own.values);
        let others: Vec<Point> = neighbours.iter().map(|other| self.size.on_ground(other.motion.position)).collect();
        velocity(self.size, own.motion.position, self.goal(at, &others))
    }
}

#[cfg(test)]
mod tests {
    use murmurate::messages::geometry::Motion;
    use murmurate::random::Seed;

    use super::*;
    use crate::coverage::size::TABLE;

    fn act(policy: &mut Cvt, at: Vec2, values: &[f32], others: &[Vec2]) -> Vec2 {
        let heard = |at: &Vec2| Neighbour { motion: Motion::at_rest(*at), features: &[], age: Span::ZERO };
        let neighbours: Vec<Neighbour> = others.iter().map(heard).collect();
        let own = Observation { values, ..Observation::new(Motion::at_rest(at), Vec2::zeros()) };
        policy.act(&own, &[], &neighbours, &mut Seed::of_run(0).stream("none"))
    }

    #[test]
    fn a_robot_goes_to_the_centroid_of_what_it_has_seen() {
        let mut policy = Cvt::new(&TABLE);
        let mut values = [0.0; 100];
        // Three cells along x from the middle of the window, and half a cell along y.
        values[85] = 1.0;
        let action = act(&mut policy, Vec2::zeros(), &values, &[]);
        let way = Vec2::new(0.175, 0.025);
        assert!((action - way * (0.15 / way.norm())).norm() < 1e-5, "{action:?}");
        // It remembers the cell when it no longer senses it, and until the next episode.
        let again = act(&mut policy, Vec2::new(-0.3, 0.0), &[0.0; 100], &[]);
        assert!(again.x > 0.14 && again.y > 0.0);
        policy.reset(1);
        let after = act(&mut policy, Vec2::zeros(), &[0.0; 100], &[]);
        assert_eq!(after, Vec2::zeros(), "the middle of its local map");
    }

    #[test]
    fn a_neighbour_keeps_what_is_nearer_to_it() {
        let mut policy = Cvt::new(&TABLE);
        let mut values = [0.0; 100];
        (values[85], values[35]) = (1.0, 1.0);
        let action = act(&mut policy, Vec2::zeros(), &values, &[Vec2::new(0.3, 0.0)]);
        assert!(action.x < 0.0, "{action:?}");
    }

    #[test]
    fn other_scenarios_are_refused() {
        let passage = murmurate::scenario::build("passage", &murmurate::scenario::Settings::default());
        let refused = model(&*passage.expect("a scenario")).expect_err("no coverage").to_string();
        assert!(refused.contains("not 'passage'"), "{refused}");
    }
}
