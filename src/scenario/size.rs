//! Size of a task: a factor on its lengths, and the hull of its robots.
//!
//! Ground, walls, places and the distance of arrival are multiplied by the scale. Speeds are not, and the robots are as
//! large as their hull says. All lengths of a scenario at scale 1 and with the hull of the paper's robots are those of
//! the paper, to the bit.

use super::{ScenarioError, Settings};

/// Radius of the hull of the paper's robots \[m\] (arXiv 2111.01777, section V: two of them are the distance d_min at
/// which robots collide). The default.
pub const HULL_M: f32 = 0.16;
/// Radius that the tasks keep free about a robot's centre, in radii of its hull: 0.25 m, the robots of the paper
/// authors' published environment, for the hull of 0.16 m. It is exact in binary.
const ROOM_PER_HULL: f32 = 1.5625;
/// Smallest and largest scale.
const SCALES: (f32, f32) = (0.05, 20.0);
/// Smallest and largest radius of a hull \[m\]. Twice the largest, and the margin of the least distance that robots
/// keep, is within what a team file may set (`safety.distance_min_m`).
pub(super) const HULLS_M: (f32, f32) = (0.01, 0.85);
/// Factor by which two robots in their places are farther apart than they need, so that rounding does not decide.
pub(super) const APART: f32 = 1.001;

/// Size of a task: the factor on its lengths, and how large its robots are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// Factor on the lengths of the task.
    pub scale: f32,
    /// Radius of a robot's hull \[m\]: two robots collide when their centres are nearer than two of them.
    pub hull_m: f32,
}

impl Size {
    /// Returns the size that the `settings` of the scenario named `scenario` give; without a setting, scale 1 and the
    /// hull of the paper's robots. An error names the setting.
    pub fn of(scenario: &str, settings: &Settings) -> Result<Size, ScenarioError> {
        let fields = [("scale", settings.scale, SCALES, ""), ("hull_m", settings.hull_m, HULLS_M, " m")];
        for (field, value, (least, most), unit) in fields {
            if let Some(value) = value.filter(|value| !(least..=most).contains(value)) {
                let why = format!("takes {least} to {most}{unit}, not {value}");
                return Err(ScenarioError::Size { scenario: scenario.to_owned(), field, why });
            }
        }
        Ok(Size { scale: settings.scale.unwrap_or(1.0), hull_m: settings.hull_m.unwrap_or(HULL_M) })
    }

    /// Returns the size with the scale that keeps the number of hulls between two places, unless the `settings` have a
    /// scale.
    pub fn by_hull(self, settings: &Settings) -> Size {
        let scale = settings.scale.unwrap_or(self.hull_m / HULL_M);
        Size { scale, ..self }
    }

    /// Returns a length \[m\] of the task at this scale, from that at scale 1.
    pub fn length(&self, length_m: f32) -> f32 {
        length_m * self.scale
    }

    /// Returns the radius \[m\] that the task keeps free about a robot's centre: `Arena::robot_radius_m`.
    pub fn robot_radius_m(&self) -> f32 {
        self.hull_m * ROOM_PER_HULL
    }

    /// Returns the distance \[m\] of two centres below which robots have collided: `Rules::separation_m`.
    pub fn separation_m(&self) -> f32 {
        2.0 * self.hull_m
    }

    /// Checks that robots have room in places that are `apart_m` \[m\] from each other at scale 1. `ground` names the
    /// places and what else there is, for the error. It names the hull or the scale, whichever was set, and the values
    /// that would do.
    pub fn check_places(
        &self,
        (scenario, ground): (&str, &str),
        settings: &Settings,
        apart_m: f32,
    ) -> Result<(), ScenarioError> {
        let (apart, needed) = (self.length(apart_m), APART * 2.0 * self.robot_radius_m());
        if apart >= needed {
            return Ok(());
        }
        let field = if settings.hull_m.is_some() { "hull_m" } else { "scale" };
        let (hull, scale) = (down(apart / (APART * 2.0 * ROOM_PER_HULL)), up(needed / apart_m));
        let why = format!(
            "has {ground} {apart:.3} m apart at scale {}, and robots with a hull of {} m need {needed:.3} m: take a \
             hull (hull_m) of at most {hull} m, or a scale of at least {scale}",
            self.scale, self.hull_m
        );
        Err(ScenarioError::Size { scenario: scenario.to_owned(), field, why })
    }
}

/// Returns the number rounded down to three decimals, for an error text.
pub(super) fn down(number: f32) -> f32 {
    (number * 1000.0).floor() / 1000.0
}

