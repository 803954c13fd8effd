//! Simulated lidar: distances along rays to walls, rails and the hulls of other robots, with rate, delay, noise and
//! dropouts.

use std::f64::consts::{PI, TAU};

use serde::Deserialize;

use super::paced::{Measure, Pace};
use super::rays::{MAX_RAYS, Rays};
use super::{Layout, Parts, Site, WHOLE_RAD};
use crate::config::{ConfigError, in_range};
use crate::edge::Settings;
use crate::messages::geometry::{Vec2, rotated};
use crate::messages::ids::RobotId;
use crate::messages::local::Scene;
use crate::observation::{Channel, Sweep, Unit};
use crate::random::{self, RngExt, Stream};
use crate::scenario::Arena;

/// Description of the sense `lidar` in one line, for lists of all kinds.
pub(super) const ABOUT: &str = "simulated: distances along rays to walls and the hulls of robots";

/// Settings of an example.
pub(super) const EXAMPLE: &str = "rays = 32\nrange_m = 2.0\nnoise_m = 0.01\ndropouts = 0.01\ndelay_s = 0.07";

/// Settings of a lidar in a deployment.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Number of rays.
    rays: usize,
    /// Largest distance at which something is seen \[m\].
    range_m: f32,
    /// Angle of the first ray \[rad\], counter-clockwise from the direction ahead.
    #[serde(default = "backward")]
    from_rad: f64,
    /// Angle from the first to the last ray \[rad\]. If it is a whole turn, or left out, the rays divide it evenly.
    opening_rad: Option<f64>,
    /// Place of the lidar on the robot \[m\]: ahead of its centre and to the left.
    #[serde(default)]
    mount_m: [f32; 2],
    /// Scans in a second; as many as the World has steps if left out.
    rate_hz: Option<f64>,
    /// Delay of a scan \[s\].
    #[serde(default)]
    delay_s: f64,
    /// Standard deviation of the noise of a distance \[m\].
    #[serde(default)]
    noise_m: f32,
    /// Probability that a ray has no echo, 0 to 1.
    #[serde(default)]
    dropouts: f32,
    /// Whether the rails about the ground are seen.
    #[serde(default = "yes")]
    rails: bool,
}

fn backward() -> f64 {
    -PI
}

fn yes() -> bool {
    true
}

impl Config {
    /// Checks the ranges of all settings. An error names the first wrong one.
    fn check(&self) -> Result<(), ConfigError> {
        in_range("rays", self.rays as f64, (1.0, MAX_RAYS as f64))?;
        in_range("range_m", self.range_m.into(), (0.01, 1000.0))?;
        in_range("from_rad", self.from_rad, (-TAU, TAU))?;
        if let Some(opening) = self.opening_rad {
            in_range("opening_rad", opening, (0.001, TAU + WHOLE_RAD))?;
        }
        for ahead_or_left in self.mount_m {
            in_range("mount_m", ahead_or_left.into(), (-10.0, 10.0))?;
        }
        self.pace().check()?;
        in_range("noise_m", self.noise_m.into(), (0.0, 10.0))?;
        in_range("dropouts", self.dropouts.into(), (0.0, 1.0))
    }

    fn pace(&self) -> Pace {
        Pace { rate_hz: self.rate_hz, delay_s: self.delay_s }
    }

    /// Returns the directions of the rays.
    fn sweep(&self) -> Sweep {
        let opening_rad = self.opening_rad.unwrap_or(TAU);
        Sweep { mount_m: self.mount_m, ..Sweep::new(self.rays, (self.from_rad, opening_rad), self.range_m) }
    }
}

/// Makes the parts of a lidar from its settings. The error names the wrong setting.
pub(super) fn make(settings: &Settings, _: RobotId) -> Result<Parts, ConfigError> {
    let config = checked(settings)?;
    let sweep = config.sweep();
    let layout = layout(config.rays, sweep);
    let scanner = Scanner::new(&config, &sweep);
    Ok(Parts::simulated(layout, config.pace(), move |site: Site| Lidar {
        robot: site.robot,
        scanner: scanner.clone(),
        arena: site.arena.clone(),
        stream: site.stream,
    }))
}

/// Returns the form of the values of a lidar with so many rays.
fn layout(rays: usize, sweep: Sweep) -> Layout {
    Layout { shape: vec![rays], unit: Unit::Metre, sweep: Some(sweep) }
}

