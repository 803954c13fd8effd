//! Channels whose values are those of a sense of the robot, written as a policy takes them: the directions and the
//! range of the rays, what stands for no echo, and what happens when they are old.

use std::f64::consts::TAU;

use super::channel::{Channel, Known, Quantity, Unit};
use super::frame::Frame;
use super::sense::{IfStale, Miss, NamedMiss, Sense, Sweep, Taking};
use crate::time::Span;

/// Checked rules by which the values of a sense are written.
#[derive(Clone, Copy, Debug)]
struct Rules {
    index: usize,
    stale_after: Span,
    if_stale: IfStale,
    range_m: f32,
    miss: f32,
    /// Frame and directions of rays; `None` for values that are no distances along rays.
    rays: Option<(Frame, Sweep, f64)>,
}

impl Channel {
    /// Makes the channel of the sense with this `index` among those of a robot, of arrays of the given shape. `sweep`
    /// has the directions of the rays of a sense whose values are distances.
    pub(crate) fn of_sense(
        name: String,
        index: usize,
        (shape, unit): (Vec<usize>, Unit),
        sweep: Option<Sweep>,
    ) -> Channel {
        let about = "values of a sense of the robot";
        let unknown = |_: &Known, out: &mut [f32]| out.fill(f32::NAN);
        Channel {
            sense: Some(Sense { index, sweep }),
            ..Channel::new(name, about, (shape, unit, Quantity::Number), unknown)
        }
    }
}

/// Returns the channel with the function that writes it as a policy takes it, in `frame` and by the rules `taking`:
/// `channel` itself if it is no sense. An error says what the policy and the team do not agree about.
pub(super) fn taken(channel: &Channel, frame: Option<Frame>, taking: &Taking) -> Result<Channel, String> {
    let Some(Sense { index, sweep }) = channel.sense else {
        let fields = *taking != Taking::default();
        let why = "only a sense has the fields from_rad, range_m, miss, stale_after_s and if_stale";
        return if fields { Err(format!("{why}, and '{}' is none", channel.name)) } else { Ok(channel.clone()) };
    };
    let Taking { from_rad, range_m, miss, stale_after_s, if_stale } = *taking;
    let Some(stale_after_s) = stale_after_s.filter(|age| *age > 0.0 && *age <= 60.0) else {
        return Err(
            "stale_after_s is missing or not above 0 and at most 60: the age at which the sense is stale".into()
        );
    };
    let range_m = match (range_m, sweep) {
        (Some(_), None) => return Err(format!("range_m is for distances, which '{}' has not", channel.name)),
        (None, sweep) => sweep.map_or(f32::INFINITY, |sweep| sweep.range_m),
        (Some(range_m), Some(sweep)) if range_m > 0.0 && range_m <= sweep.range_m => range_m,
        (Some(range_m), Some(sweep)) => {
            let theirs = sweep.range_m;
            return Err(format!("the policy sees as far as {range_m} m, and '{}' {theirs} m", channel.name));
        }
    };
    let miss = match miss {
        Some(Miss::Number(miss)) if miss.abs() <= 1e6 => miss,
        Some(Miss::Number(_)) => return Err("miss is not a number from -1e6 to 1e6".to_owned()),
        Some(Miss::Named(NamedMiss::Zero)) => 0.0,
        Some(Miss::Named(NamedMiss::Range)) | None if sweep.is_some() => range_m,
        Some(Miss::Named(NamedMiss::Range)) => return Err("miss = \"range\" is for distances".to_owned()),
        None => 0.0,
    };
    let rays = match sweep {
        Some(sweep) => Some(rays(channel, frame, (sweep, from_rad))?),
        None if from_rad.is_some() => return Err(format!("from_rad is for rays, which '{}' has not", channel.name)),
        None => None,
    };
    let stale_after = Span::from_secs(stale_after_s);
    let rules = Rules { index, stale_after, if_stale: if_stale.unwrap_or_default(), range_m, miss, rays };
    let write = move |known: &Known, out: &mut [f32]| rules.write(known, out);
    let form = (channel.shape.clone(), channel.unit, Quantity::Number);
    Ok(Channel::new(channel.name.clone(), channel.about, form, write))
}