/// Returns the number rounded up to three decimals, for an error text.
pub(super) fn up(number: f32) -> f32 {
    (number * 1000.0).ceil() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Planar;
    use crate::scenario::build;

    #[test]
    fn the_default_size_is_that_of_the_paper_to_the_bit() {
        let size = Size::of("passage", &Settings::default()).unwrap();
        assert_eq!(size, Size { scale: 1.0, hull_m: 0.16 });
        assert_eq!((size.robot_radius_m(), size.separation_m()), (0.25, 0.32));
        let written = Settings { scale: Some(1.0), hull_m: Some(0.16), ..Settings::default() };
        for name in ["passage", "swap", "flocking"] {
            let [usual, written] = [&Settings::default(), &written].map(|settings| build(name, settings).unwrap());
            assert_eq!((usual.arena(), usual.rules()), (written.arena(), written.rules()), "{name}");
            assert_eq!(usual.tasks(3, 1), written.tasks(3, 1), "{name}");
        }
    }

    #[test]
    fn four_small_robots_swap_places_on_a_metre_and_a_half() {
        let settings = Settings { robots: Some(4), hull_m: Some(0.06), ..Settings::default() };
        let swap = build("swap", &settings).unwrap();
        assert_eq!(swap.arena().half_extent.to_array(), [0.75, 0.75]);
        assert_eq!((swap.rules().separation_m, swap.arena().robot_radius_m), (0.12, 0.09375));
        let written = Settings { scale: Some(0.375), hull_m: Some(0.09), ..settings };
        let swap = build("swap", &written).unwrap();
        assert_eq!(swap.arena().half_extent.to_array(), [0.75, 0.75], "a written scale is the scale");
        assert_eq!(swap.rules().arrival_m, 0.25 * 0.375);
        for task in swap.tasks(1, 0) {
            assert!(task.start.abs().max() <= 0.75 && task.goal.abs().max() <= 0.75);
        }
    }

    #[test]
    fn a_size_that_cannot_work_is_refused_by_its_field() {
        let refused = |name: &str, settings: Settings| {
            let error = build(name, &settings).unwrap_err();
            (error.field(), error.to_string())
        };
        let usual = Settings::default;
        let (field, why) = refused("swap", Settings { scale: Some(0.375), ..usual() });
        assert_eq!(field, "scale");
        assert!(why.contains("of at most 0.127 m") && why.contains("scale of at least 0.47"), "{why}");
        let (field, why) = refused("passage", Settings { hull_m: Some(0.4), ..usual() });
        assert_eq!(field, "hull_m");
        assert!(why.contains("gap of 1 m"), "{why}");
        assert_eq!(refused("flocking", Settings { hull_m: Some(0.3), ..usual() }).0, "hull_m");
        assert_eq!(refused("flocking", Settings { scale: Some(0.5), ..usual() }).0, "scale");
        for (scale, hull_m) in [(Some(f32::NAN), None), (Some(0.0), None), (Some(-1.0), None), (Some(99.0), None)] {
            assert_eq!(refused("swap", Settings { scale, hull_m, ..usual() }).0, "scale");
        }
        for hull_m in [0.0, -0.1, f32::NAN, f32::INFINITY, 1.0] {
            assert_eq!(refused("swap", Settings { hull_m: Some(hull_m), ..usual() }).0, "hull_m");
        }
        let (field, why) = refused("passage", Settings { gap_m: Some(0.5), ..usual() });
        assert_eq!(field, "gap_m");
        assert!(why.contains("0.6 to 3 m"), "{why}");
    }

    #[test]
    fn what_an_error_names_as_possible_is_possible() {
        for scale in [0.1, 0.2, 0.5, 0.9] {
            let settings = |hull_m, scale| Settings { scale: Some(scale), hull_m, ..Settings::default() };
            for name in ["passage", "swap", "flocking"] {
                let Err(error) = build(name, &settings(None, scale)) else { continue };
                let text = error.to_string();
                let number = |after: &str| -> f32 {
                    let rest = text.split(after).nth(1).unwrap_or_else(|| panic!("{text}"));
                    rest.trim().split([' ', ',', ';']).next().unwrap().parse().unwrap_or_else(|_| panic!("{text}"))
                };
                let (hull_m, least) = (number("of at most"), number("scale of at least"));
                assert!(build(name, &settings(Some(hull_m), scale)).is_ok(), "{name} at {scale}: {text}");
                assert!(build(name, &settings(None, least)).is_ok(), "{name} at {least}: {text}");
            }
        }
    }
}