/// Reads the settings of a lidar and checks them.
fn checked(settings: &Settings) -> Result<Config, ConfigError> {
    let config: Config = settings.read()?;
    config.check().map_err(|error| error.within(&settings.name))?;
    Ok(config)
}

/// Lidar without its schedule: distances along its rays from a place among walls and robots.
#[derive(Clone, Debug)]
pub struct Scanner {
    rays: Rays,
    mount: Vec2,
    /// Whether the rails about the ground are seen.
    rails: bool,
    noise_m: f32,
    dropouts: f32,
    sweep: Sweep,
}

impl Scanner {
    /// Makes the scanner of a sense `lidar` called `name`, for scans that the caller makes when it wants them. The
    /// error names the wrong setting; rate and delay are wrong, too.
    pub fn of(name: &str, settings: &super::Settings) -> Result<Scanner, ConfigError> {
        let wrong = |field: &str, why: &str| Err(ConfigError::field(format!("{name}.{field}"), why));
        if settings.kind != "lidar" {
            return wrong("kind", "a 'lidar' alone can be had here");
        }
        let config = checked(&settings.named(name))?;
        match config {
            Config { rate_hz: Some(_), .. } => wrong("rate_hz", "there is a scan in each step here; leave it out"),
            Config { delay_s, .. } if delay_s > 0.0 => wrong("delay_s", "scans have no delay here; leave it out"),
            _ => Ok(Scanner::new(&config, &config.sweep())),
        }
    }

    fn new(config: &Config, sweep: &Sweep) -> Scanner {
        Scanner {
            rays: Rays::new(config.rays, (sweep.from_rad, sweep.step_rad), config.range_m),
            mount: Vec2::from(config.mount_m),
            rails: config.rails,
            noise_m: config.noise_m,
            dropouts: config.dropouts,
            sweep: *sweep,
        }
    }

    /// Returns the channel of the observation by which a policy takes the lidar called `name`, the one with this
    /// `index` among the senses of the robot.
    pub fn channel(&self, name: &str, index: usize) -> Channel {
        layout(self.rays(), self.sweep).channel(name, index)
    }

    /// Returns the directions and the range of the rays.
    pub fn sweep(&self) -> &Sweep {
        &self.sweep
    }

    /// Returns the number of rays.
    pub fn rays(&self) -> usize {
        self.rays.count()
    }

    /// Writes the distances along the rays into `ranges` \[m\], without noise; infinite for no echo. The robot is at
    /// `centre` \[m\] with this `heading` \[rad\], world frame, and the angles of the rays count from the direction
    /// `ahead` \[rad\]: its heading, for rays in its own frame. `others` are the centres of the other robots \[m\].
    #[inline]
    pub fn scan(
        &mut self,
        arena: &Arena,
        (centre, heading, ahead): (Vec2, f32, f32),
        others: impl Iterator<Item = Vec2>,
        ranges: &mut [f32],
    ) {
        let mut origin = centre;
        if self.mount != Vec2::zeros() {
            let (x, y) = rotated(heading.into(), self.mount.x.into(), self.mount.y.into());
            origin += Vec2::new(x as f32, y as f32);
        }
        let radius_m = arena.hull_m();
        self.rays.place(origin, ahead);
        self.rays.meet_discs(others, radius_m);
        arena.keep_outs.iter().for_each(|block| self.rays.meet_block(block));
        if self.rails {
            // The hull of a robot touches the rails when its centre is at the end of the ground.
            self.rays.meet_rails(arena.half_extent.add_scalar(radius_m));
        }
        self.rays.write(ranges);
    }

    /// Adds noise to the distances, and takes away the echoes that are lost. Without noise and losses no number is
    /// drawn; with them as many for each ray, whatever it meets.
    #[inline]
    pub fn disturb(&self, stream: &mut Stream, ranges: &mut [f32]) {
        if self.noise_m > 0.0 || self.dropouts > 0.0 {
            self.disturb_each(stream, ranges);
        }
    }

