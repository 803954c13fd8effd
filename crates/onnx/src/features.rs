//! Features of edges: how a neighbour's motion enters a graph.

use murmurate::messages::geometry::Vec2;
use murmurate::observation::Observation;
use murmurate::policy::Neighbour;

use crate::contract::{Edges, Feature, Sign};

/// Writes the features of the edge from `neighbour` to the robot with the observation `own` into `out`, which has the
/// length of all features together.
pub(crate) fn write(edges: &Edges, own: &Observation, neighbour: &Neighbour, out: &mut [f32]) {
    let signed = |theirs: Vec2, own_value: Vec2| {
        let difference = match edges.sign {
            Sign::TheirsMinusOwn => theirs - own_value,
            Sign::OwnMinusTheirs => own_value - theirs,
        };
        own.into_frame(edges.frame, difference)
    };
    let position = || signed(neighbour.motion.position, own.motion.position);
    let mut rest = out;
    for feature in &edges.features {
        let (entry, later) = rest.split_at_mut(feature.floats());
        match feature {
            Feature::RelativePosition => entry.copy_from_slice(position().as_slice()),
            Feature::RelativeVelocity => {
                entry.copy_from_slice(signed(neighbour.motion.velocity, own.motion.velocity).as_slice());
            }
            Feature::Age => entry[0] = neighbour.age.as_secs() as f32,
            Feature::Distance => entry[0] = (neighbour.motion.position - own.motion.position).norm(),
            Feature::Bearing => entry[0] = libm::atan2f(position().y, position().x),
        }
        rest = later;
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use murmurate::messages::geometry::Motion;
    use murmurate::observation::{Frame, PolicyFrame};
    use murmurate::time::Span;

    use super::*;

    #[test]
    fn features_have_the_sign_and_the_frame_of_the_contract() {
        let motion = Motion { position: Vec2::new(1.0, 1.0), velocity: Vec2::new(0.5, 0.0) };
        let own = Observation {
            frame: PolicyFrame::HalfTurn,
            heading: Some(FRAC_PI_2),
            ..Observation::new(motion, Vec2::zeros())
        };
        let theirs = Motion { position: Vec2::new(1.0, 3.0), velocity: Vec2::zeros() };
        let neighbour = Neighbour { motion: theirs, features: &[], age: Span::from_millis(100) };
        let features = vec![
            Feature::RelativePosition,
            Feature::RelativeVelocity,
            Feature::Age,
            Feature::Distance,
            Feature::Bearing,
        ];
        let written = |sign, frame| {
            let mut out = [0.0; 7];
            write(&Edges { features: features.clone(), sign, frame }, &own, &neighbour, &mut out);
            out
        };
        let near = |found: [f32; 7], expected: [f32; 7]| {
            assert!(found.iter().zip(expected).all(|(one, other)| (one - other).abs() < 1e-6), "{found:?}");
        };
        near(written(Sign::TheirsMinusOwn, Frame::Policy), [0.0, 2.0, -0.5, 0.0, 0.1, 2.0, FRAC_PI_2]);
        near(written(Sign::OwnMinusTheirs, Frame::World), [0.0, 2.0, -0.5, 0.0, 0.1, 2.0, FRAC_PI_2]);
        near(written(Sign::TheirsMinusOwn, Frame::Body), [2.0, 0.0, 0.0, 0.5, 0.1, 2.0, 0.0]);
        let back = own.out_of_frame(Frame::Body, own.into_frame(Frame::Body, Vec2::new(0.3, -0.7)));
        assert!((back - Vec2::new(0.3, -0.7)).norm() < 1e-6);
    }
}
