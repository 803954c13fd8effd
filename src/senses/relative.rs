//! Simulated detection of other robots: distance, bearing and heading of those in view, with noise, misses and false
//! detections. It does not say which robot is which.

use std::f64::consts::{PI, TAU};

use serde::Deserialize;

use super::paced::{Measure, Pace};
use super::{Layout, Parts, Site};
use crate::config::{ConfigError, in_range};
use crate::edge::Settings;
use crate::messages::geometry::{Vec2, wrapped};
use crate::messages::ids::RobotId;
use crate::messages::local::{Scene, Standing};
use crate::observation::Unit;
use crate::random::{self, RngExt, Stream};
use crate::scenario::Arena;

/// Description of the sense `relative` in one line, for lists of all kinds.
pub(super) const ABOUT: &str = "simulated: distance, bearing and heading of the robots in view";

/// Settings of an example.
pub(super) const EXAMPLE: &str = "most = 3\nrange_m = 2.0\nmisses = 0.1\nfalse_ones = 0.1\ndistance_noise_m = 0.05";

/// Number of values of each detection: 1, or 0 for an empty place; distance \[m\]; bearing \[rad\]; heading \[rad\].
const VALUES: usize = 4;
/// Largest number of places, so that a measurement fits into one message.
const MOST: usize = 64;

/// Settings of the sense `relative` in a deployment.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Largest number of robots: the nearest count.
    most: usize,
    /// Largest distance at which a robot's centre is seen \[m\].
    range_m: f32,
    /// Angle of view \[rad\], half of it to each side of the direction ahead; a whole turn if left out.
    opening_rad: Option<f64>,
    /// Measurements in a second; as many as the World has steps if left out.
    rate_hz: Option<f64>,
    /// Delay of a measurement \[s\].
    #[serde(default)]
    delay_s: f64,
    /// Standard deviation of the noise of a distance \[m\].
    #[serde(default)]
    distance_noise_m: f32,
    /// Standard deviation of the noise of a bearing \[rad\].
    #[serde(default)]
    bearing_noise_rad: f32,
    /// Standard deviation of the noise of a heading \[rad\].
    #[serde(default)]
    heading_noise_rad: f32,
    /// Probability that a robot in view is not detected, 0 to 1.
    #[serde(default)]
    misses: f32,
    /// Probability that a measurement has one robot that is not there, 0 to 1.
    #[serde(default)]
    false_ones: f32,
}

impl Config {
    /// Checks the ranges of all settings. An error names the first wrong one.
    fn check(&self) -> Result<(), ConfigError> {
        in_range("most", self.most as f64, (1.0, MOST as f64))?;
        in_range("range_m", self.range_m.into(), (0.01, 1000.0))?;
        if let Some(opening) = self.opening_rad {
            in_range("opening_rad", opening, (0.001, TAU))?;
        }
        self.pace().check()?;
        in_range("distance_noise_m", self.distance_noise_m.into(), (0.0, 10.0))?;
        in_range("bearing_noise_rad", self.bearing_noise_rad.into(), (0.0, PI))?;
        in_range("heading_noise_rad", self.heading_noise_rad.into(), (0.0, PI))?;
        in_range("misses", self.misses.into(), (0.0, 1.0))?;
        in_range("false_ones", self.false_ones.into(), (0.0, 1.0))
    }

    fn pace(&self) -> Pace {
        Pace { rate_hz: self.rate_hz, delay_s: self.delay_s }
    }
}

/// Makes the parts of the sense from its settings. The error names the wrong setting.
pub(super) fn make(settings: &Settings, _: RobotId) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    config.check().map_err(|error| error.within(&settings.name))?;
    let layout = Layout { shape: vec![config.most, VALUES], unit: Unit::One, sweep: None };
    Ok(Parts::simulated(layout, config.pace(), move |site: Site| Relative {
        robot: site.robot,
        arena: site.arena.clone(),
        stream: site.stream,
        config: config.clone(),
    }))
}

/// Detector of one simulated robot.
struct Relative {
    robot: RobotId,
    config: Config,
    arena: Arena,
    stream: Stream,
}

