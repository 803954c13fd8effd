//! Scans of `sensor_msgs/LaserScan` as the rays of a sense: which ray of a scan is in which direction, and which of its
//! numbers are distances (REP-117). Does no I/O.

use std::f64::consts::TAU;

use murmurate::observation::Sweep;
use serde::{Deserialize, Serialize};

use super::messages::LaserScan;

/// Largest number of ranges of a scan. The largest lidars of a plane have some 8000 in a turn.
pub const MAX_RANGES: usize = 16_384;
/// Difference between the number of steps from `angle_min` to `angle_max` and the number of ranges less one above which
/// both do not fit. Widespread drivers count one too many or too few, since in a whole turn the last ray is the first.
const STEPS_OFF: f64 = 1.5;
/// Largest angle from the first to the last ray of a scan \[rad\]: a turn, and a little that some measure twice.
const LARGEST_TURN: f64 = TAU * 1.05;
/// Share of a step by which a direction may be farther than half a step from a ray and still have its distance, for
/// angles that are rounded to 32-bit floats.
const ROUNDED: f64 = 1e-3;

/// Rays of a sense, and how the scanner whose scans give their distances is mounted on the robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fan {
    /// Number of rays.
    pub rays: u16,
    /// Angle of the first ray \[rad\], counter-clockwise from the direction ahead of the robot.
    pub from_rad: f64,
    /// Angle from each ray to the next one \[rad\].
    pub step_rad: f64,
    /// Distance beyond which an echo counts as none \[m\].
    pub range_m: f32,
    /// Angle of the scanner's x axis \[rad\], counter-clockwise from the direction ahead of the robot.
    pub yaw_rad: f64,
    /// Whether the scanner hangs upside down, so that its angles are clockwise seen from above.
    pub upside_down: bool,
}

/// Scan as it is passed from a DDS process to its host: the distances along the rays of a [`Fan`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScanSample {
    /// Time of measurement \[ns\] on the sender's clock; zero if the message has no time stamp.
    pub stamp_ns: u64,
    /// Distance along each ray \[m\]; `None` for no echo.
    pub ranges_m: Vec<Option<f32>>,
}

impl ScanSample {
    /// Whether there are distances, no more than a sense has, and none of them is negative or not finite.
    pub fn is_sound(&self) -> bool {
        let sound = |range: &f32| (0.0..=1e6).contains(range);
        (1..=murmurate::senses::rays::MAX_RAYS).contains(&self.ranges_m.len())
            && self.ranges_m.iter().flatten().all(sound)
    }
}

impl Fan {
    /// Makes the rays of a sense with the directions and the range of `sweep`. `rays` is their number. The scanner's x
    /// axis is at `yaw_rad`, counter-clockwise from the direction ahead of the robot.
    pub fn new(rays: u16, sweep: &Sweep, yaw_rad: f64, upside_down: bool) -> Fan {
        let Sweep { from_rad, step_rad, range_m, .. } = *sweep;
        Fan { rays, from_rad, step_rad, range_m, yaw_rad, upside_down }
    }

