//! Basics of the scenarios of this crate: a ground without walls of its own, one scale, and robots without goals.

use murmurate::messages::geometry::Vec2;
use murmurate::messages::local::Contacts;
use murmurate::policy::ModelError;
use murmurate::scenario::{Arena, Rules, Scenario, ScenarioError, Settings, Size, TeamSizes};
use murmurate::time::Span;

/// End of the error of a bottleneck that is asked for where there are no walls.
pub(crate) const NO_WALLS: &str = "; it has no walls";

/// Team and duration of a scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Basics {
    /// Name of the scenario.
    pub name: &'static str,
    /// Number of robots without a user's setting, and the largest one.
    pub robots: [usize; 2],
    /// Radius of a robot's hull without a user's setting \[m\].
    pub hull_m: f32,
    /// Duration of an episode \[s\].
    pub limit_s: f64,
    /// Scenarios of the task with their sizes, which there are in place of scales; the end of an error.
    pub sizes: &'static str,
}

/// Basics of a scenario with a user's settings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fitted {
    /// Name of the scenario.
    pub name: &'static str,
    /// Number of robots.
    pub robots: usize,
    /// Radius of a robot's hull \[m\].
    pub hull_m: f32,
    /// Radius that is kept free about a robot's centre \[m\].
    pub robot_radius_m: f32,
    /// Smallest distance of two centres that is no collision \[m\].
    separation_m: f32,
    limit: Span,
}

impl Basics {
    /// Returns the basics with a user's `settings`. `no_gap` says why there is no bottleneck.
    ///
    /// # Errors
    /// The team size, the scale or the hull is not supported, or the width of a bottleneck is set.
    pub(crate) fn fit(&self, settings: &Settings, no_gap: &'static str) -> Result<Fitted, ScenarioError> {
        let Basics { name, robots: [usual, most], limit_s, sizes, .. } = *self;
        let robots = TeamSizes::new(2, most).check(name, settings.robots.unwrap_or(usual))?;
        if let Some(gap_m) = settings.gap_m {
            return Err(ScenarioError::Gap { scenario: name.to_owned(), gap_m, hint: no_gap });
        }
        if settings.scale.is_some_and(|scale| scale.to_bits() != 1.0_f32.to_bits()) {
            return Err(self.refused("scale", &format!("has one scale; {sizes}")));
        }
        let hull_m = settings.hull_m.unwrap_or(self.hull_m);
        let size = Size::of(name, &Settings { hull_m: Some(hull_m), ..*settings })?;
        let (robot_radius_m, separation_m) = (size.robot_radius_m(), size.separation_m());
        Ok(Fitted { name, robots, hull_m, robot_radius_m, separation_m, limit: Span::from_secs(limit_s) })
    }

    /// Returns the error of a setting that the scenario does not support: its name, and why.
    pub(crate) fn refused(&self, field: &'static str, why: &str) -> ScenarioError {
        ScenarioError::Size { scenario: self.name.to_owned(), field, why: why.to_owned() }
    }
}

impl Fitted {
    /// Returns the ground without blocks, of half this size \[m\].
    pub fn arena(&self, half_extent: Vec2) -> Arena {
        Arena::new(half_extent, Vec::new(), self.robot_radius_m)
    }

    /// Returns the rules of an episode: it ends by time, and robots must not collide.
    pub fn rules(&self) -> Rules {
        Rules { arrival_m: 0.0, separation_m: self.separation_m, limit: self.limit }
    }

    /// Returns starts of the robots that are more than `apart_m` \[m\] from each other, of places that `draw` returns.
    /// There must be room for all.
    pub fn starts(&self, apart_m: f32, mut draw: impl FnMut() -> Vec2) -> Vec<Vec2> {
        let mut starts: Vec<Vec2> = Vec::with_capacity(self.robots);
        while starts.len() < self.robots {
            let at = draw();
            if starts.iter().all(|other| (other - at).norm() > apart_m) {
                starts.push(at);
            }
        }
        starts
    }
}

/// Returns the price of a robot's contacts in one step: 1, or 0 without any.
pub(crate) fn price(contacts: Contacts) -> f32 {
    if contacts.robot || contacts.wall { 1.0 } else { 0.0 }
}

/// Returns the `size` of a scenario for a policy that is for the scenarios `names` alone.
///
/// # Errors
/// There is no such size: the scenario is another one.
pub(crate) fn size_of<S>(
    scenario: &dyn Scenario,
    size: Option<&'static S>,
    names: &str,
) -> Result<&'static S, ModelError> {
    size.ok_or_else(|| ModelError::Refused(format!("it is for {names}, not '{}'", scenario.name())))
}