/// Robot that is detected. Bearing and heading \[rad\] are relative to the heading of the detector.
#[derive(Clone, Copy)]
struct Detection {
    distance_m: f32,
    bearing_rad: f32,
    heading_rad: f32,
}

/// Returns an angle reduced to the range from -pi to pi.
fn turned(angle: f32) -> f32 {
    wrapped(angle.into()) as f32
}

/// Returns whether nothing is between the centres of two robots: no wall, and no hull of a third robot.
fn sees(arena: &Arena, [own, other]: [&Standing; 2], robots: &[Standing]) -> bool {
    let (way, hull_m) = (other.centre - own.centre, arena.hull_m());
    let is_between = |third: &Standing| {
        let share = ((third.centre - own.centre).dot(&way) / way.norm_squared()).clamp(0.0, 1.0);
        (own.centre + way * share - third.centre).norm() < hull_m
    };
    let mut thirds = robots.iter().filter(|third| third.robot != own.robot && third.robot != other.robot);
    !arena.keep_outs.iter().any(|block| block.blocks(own.centre, other.centre, 0.0)) && !thirds.any(is_between)
}

impl Relative {
    /// Returns whether a place at this distance and bearing is in range and in view.
    fn covers(&self, distance_m: f32, bearing_rad: f32) -> bool {
        let half = self.config.opening_rad.unwrap_or(TAU) / 2.0;
        distance_m <= self.config.range_m && f64::from(bearing_rad).abs() <= half
    }

    fn noise(&mut self, deviation: f32) -> f32 {
        if deviation > 0.0 { deviation * random::normals(&mut self.stream)[0] as f32 } else { 0.0 }
    }

    fn chance(&mut self, probability: f32) -> bool {
        probability > 0.0 && self.stream.random::<f32>() < probability
    }

    /// Returns the detections in a scene, the nearest first; `None` if the robot is not in it.
    fn detections(&mut self, scene: &Scene) -> Option<Vec<Detection>> {
        let own = *scene.robots.iter().find(|standing| standing.robot == self.robot)?;
        let arena = self.arena.at(scene.elapsed).into_owned();
        let mut found = Vec::new();
        for other in scene.robots.iter().filter(|other| other.robot != own.robot) {
            let way: Vec2 = other.centre - own.centre;
            let (distance_m, bearing_rad) = (way.norm(), turned(libm::atan2f(way.y, way.x) - own.heading));
            if !self.covers(distance_m, bearing_rad) || !sees(&arena, [&own, other], &scene.robots) {
                continue;
            }
            if self.chance(self.config.misses) {
                continue;
            }
            found.push(Detection {
                distance_m: (distance_m + self.noise(self.config.distance_noise_m)).max(0.0),
                bearing_rad: turned(bearing_rad + self.noise(self.config.bearing_noise_rad)),
                heading_rad: turned(other.heading - own.heading + self.noise(self.config.heading_noise_rad)),
            });
        }
        if self.chance(self.config.false_ones) {
            let half = (self.config.opening_rad.unwrap_or(TAU) / 2.0) as f32;
            let mut share = || self.stream.random::<f32>();
            found.push(Detection {
                distance_m: share() * self.config.range_m,
                bearing_rad: (2.0 * share() - 1.0) * half,
                heading_rad: turned((2.0 * share() - 1.0) * PI as f32),
            });
        }
        // The sort keeps the order of equal ones, which is that of ids.
        found.sort_by(|one, other| one.distance_m.total_cmp(&other.distance_m));
        Some(found)
    }
}

impl Measure for Relative {
    fn measure(&mut self, scene: &Scene) -> Option<Vec<f32>> {
        let found = self.detections(scene)?;
        let mut values = vec![0.0; self.config.most * VALUES];
        for (place, one) in values.chunks_exact_mut(VALUES).zip(found) {
            place.copy_from_slice(&[1.0, one.distance_m, one.bearing_rad, one.heading_rad]);
        }
        Some(values)
    }

