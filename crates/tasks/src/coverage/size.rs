//! Sizes of the scenarios of coverage, and the density of an episode.

use murmurate::messages::geometry::Vec2;

use crate::ground::Basics;

use super::{
    Point,
    field::{Bounds, Feature},
    grid::Grid,
};

/// Golden ratio less 1: multiples of it, less their whole parts, are spread evenly over 0 to 1.
const GOLDEN: f64 = 0.618_033_988_749_895;
/// Distance from its mean at which a Gaussian ends, in deviations.
pub const TRUNCATION: f64 = 2.0;

/// Scenarios of the task with their sizes.
const SIZES: &str = "'coverage' is of 1024 m, and 'coverage-table' of 2 m";

/// Size of a scenario of coverage: ground, density, robots and their sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// Name, team and duration.
    pub basics: Basics,
    /// Cells of the ground.
    pub grid: Grid,
    /// Smallest and largest deviation of a Gaussian \[m\].
    pub deviation_m: [f64; 2],
    /// Side \[m\] of the square around a robot that its sensor covers.
    pub sensor_m: f64,
    /// Side \[m\] of the square around a robot that its local map covers.
    pub local_map_m: f64,
    /// Number of cells along each axis that are one cell of the coarse map.
    pub coarse_cells: usize,
    /// Distance \[m\] below which robots hear each other.
    pub communication_m: f32,
    /// Largest speed of a robot \[m/s\].
    pub speed_m_s: f32,
}

/// The published benchmark ([`Parameters::published`](super::run::Parameters::published)), on cells of 8 m: 32 robots
/// on 1024 m, for two minutes.
pub const PUBLISHED: Size = Size {
    basics: Basics { name: "coverage", robots: [32, 64], hull_m: 0.16, limit_s: 120.0, sizes: SIZES },
    grid: Grid { cells: 128, cell_m: 8.0 },
    deviation_m: [40.0, 60.0],
    sensor_m: 64.0,
    local_map_m: 256.0,
    coarse_cells: 4,
    communication_m: 128.0,
    speed_m_s: 5.0,
};

/// A table of 2 m × 2 m, which fits into the 3.2 m × 2 m of a Robotarium: five robots, for a minute.
pub const TABLE: Size = Size {
    basics: Basics { name: "coverage-table", robots: [5, 8], hull_m: 0.055, limit_s: 60.0, sizes: SIZES },
    grid: Grid { cells: 40, cell_m: 0.05 },
    deviation_m: [0.15, 0.25],
    sensor_m: 0.5,
    local_map_m: 1.5,
    coarse_cells: 5,
    communication_m: 1.0,
    speed_m_s: 0.15,
};

impl Size {
    /// Returns the size of the scenario named `name`; `None` if it is none of coverage.
    pub fn of(name: &str) -> Option<&'static Size> {
        [&PUBLISHED, &TABLE].into_iter().find(|size| size.basics.name == name)
    }

    /// Returns a place in the frame of the ground, from the world frame, whose origin is the middle of the ground.
    pub fn on_ground(&self, at: Vec2) -> Point {
        let half_m = self.grid.side_m() / 2.0;
        [f64::from(at.x) + half_m, f64::from(at.y) + half_m]
    }

    /// Returns a place in the world frame, from the frame of the ground.
    pub fn in_world(&self, at: Point) -> Vec2 {
        let half_m = self.grid.side_m() / 2.0;
        Vec2::new((at[0] - half_m) as f32, (at[1] - half_m) as f32)
    }

    /// Returns the importance of a cell in the middle of a Gaussian of middling deviation and weight.
    pub fn usual_importance(&self) -> f64 {
        let ([least, most], weight) = (self.deviation_m, Bounds::published().weight);
        let (deviation_m, weight) = (0.5 * (least + most), 0.5 * (weight.start + weight.end));
        let cell = self.grid.cell_m / deviation_m;
        weight * cell * cell / (2.0 * std::f64::consts::PI)
    }

    /// Returns the Gaussians of an episode. Each has the goal of a task as its mean: `goals` \[m\], world frame. Its
    /// deviation and its weight, which is within that of [`Bounds::published`], follow from its number.
    pub fn features(&self, goals: impl Iterator<Item = Vec2>) -> Vec<Feature> {
        let weight = Bounds::published().weight;
        let spread = |number: usize, [least, most]: [f64; 2]| {
            let turns = (number + 1) as f64 * GOLDEN;
            least + (most - least) * (turns - turns.floor())
        };
        let feature = |(number, goal): (usize, Vec2)| Feature {
            centre_m: self.on_ground(goal),
            deviation_m: spread(number, self.deviation_m),
            weight: spread(3 * number, [weight.start, weight.end]),
        };
        goals.enumerate().map(feature).collect()
    }
}
