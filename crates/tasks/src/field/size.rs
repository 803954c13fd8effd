//! Sizes of flocking through a field: one for a team as in `flocking`, and one for a table.

use murmurate::messages::geometry::Vec2;
use murmurate::observation::{Channel, Quantity, Unit};

use crate::ground::Basics;

/// Scenarios of the task with their sizes.
const SIZES: &str = "'flocking-field' is of 32 m, and 'flocking-field-table' of 3.2 m";

/// Lengths, speeds and numbers of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// Name, team and duration.
    pub basics: Basics,
    /// Half the size of the ground along x and y \[m\].
    pub half_extent_m: [f32; 2],
    /// Centre \[m\] along x, and radius \[m\] for a team of `robots[0]`, of the disc on which robots start.
    pub start_m: [f32; 2],
    /// Smallest distance of two robots at the start \[m\].
    pub spacing_m: f32,
    /// Number of obstacles.
    pub obstacles: usize,
    /// Smallest and largest radius of an obstacle \[m\].
    pub radius_m: [f32; 2],
    /// Smallest distance of two obstacles from each other \[m\].
    pub apart_m: f32,
    /// Bounds of the field in which the obstacles are \[m\]: smallest x and y, then largest x and y.
    pub field_m: [f32; 4],
    /// Speed of the migration \[m/s\], along x.
    pub migration_m_s: f32,
    /// Radius of the disc of velocities \[m/s\] from which each robot's own initial velocity is drawn.
    pub own_m_s: f32,
    /// Distance from which on robots do not push each other away \[m\].
    pub range_m: f32,
    /// Distance within which robots hear each other \[m\].
    pub radius_of_communication_m: f32,
}

/// Twenty robots on 32 m × 16 m, with the spacing and the communication of `flocking`.
pub const FIELD: Size = Size {
    basics: Basics { name: "flocking-field", robots: [20, 24], hull_m: 0.16, limit_s: 40.0, sizes: SIZES },
    half_extent_m: [16.0, 8.0],
    start_m: [-10.5, 3.6],
    spacing_m: 0.8,
    obstacles: 16,
    radius_m: [0.3, 0.6],
    apart_m: 1.5,
    field_m: [-5.5, -6.5, 8.0, 6.5],
    migration_m_s: 0.5,
    own_m_s: 0.3,
    range_m: 1.0,
    radius_of_communication_m: 2.0,
};

/// Five small robots on 3.2 m × 2 m.
pub const TABLE: Size = Size {
    basics: Basics { name: "flocking-field-table", robots: [5, 5], hull_m: 0.055, limit_s: 22.0, sizes: SIZES },
    half_extent_m: [1.54, 0.94],
    start_m: [-1.05, 0.42],
    spacing_m: 0.25,
    obstacles: 5,
    radius_m: [0.06, 0.12],
    apart_m: 0.42,
    field_m: [-0.4, -0.75, 0.9, 0.75],
    migration_m_s: 0.1,
    own_m_s: 0.06,
    range_m: 0.3,
    radius_of_communication_m: 0.7,
};

impl Size {
    /// Returns the size of the scenario named `name`; `None` if it is none of flocking through a field.
    pub fn of(name: &str) -> Option<&'static Size> {
        [&FIELD, &TABLE].into_iter().find(|size| size.basics.name == name)
    }

    /// Returns the velocity of the migration \[m/s\], world frame.
    pub fn migration(&self) -> Vec2 {
        Vec2::new(self.migration_m_s, 0.0)
    }

    /// Returns the channel `migration`: the velocity of the migration \[m/s\].
    pub(super) fn channel(&self) -> Channel {
        let (form, velocity) = ((vec![2], Unit::MetrePerSecond, Quantity::Vector), self.migration());
        Channel::new("migration", "velocity of the migration", form, move |known, values| {
            values.copy_from_slice(known.own.frame.turn(velocity).as_slice());
        })
    }
}