/// Returns the frame in which a policy takes the rays of a sense, with their directions and the angle of the first one.
fn rays(
    channel: &Channel,
    frame: Option<Frame>,
    (sweep, from_rad): (Sweep, Option<f64>),
) -> Result<(Frame, Sweep, f64), String> {
    let Some(frame) = frame else {
        return Err("its frame is missing: world, policy or body".to_owned());
    };
    let from = from_rad.unwrap_or(sweep.from_rad);
    if !(-TAU..=TAU).contains(&from) {
        return Err(format!("from_rad {from} is not within one turn"));
    }
    let name = &channel.name;
    if !sweep.around && frame != Frame::Body {
        return Err(format!("'{name}' does not see all around, so it can be taken in the frame 'body' alone"));
    }
    if !sweep.around && (from - sweep.from_rad).abs() > 1e-4 {
        let ours = sweep.from_rad;
        return Err(format!("the policy's first ray is at {from} rad, and that of '{name}' at {ours} rad"));
    }
    Ok((frame, sweep, from))
}

impl Rules {
    /// Writes the values; all are not numbers if the step has to count as none.
    fn write(&self, known: &Known, out: &mut [f32]) {
        let newest = known.sensed.get(self.index).and_then(Option::as_ref);
        let newest = newest.filter(|sensed| sensed.values.0.len() == out.len());
        let fresh = newest.is_some_and(|sensed| sensed.age <= self.stale_after);
        let values = match (newest, self.if_stale) {
            (Some(sensed), _) if fresh => &sensed.values.0,
            (Some(sensed), IfStale::Last) => &sensed.values.0,
            (_, IfStale::Miss) => return out.fill(self.miss),
            (_, IfStale::Stop | IfStale::Last) => return out.fill(f32::NAN),
        };
        let Some(shift) = self.shift(known, out.len()) else { return out.fill(f32::NAN) };
        let (later, first) = values.split_at(shift);
        for (out, value) in out.iter_mut().zip(first.iter().chain(later)) {
            *out = if *value <= self.range_m && *value < f32::INFINITY { *value } else { self.miss };
        }
    }

