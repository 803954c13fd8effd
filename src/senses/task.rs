//! Values that the behaviour of a task observes in the simulated world, such as a method of a class in Python.

use serde::Deserialize;

use super::paced::{Measure, Pace};
use super::{Layout, Parts, Site};
use crate::config::{ConfigError, in_range};
use crate::edge::Settings;
use crate::messages::ids::RobotId;
use crate::messages::local::Scene;
use crate::messages::wire::MAX_SENSED;
use crate::observation::Unit;

/// Description of the sense `task` in one line, for lists of all kinds.
pub(super) const ABOUT: &str = "simulated: what a task in Python observes";

/// Settings of an example.
pub(super) const EXAMPLE: &str = "floats = 2";

/// Settings of the sense `task` in a deployment.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Number of values of a robot.
    floats: usize,
    /// Measurements in a second; as many as the World has steps if left out.
    rate_hz: Option<f64>,
    /// Delay of a measurement \[s\].
    #[serde(default)]
    delay_s: f64,
}

/// Makes the parts of the sense from its settings. The error names the wrong setting.
pub(super) fn make(settings: &Settings, _: RobotId) -> Result<Parts, ConfigError> {
    let Config { floats, rate_hz, delay_s } = settings.read()?;
    let pace = Pace { rate_hz, delay_s };
    in_range("floats", floats, (1, MAX_SENSED))
        .and_then(|()| pace.check())
        .map_err(|error| error.within(&settings.name))?;
    let layout = Layout { shape: vec![floats], unit: Unit::One, sweep: None };
    Ok(Parts::simulated(layout, pace, move |site: Site| Observed { robot: site.robot, floats }))
}

/// Values of one robot.
struct Observed {
    robot: RobotId,
    floats: usize,
}

impl Measure for Observed {
    fn measure(&mut self, scene: &Scene) -> Option<Vec<f32>> {
        let row = scene.robots.iter().position(|standing| standing.robot == self.robot)?;
        let is_whole = scene.observed.len() == scene.robots.len() * self.floats;
        is_whole.then(|| scene.observed[row * self.floats..][..self.floats].to_vec())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::messages::geometry::Vec2;
    use crate::messages::local::Standing;
    use crate::time::Time;

    #[test]
    fn each_robot_gets_its_row_and_a_scene_without_values_gives_none() {
        let standing = |robot: u16| Standing { robot: RobotId(robot), centre: Vec2::zeros(), heading: 0.0 };
        let robots: Arc<[Standing]> = [standing(0), standing(1)].into();
        let scene = |observed: &[f32]| Scene {
            time: Time::ZERO,
            placed: false,
            episode: 0,
            elapsed: None,
            robots: Arc::clone(&robots),
            observed: observed.into(),
        };
        let mut observed = Observed { robot: RobotId(1), floats: 3 };
        assert_eq!(observed.measure(&scene(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])), Some(vec![4.0, 5.0, 6.0]));
        assert_eq!(observed.measure(&scene(&[])), None);
    }
}