    /// Returns the distances along the rays, each of the scan's ray that is nearest to its direction: no echo if none
    /// is within half a step of the scan. The error says what is wrong with the scan.
    ///
    /// Numbers are those of REP-117: positive infinity is no echo, and so are distances beyond `range_max` and beyond
    /// the range of the fan. Negative infinity is an object too close to measure, and counts as `range_min`. What is
    /// not a number, or a distance below `range_min`, is unknown, and counts as no echo.
    pub fn take(&self, scan: &LaserScan) -> Result<ScanSample, &'static str> {
        let sec = u64::try_from(scan.header.stamp.sec).map_err(|_| "its stamp is negative; set the sender's clock")?;
        if scan.header.stamp.nanosec >= 1_000_000_000 {
            return Err("its stamp has a second or more of nanoseconds; correct its sender");
        }
        check(scan)?;
        let nearest = Nearest::of(scan);
        let (mut ranges_m, mut covered, mut unknown) = (Vec::with_capacity(self.rays.into()), 0, 0);
        for ray in 0..self.rays {
            let ahead = self.from_rad + self.step_rad * f64::from(ray) - self.yaw_rad;
            let range = nearest.to(if self.upside_down { -ahead } else { ahead }).map(|index| scan.ranges[index]);
            covered += u32::from(range.is_some());
            let known = |range: f32| range >= scan.range_min || range == f32::NEG_INFINITY;
            unknown += u32::from(range.is_some_and(|range| !known(range)));
            ranges_m.push(range.and_then(|range| self.distance(range, scan)));
        }
        if covered == 0 {
            return Err("none of its rays is in a direction that the sense has; see from_rad, opening_rad and yaw_rad");
        }
        // A scanner that fails is not an empty room.
        if covered == unknown {
            return Err("none of its ranges is a known distance; see whether the scanner works");
        }
        Ok(ScanSample { stamp_ns: sec * 1_000_000_000 + u64::from(scan.header.stamp.nanosec), ranges_m })
    }

    /// Returns the distance that a number of a scan means \[m\]; `None` for no echo.
    fn distance(&self, range: f32, scan: &LaserScan) -> Option<f32> {
        let range = if range == f32::NEG_INFINITY { scan.range_min } else { range };
        // NaN is in no range.
        let met = range >= scan.range_min && range <= scan.range_max && range <= self.range_m;
        met.then_some(range)
    }
}

/// Checks angles, number of ranges and limits of a scan. The error says what is wrong with them.
fn check(scan: &LaserScan) -> Result<(), &'static str> {
    let [from, to, step] = [scan.angle_min, scan.angle_max, scan.angle_increment].map(f64::from);
    if !(from.is_finite() && to.is_finite() && step.is_finite()) {
        return Err("an angle of it is not finite; correct its sender");
    }
    if scan.ranges.is_empty() || scan.ranges.len() > MAX_RANGES {
        return Err("it has no ranges, or more than 16384; see what publishes it");
    }
    if step == 0.0 {
        return Err("its angle_increment is 0; correct its sender");
    }
    if (to - from).abs() > LARGEST_TURN || from.abs() > 2.0 * TAU {
        return Err("its angles are more than a turn; correct its sender");
    }
    if ((to - from) / step - (scan.ranges.len() - 1) as f64).abs() > STEPS_OFF {
        return Err("its ranges are not as many as its angles say; correct its sender");
    }
    if !(scan.range_min >= 0.0 && scan.range_min <= 1000.0 && scan.range_max > scan.range_min) {
        return Err("its range_min is not from 0 to 1000 m, or range_max is not above it; correct its sender");
    }
    Ok(())
}

/// Search for the ray of a scan that is nearest to a direction.
struct Nearest {
    from_rad: f64,
    step_rad: f64,
    rays: usize,
}

impl Nearest {
    /// Makes the search for a checked scan.
    fn of(scan: &LaserScan) -> Nearest {
        let (from_rad, step_rad) = (scan.angle_min.into(), scan.angle_increment.into());
        Nearest { from_rad, step_rad, rays: scan.ranges.len() }
    }

