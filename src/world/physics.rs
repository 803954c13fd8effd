//! Physical parameters of simulated robots, and the user's overrides of them.
//!
//! A table in `docs/world.md` gives the source of each default. The plants, which simulate the robots, apply the
//! parameters.

use super::{Entry, Sensor, kinematic};
use crate::safety::Safety;
use crate::scenario::Arena;
use crate::time::Span;

/// Effect of a contact, with a wall or another robot, on the move of a simulated robot in one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactRule {
    /// The robot stays where it was, as in training. Robots have the radius that the arena gives
    /// (`Arena::robot_radius_m`).
    Block,
    /// The robot moves on, and the contact is flagged, so that the judge fails the episode. Robots have the radius of
    /// their hull (`Physics::wall_radius_m`).
    Judge,
}

/// Physical parameters of the simulated robots of a plant (a simulated world), the same for all its robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Physics {
    /// Effect of a contact on the move of a robot in one step: the robot is blocked, or the contact is only flagged.
    pub contacts: ContactRule,
    /// Radius of a robot's hull \[m\]: a wall within this distance of the robot's centre is a contact. Under
    /// `ContactRule::Judge`, so is another robot's centre within twice this distance.
    pub wall_radius_m: f32,
    /// Largest acceleration along each axis of the world frame \[m/s^2\]; infinite for no limit.
    pub acceleration_m_s2: f32,
    /// Time constant \[s\] of the drivetrain, a first-order lag from the commanded to the true velocity; zero for no
    /// lag.
    pub lag_s: f32,
    /// Largest speed of a robot \[m/s\]. Only the rigid-body world (plant `rigid`) uses this parameter.
    pub top_speed_m_s: f32,
    /// Largest acceleration \[m/s^2\], in any direction, that the motors can give a robot. Only the rigid-body world
    /// (plant `rigid`) uses this parameter.
    pub traction_m_s2: f32,
    /// Standard deviation of wheel slip along each axis, as a fraction of the commanded speed. Slip is a random
    /// difference of the driven from the commanded velocity; only the rigid-body world (plant `rigid`) has it.
    pub slip: f32,
    /// Correlation time of wheel slip \[s\], the random difference of the driven from the commanded velocity. Only the
    /// rigid-body world (plant `rigid`) uses this parameter.
    pub slip_s: f32,
    /// Mass of one robot \[kg\]. Only the rigid-body world (plant `rigid`) uses this parameter.
    pub mass_kg: f32,
    /// Thickness \[m\] of the soft outer layer of a robot's hull. The solid core, which collides, has the hull's radius
    /// less this thickness; only the rigid-body world (plant `rigid`) uses it.
    pub give_m: f32,
    /// Coefficient of friction between two hulls, and between a hull and a wall. Only the rigid-body world (plant
    /// `rigid`) uses this parameter.
    pub friction: f32,
    /// Coefficient of restitution between two hulls, and between a hull and a wall: 0 for no rebound, 1 for a full one.
    /// Only the rigid-body world (plant `rigid`) uses this parameter.
    pub restitution: f32,
    /// Model of the sensor that measures the simulated robots' states: noise, rate and latency.
    pub sensor: Sensor,
}

impl Physics {
    /// Returns the settings `safety` for these robots: with their lag and acceleration, and with minimum distances that
    /// are at least 2 and 4 cm more than those of a contact.
    pub fn fit(&self, safety: Safety) -> Safety {
        let acceleration_m_s2 = self.acceleration_m_s2.min(self.traction_m_s2);
        safety.driving(self.lag_s, acceleration_m_s2).clear_of_contacts(self.wall_radius_m)
    }

    /// Returns the parameters of the training environment of the paper. Contacts block moves, there is no lag, and the
    /// sensor is exact. `arena` gives the robots' radius.
    pub fn published(arena: &Arena) -> Physics {
        Physics {
            contacts: ContactRule::Block,
            wall_radius_m: arena.robot_radius_m,
            acceleration_m_s2: kinematic::MAX_ACCELERATION_M_S2,
            lag_s: 0.0,
            sensor: Sensor::EXACT,
            ..Physics::robomaster(arena)
        }
    }

