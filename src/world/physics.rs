//! Parameters of simulated robots, each default with its source (table in `docs/world.md`), and the user's overrides.
//! The plants apply them.

use super::{Entry, Sensor, kinematic};
use crate::scenario::Arena;
use crate::time::Span;

/// Effect of a contact on a move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactRule {
    /// The move is not made, as in training; robots have the radius that the arena gives.
    Block,
    /// The move is made and the contact is flagged for the judge; robots have the radius of their hull.
    Judge,
}

/// Physical parameters of simulated robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Physics {
    /// Effect of a contact on a move.
    pub contacts: ContactRule,
    /// Radius of the hull \[m\]: a wall within this distance of a robot's centre is a contact. Under
    /// `ContactRule::Judge`, so is another robot's centre within twice this distance.
    pub wall_radius_m: f32,
    /// Largest acceleration along each axis \[m/s^2\]; may be infinite.
    pub acceleration_m_s2: f32,
    /// Time constant of the drivetrain, a first-order lag from commanded to true velocity \[s\]; zero for none.
    pub lag_s: f32,
    /// Largest speed \[m/s\]. This field and the following ones, except `sensor`, are for rigid bodies only.
    pub top_speed_m_s: f32,
    /// Largest acceleration by the motors in any direction \[m/s^2\].
    pub traction_m_s2: f32,
    /// Standard deviation of wheel slip along each axis, as a fraction of the commanded speed.
    pub slip: f32,
    /// Correlation time of wheel slip \[s\].
    pub slip_s: f32,
    /// Mass of a robot \[kg\].
    pub mass_kg: f32,
    /// Thickness of the soft layer of the hull around its solid core \[m\].
    pub give_m: f32,
    /// Coefficient of friction between two hulls and between a hull and a wall.
    pub friction: f32,
    /// Coefficient of restitution of the same.
    pub restitution: f32,
    /// Model of the sensor that measures the robots' states.
    pub sensor: Sensor,
}

impl Physics {
    /// Parameters of the published training environment.
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

    /// Parameters of DJI RoboMaster robots, those of the paper (section V), under motion capture.
    pub fn robomaster(_: &Arena) -> Physics {
        Physics {
            contacts: ContactRule::Judge,
            // Half the length of 0.32 m (data sheet: 320 x 240 x 270 mm); the paper's limit d_min is twice this.
            wall_radius_m: 0.16,
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

    /// Fraction of a step change of velocity that a first-order lag makes in one step: 1 - exp(-period / lag).
    pub fn gain(&self, period: Span) -> f32 {
        if self.lag_s > 0.0 { -libm::expm1(-period.as_secs() / f64::from(self.lag_s)) as f32 } else { 1.0 }
    }
}

/// The user's overrides of simulated robots' parameters; `None` leaves the plant's default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Overrides {
    /// Override of `Physics::lag_s` \[s\].
    pub lag_s: Option<f32>,
    /// Override of `Physics::contacts`.
    pub contacts: Option<ContactRule>,
    /// Override of `Physics::wall_radius_m` \[m\].
    pub wall_radius_m: Option<f32>,
    /// Override of `Physics::sensor`.
    pub sensor: Option<Sensor>,
}

/// Error of a field that a plant does not let a user override.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{why}; leave it out, or use another plant")]
pub struct OverrideError {
    /// Name of the field.
    pub field: &'static str,
    /// Reason.
    pub why: &'static str,
}

impl Overrides {
    /// Returns a plant's parameters in an arena with these overrides; an error names a field that the plant fixes.
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
