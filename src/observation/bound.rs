//! Join of the channels that a policy takes with those that a team has.

use super::channel::{Channel, Known, Quantity, Unit, floats};
use super::frame::Frame;
use super::sense::Taking;
use super::taken::taken;
use super::{Observation, builtin};
use crate::messages::geometry::{Vec2, wrapped};

/// Largest number of values of all channels that a policy takes together.
pub const MAX_FLOATS: usize = 65_536;

/// Channel that a policy takes, as its file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// Name of the policy's input.
    pub input: String,
    /// Name of the channel.
    pub channel: String,
    /// Number of values along each axis of the array that the policy takes.
    pub shape: Vec<usize>,
    /// Unit in which the policy takes the values.
    pub unit: Unit,
    /// Frame in which the policy takes the values; `None` if the policy does not say, which only values that are the
    /// same in every frame permit.
    pub frame: Option<Frame>,
    /// How the policy takes the values of a sense; the default for a channel that is none.
    pub taking: Taking,
}

impl Channel {
    /// Returns the request of a policy that takes this channel as it is, in the policy frame.
    pub fn request(&self) -> Request {
        Request {
            input: self.name.to_string(),
            channel: self.name.to_string(),
            shape: self.shape.clone(),
            unit: self.unit,
            frame: Some(Frame::Policy),
            taking: Taking::default(),
        }
    }
}

impl Request {
    /// Returns the number of values.
    pub fn floats(&self) -> usize {
        floats(&self.shape)
    }
}

/// Error: a policy takes a channel that the team has not, or has otherwise.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("its observation '{input}': {reason}")]
pub struct ChannelError {
    /// Name of the policy's input.
    pub input: String,
    /// Channel that the policy takes, and what there is in its place.
    pub reason: String,
}

/// Channels that a policy takes, joined with those that compute their values.
#[derive(Clone, Debug, Default)]
pub struct Bound {
    parts: Vec<(Channel, Frame)>,
    floats: usize,
    memory: usize,
}

impl Bound {
    /// Joins the channels that a policy takes with those of the team: the built-in ones, and `others` of its scenario
    /// and senses. An error names the first channel that does not exist, or that has another shape or unit.
    pub fn new(requests: &[Request], others: &[Channel]) -> Result<Bound, ChannelError> {
        let all: Vec<Channel> = builtin::channels().into_iter().chain(others.iter().cloned()).collect();
        let mut bound = Bound::default();
        for request in requests {
            let refuse = |reason: String| ChannelError { input: request.input.clone(), reason };
            let Some(channel) = all.iter().find(|channel| channel.name == request.channel) else {
                let known: Vec<&str> = all.iter().map(|channel| &*channel.name).collect();
                let (wanted, known) = (&request.channel, known.join(", "));
                let sense = match request.taking == Taking::default() {
                    true => String::new(),
                    false => format!("; a sense is a table [senses.{wanted}] of the team file (docs/senses.md)"),
                };
                return Err(refuse(format!("there is no channel '{wanted}' here; there are: {known}{sense}")));
            };
            let (theirs, ours) = (&request.shape, &channel.shape);
            if !channel.has(theirs) {
                let name = &channel.name;
                let choice = channel.most.map_or(String::new(), |most| format!(" with 1 to {most} as its first axis"));
                return Err(refuse(format!(
                    "the policy takes an array {theirs:?}, and the channel '{name}' is {ours:?}{choice}"
                )));
            }
            if request.unit != channel.unit {
                let (theirs, ours) = (request.unit, channel.unit);
                return Err(refuse(format!(
                    "the policy takes it in {theirs}, and the channel '{}' is in {ours}",
                    channel.name
                )));
            }
            let frame = match (request.frame, channel.quantity) {
                (Some(frame), _) => frame,
                (None, Quantity::Number) => Frame::Policy,
                (None, _) => {
                    let why = "its frame is missing: world, policy or body";
                    return Err(refuse(why.to_owned()));
                }
            };
            bound.floats += request.floats();
            if bound.floats > MAX_FLOATS {
                return Err(refuse(format!("with it the policy takes more than {MAX_FLOATS} values")));
            }
            bound.memory += channel.memory;
            let channel = &Channel { shape: theirs.clone(), ..channel.clone() };
            bound.parts.push((taken(channel, request.frame, &request.taking).map_err(refuse)?, frame));
        }
        Ok(bound)
    }