    /// Returns the parameters of DJI RoboMaster robots, the real robots of the paper, from data sheets or assumed; the
    /// sensor is a motion capture system. `arena` gives the robots' hull.
    pub fn robomaster(arena: &Arena) -> Physics {
        Physics {
            contacts: ContactRule::Judge,
            // 0.16 m, half the length of 0.32 m (data sheet: 320 x 240 x 270 mm), unless the user says otherwise; the
            // paper's limit d_min is twice this.
            wall_radius_m: arena.hull_m(),
            // The acceleration that `Clamp` allows, as in any world.
            acceleration_m_s2: kinematic::MAX_ACCELERATION_M_S2,
            // Not measured: chosen afterwards, because with the published policy it comes near the makespans of the
            // paper's real robots (Table I). It represents all delays between a command and the motion.
            lag_s: 0.5,
            // The lowest top speed of the data sheet, backwards; forwards it is 3.5 m/s, sideways 2.8 m/s.
            top_speed_m_s: 2.5,
            // Four motors of 0.25 N m (data sheet) on wheels of 0.1 m under 3.3 kg: 4 * 0.25 / 0.05 / 3.3.
            traction_m_s2: 6.0,
            // Assumed: mecanum wheels skid over a tenth of the distance and more. Most of it is constant, and feedback
            // control corrects it; this is the part that varies. It was 0.05 and was changed once after results were
            // seen (docs/evidence/world-fit.md).
            slip: 0.02,
            // Assumed: about the time in which a wheel passes over all of its rollers at 0.6 m/s.
            slip_s: 0.5,
            // Data sheet: 3.3 to 3.4 kg, depending on equipment.
            mass_kg: 3.3,
            // Assumed: armour plates are sprung, and trigger a sensor when they are pressed.
            give_m: 0.005,
            // Assumed: plastic on plastic, and plates that absorb most of an impact.
            friction: 0.3,
            restitution: 0.1,
            sensor: Sensor::MOTION_CAPTURE,
        }
    }

    /// Returns the fraction of a step change of commanded velocity that the first-order lag lets through in one step of
    /// duration `period`. The value is 1 - exp(-period / `lag_s`), and 1 without a lag.
    pub fn gain(&self, period: Span) -> f32 {
        if self.lag_s > 0.0 { -libm::expm1(-period.as_secs() / f64::from(self.lag_s)) as f32 } else { 1.0 }
    }
}

/// The user's overrides of simulated robots' parameters (`Physics`). A field that is `None` leaves the default of the
/// plant, the world in which the robots move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Overrides {
    /// Override of `Physics::lag_s`, the time constant of the drivetrain \[s\]; `None` for the default of the simulated
    /// world.
    pub lag_s: Option<f32>,
    /// Override of `Physics::contacts`, the effect of a contact on a move; `None` for the default of the simulated
    /// world.
    pub contacts: Option<ContactRule>,
    /// Override of `Physics::wall_radius_m`, the radius of a robot's hull \[m\]; `None` for the default of the
    /// simulated world.
    pub wall_radius_m: Option<f32>,
    /// Override of `Physics::sensor`, the model of the robots' sensor; `None` for the default of the simulated world.
    pub sensor: Option<Sensor>,
}

/// Error of an override of a robot parameter that the selected plant (the simulated world) keeps fixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{why}; leave it out, or use another plant")]
pub struct OverrideError {
    /// Name of the field of `Overrides` that the plant keeps fixed.
    pub field: &'static str,
    /// Reason why the simulated world keeps the field fixed, for the user.
    pub why: &'static str,
}

impl Overrides {
    /// Returns the physical parameters of the plant `entry` in `arena`, with these overrides in place of the defaults.
    /// An error names an overridden field that the plant keeps fixed.
    pub fn physics(&self, entry: &Entry, arena: &Arena) -> Result<Physics, OverrideError> {
        let fields = [("contacts", self.contacts.is_some()), ("wall_radius_m", self.wall_radius_m.is_some())];
        let is_set = |field: &str| fields.iter().any(|(name, set)| *name == field && *set);
        if let Some(&(field, why)) = entry.fixed.iter().find(|(field, _)| is_set(field)) {
            return Err(OverrideError { field, why });
        }
        let default = (entry.physics)(arena);
        Ok(Physics {
            lag_s: self.lag_s.unwrap_or(default.lag_s),
            contacts: self.contacts.unwrap_or(default.contacts),
            wall_radius_m: self.wall_radius_m.unwrap_or(default.wall_radius_m),
            sensor: self.sensor.unwrap_or(default.sensor),
            ..default
        })
    }
}

#[cfg(all(test, feature = "rigid"))]
mod tests {
    use super::*;
    use crate::scenario::{Settings, build};
    use crate::world::REGISTRY;

    #[test]
    fn an_override_replaces_the_default_and_a_fixed_field_is_refused() {
        let passage = build("passage", &Settings::default()).unwrap();
        let [kinematic, rigid] =
            ["kinematic", "rigid"].map(|name| REGISTRY.iter().find(|entry| entry.name == name).unwrap());
        let lag = Overrides { lag_s: Some(0.2), ..Overrides::default() };
        let physics = lag.physics(rigid, passage.arena()).unwrap();
        assert_eq!(physics, Physics { lag_s: 0.2, ..Physics::robomaster(passage.arena()) });
        let judged = Overrides { contacts: Some(ContactRule::Judge), ..Overrides::default() };
        assert_eq!(judged.physics(kinematic, passage.arena()).unwrap().contacts, ContactRule::Judge);
        assert_eq!(judged.physics(rigid, passage.arena()).unwrap_err().field, "contacts");
        let wide = Overrides { wall_radius_m: Some(0.25), ..Overrides::default() };
        assert_eq!(wide.physics(rigid, passage.arena()).unwrap_err().field, "wall_radius_m");
    }
}