    /// Returns the index of the sense's ray that is nearest to the first one that the policy takes; `None` if the
    /// robot's heading is needed for it and not known.
    fn shift(&self, known: &Known, rays: usize) -> Option<usize> {
        let Some((frame, sweep, from)) = self.rays else { return Some(0) };
        let heading = match frame {
            Frame::Body => 0.0,
            Frame::Policy => known.own.heading?,
            Frame::World => known.own.frame.turn_angle(known.own.heading?),
        };
        if !sweep.around {
            return Some(0);
        }
        let steps = (from - f64::from(heading) - sweep.from_rad) / sweep.step_rad;
        // Half a step between two rays is rounded up on every machine.
        let nearest = libm::floor(steps + 0.5);
        Some((nearest as i64).rem_euclid(rays as i64) as usize)
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;
    use std::f64::consts::PI;

    use super::*;
    use crate::messages::geometry::{Motion, Task, Vec2};
    use crate::messages::local::Sensation;
    use crate::messages::wire::Features;
    use crate::observation::{Bound, Observation, PolicyFrame, Request};

    /// Lidar with four rays: behind, to the right, ahead, to the left.
    fn channel(around: bool) -> Channel {
        let sweep = Sweep { around, ..Sweep::new(4, (-PI, TAU), 5.0) };
        Channel::of_sense("eyes".to_owned(), 1, (vec![4], Unit::Metre), Some(sweep))
    }

    fn request(frame: Frame, taking: Taking) -> Request {
        let (shape, unit) = (vec![4], Unit::Metre);
        Request { input: "lidar".to_owned(), channel: "eyes".to_owned(), shape, unit, frame: Some(frame), taking }
    }

    const FRESH: Taking =
        Taking { from_rad: None, range_m: None, miss: None, stale_after_s: Some(0.1), if_stale: None };

    fn write(bound: &Bound, sensed: &[Option<Sensation>], (heading, frame): (Option<f32>, PolicyFrame)) -> Vec<f32> {
        let task = Task { start: Vec2::zeros(), goal: Vec2::zeros() };
        let heading = heading.map(|heading| frame.turn_angle(heading));
        let own = Observation { heading, frame, ..Observation::new(Motion::default(), Vec2::zeros()) };
        let mut values = vec![0.0; bound.floats()];
        bound.write(&mut [], &Known { task: &task, team: &[], own: &own, sensed }, &mut values);
        values
    }

    fn scan(age_ms: u64) -> [Option<Sensation>; 2] {
        let values = Features([1.0, 2.0, f32::INFINITY, 4.0].into());
        [None, Some(Sensation { values, age: Span::from_millis(age_ms) })]
    }

    fn bound(frame: Frame, taking: Taking) -> Bound {
        Bound::new(&[request(frame, taking)], &[channel(true)]).expect("it fits")
    }

    #[test]
    fn rays_are_those_of_the_frame_that_the_policy_takes() {
        let ahead = (Some(0.0), PolicyFrame::World);
        assert_eq!(write(&bound(Frame::Body, FRESH), &scan(0), ahead), [1.0, 2.0, 5.0, 4.0]);
        let left = (Some(FRAC_PI_2), PolicyFrame::World);
        assert_eq!(write(&bound(Frame::World, FRESH), &scan(0), left), [4.0, 1.0, 2.0, 5.0], "from -x of the world");
        let from_ahead = Taking { from_rad: Some(0.0), ..FRESH };
        assert_eq!(write(&bound(Frame::World, from_ahead), &scan(0), left), [2.0, 5.0, 4.0, 1.0]);
        let turned = (Some(0.0), PolicyFrame::HalfTurn);
        assert_eq!(write(&bound(Frame::Policy, FRESH), &scan(0), turned), [5.0, 4.0, 1.0, 2.0]);
        assert_eq!(write(&bound(Frame::World, FRESH), &scan(0), turned), [1.0, 2.0, 5.0, 4.0]);
        let unknown = (None, PolicyFrame::World);
        assert!(write(&bound(Frame::World, FRESH), &scan(0), unknown).iter().all(|value| value.is_nan()));
        assert_eq!(write(&bound(Frame::Body, FRESH), &scan(0), unknown)[0], 1.0);
    }

    #[test]
    fn no_echo_and_what_is_beyond_the_policys_range_are_its_miss() {
        let ahead = (Some(0.0), PolicyFrame::World);
        let near = Taking { range_m: Some(1.5), ..FRESH };
        assert_eq!(write(&bound(Frame::Body, near), &scan(0), ahead), [1.0, 1.5, 1.5, 1.5]);
        let miss = |miss| Taking { miss: Some(miss), ..near };
        let zero = miss(Miss::Named(NamedMiss::Zero));
        assert_eq!(write(&bound(Frame::Body, zero), &scan(0), ahead), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(write(&bound(Frame::Body, miss(Miss::Number(-1.0))), &scan(0), ahead), [1.0, -1.0, -1.0, -1.0]);
    }

    #[test]
    fn stale_values_stop_the_robot_or_are_used_or_are_no_echo() {
        let ahead = (Some(0.0), PolicyFrame::World);
        let with = |if_stale| bound(Frame::Body, Taking { if_stale: Some(if_stale), ..FRESH });
        for (none, sensed) in [(false, scan(101)), (true, [None, None])] {
            assert!(write(&with(IfStale::Stop), &sensed, ahead).iter().all(|value| value.is_nan()));
            assert_eq!(write(&with(IfStale::Miss), &sensed, ahead), [5.0; 4]);
            assert_eq!(write(&with(IfStale::Last), &sensed, ahead)[0].is_nan(), none);
        }
        assert_eq!(write(&with(IfStale::Miss), &scan(100), ahead)[0], 1.0, "fresh");
        let short = Some(Sensation { values: Features([1.0].into()), age: Span::ZERO });
        assert!(write(&with(IfStale::Last), &[None, short], ahead)[0].is_nan(), "another number of values");
    }

    #[test]
    fn what_policy_and_sense_do_not_agree_about_is_refused() {
        let refused = |around, request: Request| {
            Bound::new(&[request], &[channel(around)]).expect_err("it does not fit").to_string()
        };
        let of = |frame, taking| refused(true, request(frame, taking));
        assert!(of(Frame::Body, Taking::default()).contains("stale_after_s is missing"));
        let far = of(Frame::Body, Taking { range_m: Some(6.0), ..FRESH });
        assert!(far.contains("as far as 6 m, and 'eyes' 5 m"), "{far}");
        assert!(of(Frame::Body, Taking { miss: Some(Miss::Number(f32::NAN)), ..FRESH }).contains("miss"));
        assert!(refused(false, request(Frame::World, FRESH)).contains("all around"));
        let turned = refused(false, request(Frame::Body, Taking { from_rad: Some(0.0), ..FRESH }));
        assert!(turned.contains("first ray is at 0 rad, and that of 'eyes' at -3.14"), "{turned}");
        assert!(refused(true, Request { frame: None, ..request(Frame::Body, FRESH) }).contains("frame"));
        let place = Request { channel: "position".to_owned(), shape: vec![2], ..request(Frame::World, FRESH) };
        assert!(refused(true, place).contains("'position' is none"));
    }
}