    /// Returns the number of values of all channels together.
    pub fn floats(&self) -> usize {
        self.floats
    }

    /// Returns the number of floats that all channels together remember of a robot's episode.
    pub fn memory(&self) -> usize {
        self.memory
    }

    /// Writes the values of all channels, one channel after the other, into `values`, which has the length
    /// `Bound::floats`. A value that is not known is NaN, as are all directions in the robot's own frame if its heading
    /// is not known. `memory` is what the channels remember of the robot, of the length `Bound::memory`: zeros when an
    /// episode begins.
    pub fn write(&self, memory: &mut [f32], known: &Known, values: &mut [f32]) {
        let (mut remembered, mut rest) = (memory, values);
        for (channel, frame) in &self.parts {
            let (own, later) = rest.split_at_mut(floats(&channel.shape));
            let (memory, of_others) = remembered.split_at_mut(channel.memory);
            (channel.write)(memory, known, own);
            transform(channel.quantity, *frame, known.own, own);
            (remembered, rest) = (of_others, later);
        }
    }
}

/// Transforms values from the policy frame into `frame`.
fn transform(quantity: Quantity, frame: Frame, own: &Observation, values: &mut [f32]) {
    if quantity == Quantity::Number || frame == Frame::Policy {
        return;
    }
    if quantity == Quantity::Angle {
        for angle in values {
            *angle = match (frame, own.heading) {
                (Frame::Body, heading) => wrapped(f64::from(*angle - heading.unwrap_or(f32::NAN))) as f32,
                _ => own.frame.turn_angle(*angle),
            };
        }
        return;
    }
    let from_robot = frame == Frame::Body && quantity == Quantity::Point;
    let origin = if from_robot { own.motion.position } else { Vec2::zeros() };
    for values in values.chunks_exact_mut(2) {
        let turned = own.into_frame(frame, Vec2::new(values[0], values[1]) - origin);
        values.copy_from_slice(turned.as_slice());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::{Motion, Task};
    use crate::observation::{Dynamics, PolicyFrame};
    use crate::time::Span;

    fn request(channel: &str, shape: &[usize], unit: Unit, frame: Option<Frame>) -> Request {
        let (input, channel, taking) = ("x".to_owned(), channel.to_owned(), Taking::default());
        Request { input, channel, shape: shape.to_vec(), unit, frame, taking }
    }

    fn own(heading: Option<f32>) -> Observation<'static> {
        let motion = Motion { position: Vec2::new(1.0, 2.0), velocity: Vec2::new(0.5, 0.0) };
        let dynamics = Dynamics { filtered: true, lag_s: 0.25, point_ahead_m: 0.0 };
        Observation {
            dynamics,
            heading,
            elapsed: Span::from_millis(1500),
            ..Observation::new(motion, Vec2::new(1.0, 4.0))
        }
    }

    fn values(bound: &Bound, own: &Observation, frame: PolicyFrame) -> Vec<f32> {
        let task = Task { start: Vec2::zeros(), goal: frame.turn(own.goal) };
        let mut values = vec![0.0; bound.floats()];
        let own = &Observation { frame, ..*own };
        bound.write(&mut [], &Known { task: &task, team: &[], own, sensed: &[] }, &mut values);
        values
    }

    #[test]
    fn values_are_in_the_frame_that_the_policy_takes() {
        let goal = |frame| request("goal-minus-position", &[2], Unit::Metre, Some(frame));
        let all = [goal(Frame::Policy), goal(Frame::World), goal(Frame::Body)];
        let bound = Bound::new(&all, &[]).expect("there is such a channel");
        // The goal is two metres along y, and the robot looks along y: it is straight ahead.
        let found = values(&bound, &own(Some(std::f32::consts::FRAC_PI_2)), PolicyFrame::HalfTurn);
        let expected = [0.0, 2.0, 0.0, -2.0, 2.0, 0.0];
        assert!(found.iter().zip(expected).all(|(one, other)| (one - other).abs() < 1e-6), "{found:?}");
        let unknown = values(&bound, &own(None), PolicyFrame::HalfTurn);
        assert_eq!(unknown[..4], [0.0, 2.0, -0.0, -2.0], "no heading is needed for it");
        assert!(unknown[4..].iter().all(|value| value.is_nan()), "{unknown:?}");
    }

    #[test]
    fn points_and_angles_are_relative_to_the_robot_in_its_own_frame() {
        let all = [
            request("goal", &[2], Unit::Metre, Some(Frame::Body)),
            request("heading", &[1], Unit::Radian, Some(Frame::Body)),
            request("heading", &[1], Unit::Radian, Some(Frame::World)),
            request("filter", &[1], Unit::One, None),
            request("lag", &[1], Unit::Second, None),
            request("time-in-episode", &[1], Unit::Second, None),
        ];
        let bound = Bound::new(&all, &[]).expect("there are such channels");
        let found = values(&bound, &own(Some(0.0)), PolicyFrame::HalfTurn);
        assert_eq!(found[..3], [0.0, 2.0, 0.0]);
        assert!((found[3].abs() - std::f32::consts::PI).abs() < 1e-6, "{found:?}");
        assert_eq!(found[4..], [1.0, 0.25, 1.5]);
    }

    #[test]
    fn what_does_not_fit_is_refused_with_both_sides() {
        let refused = |request: Request| Bound::new(&[request], &[]).expect_err("it does not fit").to_string();
        let unknown = refused(request("lidar", &[32], Unit::Metre, None));
        assert!(unknown.starts_with("its observation 'x': there is no channel 'lidar' here; there are: position, "));
        assert_eq!(
            refused(request("velocity", &[3], Unit::MetrePerSecond, Some(Frame::World))),
            "its observation 'x': the policy takes an array [3], and the channel 'velocity' is [2]"
        );
        assert_eq!(
            refused(request("velocity", &[2], Unit::Metre, Some(Frame::World))),
            "its observation 'x': the policy takes it in m, and the channel 'velocity' is in m/s"
        );
        assert!(refused(request("velocity", &[2], Unit::MetrePerSecond, None)).contains("its frame is missing"));
    }

    #[test]
    fn a_channel_of_a_scenario_is_taken_by_its_name() {
        let shape = (vec![3], Unit::One, Quantity::Number);
        let own_channel = Channel::new("level", "a number", shape, |known, out| out.fill(known.own.motion.position.x));
        let all = [request("level", &[3], Unit::One, None)];
        let bound = Bound::new(&all, &[own_channel]).expect("the scenario has it");
        assert_eq!(values(&bound, &own(None), PolicyFrame::World), [1.0; 3]);
    }

    #[test]
    fn a_channel_remembers_what_it_was_given_for_a_robot() {
        let count = |memory: &mut [f32], known: &Known, out: &mut [f32]| {
            memory[1] += known.own.goal.x;
            out.copy_from_slice(memory);
        };
        let form = || (vec![2], Unit::One, Quantity::Number);
        let counting = Channel::remembering("sum", "a sum", form(), 2, count);
        let all = [request("position", &[2], Unit::Metre, Some(Frame::World)), request("sum", &[2], Unit::One, None)];
        let bound = Bound::new(&all, &[counting]).expect("there is such a channel");
        assert_eq!(bound.memory(), 2);
        let task = Task { start: Vec2::zeros(), goal: Vec2::zeros() };
        let (mut memory, mut values) = ([0.0; 2], [0.0; 4]);
        for times in 1..4 {
            bound.write(&mut memory, &Known { task: &task, team: &[], own: &own(None), sensed: &[] }, &mut values);
            assert_eq!(values, [1.0, 2.0, 0.0, times as f32]);
        }
    }
}