    fn disturb_each(&self, stream: &mut Stream, ranges: &mut [f32]) {
        let (noise, most) = (self.noise_m, self.sweep.range_m);
        for range in ranges {
            if noise > 0.0 {
                let [off, _] = random::normals(stream);
                let noisy = (*range + noise * off as f32).max(0.0);
                *range = if noisy <= most { noisy } else { f32::INFINITY };
            }
            if self.dropouts > 0.0 && stream.random::<f32>() < self.dropouts {
                *range = f32::INFINITY;
            }
        }
    }
}

/// Lidar of one simulated robot.
struct Lidar {
    robot: RobotId,
    scanner: Scanner,
    arena: Arena,
    stream: Stream,
}

impl Measure for Lidar {
    fn measure(&mut self, scene: &Scene) -> Option<Vec<f32>> {
        let at = scene.robots.binary_search_by_key(&self.robot, |standing| standing.robot).ok()?;
        let own = &scene.robots[at];
        let others = scene.robots.iter().filter(|other| other.robot != self.robot).map(|other| other.centre);
        let mut values = vec![0.0; self.scanner.rays()];
        let arena = self.arena.at(scene.elapsed);
        self.scanner.scan(&arena, (own.centre, own.heading, own.heading), others, &mut values);
        self.scanner.disturb(&mut self.stream, &mut values);
        Some(values)
    }

