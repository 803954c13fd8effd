//! Sizes of the task formation: one for robots as in `passage`, and one for a table.

use murmurate::messages::geometry::Vec2;

use crate::ground::Basics;

/// Scenarios of the task with their sizes.
const SIZES: &str = "'formation' is of 12 m, and 'formation-table' of 3.2 m";

/// Lengths, speeds and numbers of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// Name, team and duration.
    pub basics: Basics,
    /// Half the size of the ground along x and y \[m\].
    pub half_extent_m: [f32; 2],
    /// Waypoints that the point of the wedge passes again and again \[m\], world frame.
    pub waypoints_m: [[f32; 2]; 4],
    /// Distance between two rows of the wedge along x, and by which a row is wider to each side than that before it
    /// \[m\].
    pub wedge_m: [f32; 2],
    /// Radius of the disc about the first waypoint on which robots start, and their least distance there \[m\].
    pub start_m: [f32; 2],
    /// Speed of the leader \[m/s\].
    pub speed_m_s: f32,
    /// Largest distance of a robot from its place that counts in the cost \[m\].
    pub farthest_m: f32,
}

/// Five robots on 12 m × 12 m.
pub const FORMATION: Size = Size {
    basics: Basics { name: "formation", robots: [5, 9], hull_m: 0.16, limit_s: 60.0, sizes: SIZES },
    half_extent_m: [6.0, 6.0],
    waypoints_m: [[-3.0, -3.0], [3.5, -3.0], [3.5, 3.0], [-3.0, 3.0]],
    wedge_m: [0.7, 0.7],
    start_m: [1.8, 0.8],
    speed_m_s: 0.4,
    farthest_m: 1.0,
};

/// Four small robots on 3.2 m × 2 m.
pub const TABLE: Size = Size {
    basics: Basics { name: "formation-table", robots: [4, 5], hull_m: 0.055, limit_s: 60.0, sizes: SIZES },
    half_extent_m: [1.54, 0.94],
    waypoints_m: [[-0.6, -0.4], [1.1, -0.4], [1.1, 0.4], [-0.6, 0.4]],
    wedge_m: [0.22, 0.22],
    start_m: [0.5, 0.25],
    speed_m_s: 0.1,
    farthest_m: 0.3,
};

impl Size {
    /// Returns the size of the scenario named `name`; `None` if it is no formation.
    pub fn of(name: &str) -> Option<&'static Size> {
        [&FORMATION, &TABLE].into_iter().find(|size| size.basics.name == name)
    }

    /// Returns the place of a robot in the wedge, relative to its point \[m\]: robot 0 is the point, robots 1 and 2 are
    /// in the first row behind it, and so on.
    pub fn place(&self, robot: usize) -> Vec2 {
        let row = robot.div_ceil(2) as f32;
        let side = if robot % 2 == 1 { 1.0 } else { -1.0 };
        Vec2::new(-row * self.wedge_m[0], side * row * self.wedge_m[1])
    }

    /// Returns a waypoint by its number, of which they are passed one after the other \[m\].
    pub fn waypoint(&self, number: usize) -> Vec2 {
        Vec2::from(self.waypoints_m[number % self.waypoints_m.len()])
    }
}