    fn enter(&mut self, arena: &Arena) {
        self.arena.clone_from(arena);
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;
    use std::sync::Arc;

    use super::super::{In, Out, Sense};
    use super::*;
    use crate::random::Seed;
    use crate::scenario::KeepOut;
    use crate::time::{Span, Time};

    fn settings(text: &str) -> Settings {
        Settings { name: "others".to_owned(), table: text.parse().expect("it is TOML") }
    }

    fn sense(more: &str) -> Box<dyn Sense> {
        let parts = make(&settings(&format!("most = 3\nrange_m = 4.0\n{more}")), RobotId(0)).expect("it is valid");
        let wall = KeepOut::rect(Vec2::new(-2.0, -1.0), Vec2::new(-1.0, 1.0));
        let arena = Arena::new(Vec2::new(9.0, 9.0), vec![wall], 0.25);
        (parts.sense)(Site { robot: RobotId(0), arena: &arena, stream: Seed::of_run(1).stream("sense") })
    }

    /// Robot 0 looks along y. Robot 1 is to its right, and covers robot 2; robot 3 is behind a wall, and 4 ahead.
    fn scene(ms: u64) -> Scene {
        let at = [(0.0, 0.0, FRAC_PI_2), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (-3.0, 0.0, 0.0), (0.0, 3.0, -FRAC_PI_2)];
        let standing = |(robot, (x, y, heading)): (u16, (f32, f32, f32))| Standing {
            robot: RobotId(robot),
            centre: Vec2::new(x, y),
            heading,
        };
        let robots = (0..).zip(at).map(standing).collect();
        Scene {
            time: Time::ZERO + Span::from_millis(ms),
            placed: false,
            episode: 0,
            elapsed: None,
            robots,
            observed: Arc::default(),
        }
    }

    fn seen(sense: &mut dyn Sense, ms: u64) -> Vec<f32> {
        let mut out = Vec::new();
        sense.take(Time::ZERO, In::Scene(&scene(ms)), &mut out);
        match out.pop() {
            Some(Out::Values { values, .. }) => values,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn robots_in_view_are_relative_to_the_heading_and_what_is_covered_is_not_seen() {
        let values = seen(&mut *sense(""), 0);
        let turn = std::f32::consts::PI;
        let expected = [1.0, 1.0, -FRAC_PI_2, -FRAC_PI_2, 1.0, 3.0, 0.0, -turn, 0.0, 0.0, 0.0, 0.0];
        let near = |(one, other): (&f32, &f32)| (one - other).abs() < 1e-5 || (one + other).abs() < 1e-5;
        assert!(values.iter().zip(&expected).all(near), "{values:?}");
        let ahead = seen(&mut *sense("opening_rad = 1.0"), 0);
        assert_eq!((ahead[0], ahead[1], ahead[4]), (1.0, 3.0, 0.0), "only what is ahead");
    }

    #[test]
    fn misses_and_false_ones_are_as_many_as_said() {
        let (mut lossy, mut seeing) = (sense("misses = 0.25"), sense("false_ones = 0.25\ndistance_noise_m = 0.1"));
        let count = |values: &[f32]| values.iter().step_by(VALUES).sum::<f32>();
        let (mut found, mut extra) = (0.0, 0.0);
        for ms in 0..2000 {
            found += count(&seen(&mut *lossy, ms)) / 2000.0;
            extra += count(&seen(&mut *seeing, ms)) / 2000.0;
        }
        assert!((found - 1.5).abs() < 0.05 && (extra - 2.25).abs() < 0.05, "{found} {extra}");
    }

    #[test]
    fn wrong_settings_are_refused_by_their_names() {
        for (text, field) in [
            ("most = 0\nrange_m = 2", "others.most"),
            ("most = 65\nrange_m = 2", "others.most"),
            ("most = 3", "others: missing field `range_m`"),
            ("most = 3\nrange_m = 2\nmisses = 1.5", "others.misses"),
            ("most = 3\nrange_m = 2\nfalse_ones = nan", "others.false_ones"),
            ("most = 3\nrange_m = 2\nrate_hz = 0.0", "others.rate_hz"),
            ("most = 3\nrange_m = 2\nbearing_noise_rad = 4.0", "others.bearing_noise_rad"),
        ] {
            let error = make(&settings(text), RobotId(0)).err().expect("it is refused").to_string();
            assert!(error.starts_with(field), "{text}: {error}");
        }
    }
}