    fn enter(&mut self, arena: &Arena) {
        self.arena.clone_from(arena);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::{In, Out, Sense};
    use super::*;
    use crate::messages::local::Standing;
    use crate::random::Seed;
    use crate::scenario::KeepOut;
    use crate::time::{Span, Time};

    fn settings(text: &str) -> Settings {
        Settings { name: "eyes".to_owned(), table: text.parse().expect("it is TOML") }
    }

    fn arena() -> Arena {
        let wall = KeepOut::rect(Vec2::new(-1.0, 1.0), Vec2::new(1.0, 1.2));
        Arena::new(Vec2::new(3.0, 3.0), vec![wall], 0.25)
    }

    /// Makes a lidar of robot 0 with four rays: behind, to the right, ahead, to the left.
    fn lidar(more: &str) -> Box<dyn Sense> {
        let parts = make(&settings(&format!("rays = 4\nrange_m = 3.5\n{more}")), RobotId(0)).expect("it is valid");
        let stream = Seed::of_run(1).stream("sense");
        (parts.sense)(Site { robot: RobotId(0), arena: &arena(), stream })
    }

    fn scene(ms: u64, placed: bool) -> Scene {
        let standing = |robot, x, y| Standing { robot: RobotId(robot), centre: Vec2::new(x, y), heading: 0.0 };
        let robots = [standing(0, 0.0, 0.0), standing(1, 2.0, 0.0), standing(2, 0.0, -9.0)].into();
        Scene {
            time: Time::ZERO + Span::from_millis(ms),
            placed,
            episode: 0,
            elapsed: None,
            robots,
            observed: Arc::default(),
        }
    }

    fn scans(sense: &mut dyn Sense, scene: &Scene) -> Vec<Vec<f32>> {
        let mut out = Vec::new();
        sense.take(scene.time, In::Scene(scene), &mut out);
        values(out)
    }

    fn values(out: Vec<Out>) -> Vec<Vec<f32>> {
        let values = |out| match out {
            Out::Values { values, .. } => values,
            Out::Refused(why) => panic!("{why}"),
        };
        out.into_iter().map(values).collect()
    }

    #[test]
    fn walls_rails_and_the_hulls_of_others_are_seen_and_the_own_hull_is_not() {
        let all = scans(&mut *lidar(""), &scene(0, false)).concat();
        let expected = [3.16, 3.16, 1.84, 1.0];
        assert!(all.iter().zip(expected).all(|(one, other)| (one - other).abs() < 1e-5), "{all:?}");
        let open = scans(&mut *lidar("rails = false"), &scene(0, false)).concat();
        assert_eq!(open[..2], [f32::INFINITY; 2]);
        let mounted = scans(&mut *lidar("mount_m = [0.1, 0.05]"), &scene(0, false)).concat();
        assert!((mounted[2] - (1.9 - (0.16f32 * 0.16 - 0.05 * 0.05).sqrt())).abs() < 1e-5, "{mounted:?}");
        assert!((mounted[3] - 0.95).abs() < 1e-5, "{mounted:?}");
    }

    #[test]
    fn an_opening_ends_with_a_ray_on_each_side_and_a_whole_turn_does_not() {
        let sweep = |text: &str| {
            let parts = make(&settings(text), RobotId(0)).expect("it is valid");
            parts.layout.sweep.expect("it has rays")
        };
        let half = sweep("rays = 5\nrange_m = 2\nfrom_rad = -1.0\nopening_rad = 2.0");
        assert_eq!((half.from_rad, half.step_rad, half.around), (-1.0, 0.5, false));
        for whole in ["", "opening_rad = 6.283", "opening_rad = 6.2831853"] {
            let whole = sweep(&format!("rays = 8\nrange_m = 2\n{whole}"));
            assert_eq!((whole.from_rad, whole.step_rad, whole.around), (-PI, TAU / 8.0, true));
        }
        assert!(sweep("rays = 1\nrange_m = 2\nopening_rad = 1.0").step_rad > 0.0);
    }

    #[test]
    fn scans_come_at_their_rate_after_their_delay_and_none_from_before_a_placement() {
        let mut slow = lidar("rate_hz = 10");
        let counts = [0, 50, 100, 150, 200].map(|ms| scans(&mut *slow, &scene(ms, false)).len());
        assert_eq!(counts, [1, 0, 1, 0, 1]);
        assert_eq!(scans(&mut *slow, &scene(250, true)).len(), 1, "a placed robot looks at once");
        let mut late = lidar("delay_s = 0.03");
        assert_eq!(scans(&mut *late, &scene(0, false)).len(), 0);
        let due = Time::ZERO + Span::from_millis(30);
        assert_eq!(late.wake_at(), Some(due));
        let mut out = Vec::new();
        late.wake(due, &mut out);
        assert_eq!((values(out).len(), late.wake_at()), (1, None));
        assert_eq!(scans(&mut *late, &scene(50, false)).len() + scans(&mut *late, &scene(70, true)).len(), 0);
        assert_eq!(late.wake_at(), Some(Time::ZERO + Span::from_millis(100)), "the scan of before is dropped");
    }

    #[test]
    fn noise_scatters_about_the_distance_and_lost_echoes_are_as_many_as_said() {
        let mut noisy = lidar("noise_m = 0.05\ndropouts = 0.2");
        let all: Vec<f32> = (0..4000).flat_map(|ms| scans(&mut *noisy, &scene(ms, false))[0][2..3].to_vec()).collect();
        let seen: Vec<f32> = all.iter().copied().filter(|range| range.is_finite()).collect();
        let lost = 1.0 - seen.len() as f32 / all.len() as f32;
        assert!((lost - 0.2).abs() < 0.03, "{lost}");
        let mean = seen.iter().sum::<f32>() / seen.len() as f32;
        let deviation = (seen.iter().map(|range| (range - mean).powi(2)).sum::<f32>() / seen.len() as f32).sqrt();
        assert!((mean - 1.84).abs() < 5e-3 && (deviation - 0.05).abs() < 5e-3, "{mean} {deviation}");
    }

    #[test]
    fn wrong_settings_are_refused_by_their_names() {
        for (text, field) in [
            ("rays = 0\nrange_m = 2", "eyes.rays"),
            ("rays = 257\nrange_m = 2", "eyes.rays"),
            ("rays = 8\nrange_m = nan", "eyes.range_m"),
            ("rays = 8", "eyes: missing field `range_m`"),
            ("rays = 8\nrange_m = 2\nopening_rad = 7.0", "eyes.opening_rad"),
            ("rays = 8\nrange_m = 2\nmount_m = [1.0, 11.0]", "eyes.mount_m"),
            ("rays = 8\nrange_m = 2\nrate_hz = 0.0", "eyes.rate_hz"),
            ("rays = 8\nrange_m = 2\ndelay_s = -1.0", "eyes.delay_s"),
            ("rays = 8\nrange_m = 2\nnoise_m = -1.0", "eyes.noise_m"),
            ("rays = 8\nrange_m = 2\ndropouts = 1.5", "eyes.dropouts"),
            ("rays = 8\nrange_m = 2\ncolour = 1", "eyes.colour: unknown field"),
        ] {
            let error = make(&settings(text), RobotId(0)).err().expect("it is refused").to_string();
            assert!(error.starts_with(field), "{text}: {error}");
        }
    }
}