    /// Returns the index of the ray of the scan that is nearest to a direction in the scanner's frame \[rad\]; `None`
    /// if none is within half a step.
    fn to(&self, direction: f64) -> Option<usize> {
        let (turn, last) = ((TAU / self.step_rad).abs(), (self.rays - 1) as f64);
        // In steps from the first ray, in the sense of rotation of the scan: from zero to less than a turn.
        let along = (direction - self.from_rad) / self.step_rad;
        let along = along - turn * (along / turn).floor();
        // The first ray again, a turn further on, is as near as the first one.
        let index = [along, along - turn].into_iter().map(|along| (along, along.round().clamp(0.0, last)));
        let (off, index) =
            index.map(|(along, index)| ((along - index).abs(), index)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        (off <= 0.5 + ROUNDED).then_some(index as usize)
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_4;
    use std::f64::consts::{FRAC_PI_2, PI};

    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;
    use crate::messages::{Header, Stamp};

    const NO_ECHO: f32 = f32::INFINITY;

    /// Change of a scan.
    type Change<'a> = &'a dyn Fn(&mut LaserScan);

    /// Scan of evenly spaced rays all around, the first one ahead, whose ranges are their indices and a half.
    fn around(rays: u16) -> LaserScan {
        let step = TAU as f32 / f32::from(rays);
        LaserScan {
            header: Header { stamp: Stamp { sec: 12, nanosec: 34 }, frame_id: "laser".to_owned() },
            angle_max: step * f32::from(rays - 1),
            angle_increment: step,
            range_min: 0.1,
            range_max: 100.0,
            ranges: (0..rays).map(|ray| f32::from(ray) + 0.5).collect(),
            ..LaserScan::default()
        }
    }

    /// Four rays: behind, to the right, ahead, to the left.
    fn four() -> Fan {
        Fan::new(4, &Sweep::new(4, (-PI, TAU), 50.0), 0.0, false)
    }

    fn taken(fan: &Fan, scan: &LaserScan) -> Vec<f32> {
        let sample = fan.take(scan).expect("it is a scan");
        sample.ranges_m.into_iter().map(|range| range.unwrap_or(NO_ECHO)).collect()
    }

    #[test]
    fn each_ray_has_the_distance_of_the_nearest_ray_of_the_scan() {
        let sample = four().take(&around(8)).expect("it is a scan");
        assert_eq!(sample.stamp_ns, 12_000_000_034);
        assert_eq!(taken(&four(), &around(8)), [4.5, 6.5, 0.5, 2.5]);
        assert_eq!(taken(&four(), &around(40)), [20.5, 30.5, 0.5, 10.5]);
        let turned = LaserScan { angle_min: 1.0, angle_max: 1.0 + 7.0 * FRAC_PI_4, ..around(8) };
        assert_eq!(taken(&four(), &turned), [3.5, 5.5, 7.5, 1.5], "0.22 rad from each");
    }

    #[test]
    fn a_scan_that_turns_clockwise_or_is_turned_or_upside_down_is_the_same_one() {
        let expected = [4.5, 6.5, 0.5, 2.5];
        let mut clockwise = around(8);
        (clockwise.angle_min, clockwise.angle_max) = (clockwise.angle_max, 0.0);
        clockwise.angle_increment *= -1.0;
        clockwise.ranges.reverse();
        assert_eq!(taken(&four(), &clockwise), expected);
        assert_eq!(taken(&Fan { upside_down: true, ..four() }, &around(8)), [4.5, 2.5, 0.5, 6.5]);
        assert_eq!(taken(&Fan { yaw_rad: FRAC_PI_2, ..four() }, &around(8)), [2.5, 4.5, 6.5, 0.5], "its x is left");
        let from_behind = LaserScan { angle_min: -PI as f32, angle_max: (PI * 0.75) as f32, ..around(8) };
        assert_eq!(taken(&four(), &from_behind), [0.5, 2.5, 4.5, 6.5]);
    }

    #[test]
    fn a_ray_where_the_scan_has_none_is_no_echo() {
        let ahead = LaserScan { angle_min: -1.0, angle_max: 1.0, angle_increment: 0.25, ..around(9) };
        assert_eq!(taken(&four(), &ahead), [NO_ECHO, NO_ECHO, 4.5, NO_ECHO]);
        let fan = Fan::new(3, &Sweep::new(3, (-1.12, 2.24), 50.0), 0.0, false);
        assert_eq!(taken(&fan, &ahead), [0.5, 4.5, 8.5], "within half a step beyond the ends");
        let wider = Fan::new(3, &Sweep::new(3, (-1.13, 2.26), 50.0), 0.0, false);
        assert_eq!(taken(&wider, &ahead), [NO_ECHO, 4.5, NO_ECHO]);
        let behind = Fan::new(1, &Sweep::new(1, (PI, 0.1), 50.0), 0.0, false);
        assert!(behind.take(&ahead).is_err_and(|why| why.contains("in a direction that the sense has")));
    }

    #[test]
    fn numbers_mean_what_rep_117_says() {
        let with =
            |ranges: [f32; 4]| LaserScan { ranges: ranges.to_vec(), range_min: 0.2, range_max: 8.0, ..around(4) };
        let fan = Fan { from_rad: 0.0, range_m: 5.0, ..four() };
        let odd = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 0.0];
        assert_eq!(taken(&fan, &with(odd)), [NO_ECHO, 0.2, NO_ECHO, NO_ECHO]);
        assert_eq!(taken(&fan, &with([5.0, 5.1, 8.1, -1.0])), [5.0, NO_ECHO, NO_ECHO, NO_ECHO]);
        for broken in [[f32::NAN; 4], [0.0; 4], [f32::NAN, 0.0, 0.1, f32::NAN]] {
            let refused =
                fan.take(&with(broken)).is_err_and(|why| why.contains("none of its ranges is a known distance"));
            assert!(refused, "{broken:?}");
        }
        assert_eq!(taken(&fan, &with([NO_ECHO; 4])), [NO_ECHO; 4], "an empty room");
    }

    #[test]
    fn scans_that_contradict_themselves_are_errors() {
        let wrong = |change: Change| {
            let mut scan = around(360);
            change(&mut scan);
            four().take(&scan).err()
        };
        let changes: [(Change, &str); 12] = [
            (&|scan| scan.ranges.clear(), "no ranges"),
            (&|scan| scan.ranges = vec![1.0; MAX_RANGES + 1], "more than 16384"),
            (&|scan| scan.ranges.truncate(357), "not as many as its angles say"),
            (&|scan| scan.ranges.extend([1.0; 2]), "not as many as its angles say"),
            (&|scan| scan.angle_increment = 0.0, "angle_increment is 0"),
            (&|scan| scan.angle_increment *= -1.0, "not as many as its angles say"),
            (&|scan| scan.angle_increment = f32::NAN, "not finite"),
            (&|scan| scan.angle_max = 7.0, "more than a turn"),
            (&|scan| scan.range_min = f32::NAN, "range_min"),
            (&|scan| scan.range_max = 0.1, "range_max"),
            (&|scan| scan.header.stamp.sec = -1, "stamp is negative"),
            (&|scan| scan.header.stamp.nanosec = 1_000_000_000, "nanoseconds"),
        ];
        for (change, why) in changes {
            assert!(wrong(change).is_some_and(|error| error.contains(why)), "{why}");
        }
        assert_eq!(wrong(&|scan| scan.ranges.truncate(359)), None, "many drivers count one too few");
        assert_eq!(wrong(&|scan| scan.ranges.push(1.0)), None, "or one too many");
        assert_eq!(wrong(&|scan| scan.range_max = f32::INFINITY), None);
    }

    fn any_float() -> impl Strategy<Value = f32> {
        prop_oneof![any::<f32>(), -7.0f32..7.0, Just(0.0), Just(f32::NAN), Just(f32::INFINITY)]
    }

    proptest! {
        #[test]
        fn any_scan_gives_sound_distances_or_an_error(
            angles in [any_float(), any_float(), any_float()],
            limits in [any_float(), any_float()],
            ranges in vec(any_float(), 0..64),
            fits in any::<bool>(),
            yaw_rad in -7.0f64..7.0,
        ) {
            let [angle_min, mut angle_max, angle_increment] = angles;
            if fits {
                angle_max = angle_min + angle_increment * (ranges.len() as f32 - 1.0);
            }
            let [range_min, range_max] = limits;
            let scan = LaserScan { angle_min, angle_max, angle_increment, range_min, range_max, ranges, ..around(1) };
            let fan = Fan::new(32, &Sweep::new(32, (-PI, TAU), 5.0), yaw_rad, fits);
            if let Ok(sample) = fan.take(&scan) {
                prop_assert!(sample.is_sound());
                let known = |range: &f32| scan.ranges.contains(range) || *range == scan.range_min;
                prop_assert!(sample.ranges_m.iter().flatten().all(|range| *range <= 5.0 && known(range)));
            }
        }
    }
}
