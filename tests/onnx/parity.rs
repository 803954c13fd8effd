//! A policy against the same computation in numpy: `data/make.py` has made both.

use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::observation::{Bound, Known, Observation};
use murmurate::policy::{Broadcast, Draw, Neighbour, Policy};
use murmurate::random::Seed;
use murmurate::time::Span;
use murmurate_onnx::Network;
use murmurate_onnx::check;
use serde::Deserialize;

/// One step of a robot, and what it answers.
#[derive(Deserialize)]
struct Step {
    /// Position \[m\] and velocity \[m/s\].
    own: [f32; 4],
    goal: [f32; 2],
    others: Vec<Other>,
    /// Whether the state is at its start.
    reset: bool,
    action: [f32; 2],
    message: Vec<f32>,
}

#[derive(Deserialize)]
struct Other {
    motion: [f32; 4],
    age: f64,
    message: Vec<f32>,
}

fn motion([x, y, vx, vy]: [f32; 4]) -> Motion {
    Motion { position: Vec2::new(x, y), velocity: Vec2::new(vx, vy) }
}

fn network(name: &str) -> Arc<Network> {
    let parts = super::parts(&super::contract(name)).expect("its files fit");
    Arc::new(Network::load(parts).expect("it loads"))
}

/// Returns the message that the last step has computed.
fn computed(robot: &impl Policy) -> Vec<f32> {
    match robot.broadcast() {
        Broadcast::Computed(message) => message.to_vec(),
        other => panic!("its step makes a message, not {other:?}"),
    }
}

/// Returns the values of the channels that the policy takes, of a robot with this observation.
fn values(network: &Network, own: &Observation) -> Vec<f32> {
    let bound = Bound::new(&network.contract().requests(), &[]).expect("every team has these channels");
    let mut values = vec![0.0; bound.floats()];
    let task = murmurate::messages::geometry::Task { start: Vec2::zeros(), goal: own.goal };
    bound.write(&mut [], &Known { task: &task, team: &[], own, sensed: &[] }, &mut values);
    values
}

#[test]
fn a_recurrent_policy_with_attention_answers_as_numpy_does() {
    let network = network("recurrent");
    check::check(&network).expect("it is sound");
    let steps: Vec<Step> = serde_json::from_slice(&super::bytes("recurrent.json")).expect("steps");
    let mut robot = network.robot(RobotId(0), Draw::Mean);
    let (mut worst, mut said) = (0.0_f32, vec![0.0; 6]);
    for step in &steps {
        if step.reset {
            robot.reset(0);
            said.fill(0.0);
        }
        let own = Observation::new(motion(step.own), Vec2::from(step.goal));
        let values = values(&network, &own);
        let own = Observation { values: &values, ..own };
        let neighbours: Vec<Neighbour> = step
            .others
            .iter()
            .map(|other| Neighbour {
                motion: motion(other.motion),
                features: &other.message,
                age: Span::from_secs(other.age),
            })
            .collect();
        let mut features = vec![f32::NAN; 6];
        robot.encode(&own, &mut features);
        assert_eq!(features, said, "other robots of the Agent are given the message of the step before");
        let velocity = robot.act(&own, &features, &neighbours, &mut Seed::of_run(0).stream("draw"));
        said = computed(&robot);
        let found = velocity.iter().chain(&said);
        let expected = step.action.iter().chain(&step.message);
        worst = found.zip(expected).map(|(one, other)| (one - other).abs()).fold(worst, f32::max);
    }
    assert!(worst <= 1e-5, "{worst:e}");
}

#[test]
fn a_step_with_a_number_that_is_not_finite_counts_as_none() {
    let network = network("recurrent");
    let mut robot = network.robot(RobotId(0), Draw::Mean);
    let mut stream = Seed::of_run(0).stream("draw");
    let own = Observation::new(motion([0.0, 0.0, 0.1, 0.0]), Vec2::new(1.0, 0.0));
    let good = values(&network, &own);
    let step = |robot: &mut dyn Policy, values: &[f32], neighbours: &[Neighbour], stream: &mut _| {
        let own = Observation { values, ..own };
        robot.encode(&own, &mut [0.0; 6]);
        robot.act(&own, &[], neighbours, stream)
    };
    step(&mut robot, &good, &[], &mut stream);
    for at in 0..good.len() {
        for wrong in [f32::NAN, f32::INFINITY] {
            let mut bad = good.clone();
            bad[at] = wrong;
            step(&mut robot, &bad, &[], &mut stream);
            assert_eq!(robot.broadcast(), Broadcast::Failed, "value {at} is {wrong}");
        }
    }
    let message = [0.1, 0.2, f32::NAN, 0.0, 0.0, 0.0];
    let neighbour = Neighbour { motion: Motion::default(), features: &message, age: Span::ZERO };
    step(&mut robot, &good, &[neighbour], &mut stream);
    assert_eq!(robot.broadcast(), Broadcast::Failed);
    let away = Motion { position: Vec2::new(f32::NAN, 0.0), velocity: Vec2::zeros() };
    let neighbour = Neighbour { motion: away, features: &[0.0; 6], age: Span::ZERO };
    step(&mut robot, &good, &[neighbour], &mut stream);
    assert_eq!(robot.broadcast(), Broadcast::Failed);
    let mut other = self::network("recurrent").robot(RobotId(0), Draw::Mean);
    let mut fresh = Seed::of_run(0).stream("draw");
    step(&mut other, &good, &[], &mut fresh);
    let both = [&mut robot as &mut dyn Policy, &mut other].map(|robot| step(robot, &good, &[], &mut fresh));
    assert_eq!(both[0], both[1], "the state is that of the last step that succeeded");
    assert_eq!(computed(&robot), computed(&other));
}

#[test]
fn a_policy_without_a_message_is_heard_by_its_motion_from_the_first_step() {
    let network = network("silent");
    check::check(&network).expect("it is sound");
    let mut robot = network.robot(RobotId(0), Draw::Mean);
    let own = Observation::new(Motion::default(), Vec2::zeros());
    let values = values(&network, &own);
    let own = Observation { values: &values, ..own };
    robot.encode(&own, &mut []);
    assert_eq!(robot.broadcast(), Broadcast::Encoded, "robots of the same Agent hear it");
    let at = Motion::at_rest(Vec2::new(-0.5, 0.25));
    let neighbour = Neighbour { motion: at, features: &[], age: Span::ZERO };
    let velocity = robot.act(&own, &[], &[neighbour], &mut Seed::of_run(0).stream("draw"));
    assert!((velocity - Vec2::new(0.05, -0.025)).norm() < 1e-6, "{velocity}");
}

#[test]
fn a_robot_whose_step_has_failed_says_nothing_until_one_succeeds() {
    let network = network("recurrent");
    let (mut robot, mut stream) = (network.robot(RobotId(0), Draw::Mean), Seed::of_run(0).stream("draw"));
    let own = Observation::new(motion([0.0, 0.0, 0.1, 0.0]), Vec2::new(1.0, 0.0));
    let good = values(&network, &own);
    let bad = vec![f32::NAN; good.len()];
    let mut says = |values: &[f32]| {
        let own = Observation { values, ..own };
        robot.encode(&own, &mut [0.0; 6]);
        let says = robot.broadcast() == Broadcast::Encoded;
        robot.act(&own, &[], &[], &mut stream);
        (says, robot.broadcast() == Broadcast::Failed)
    };
    assert_eq!(says(&good), (false, false), "there is no message before the first step");
    assert_eq!(says(&good), (true, false));
    assert_eq!(says(&bad), (true, true), "what it says is of the step before");
    assert_eq!(says(&bad), (false, true));
    assert_eq!(says(&good), (false, false));
    assert_eq!(says(&good), (true, false));
}

#[test]
fn equal_inputs_give_equal_bits() {
    let network = network("recurrent");
    let own = Observation::new(motion([0.3, -0.2, 0.1, 0.0]), Vec2::new(1.0, 0.5));
    let values = values(&network, &own);
    let own = Observation { values: &values, ..own };
    let message = [0.25; 6];
    let neighbours = [Neighbour { motion: Motion::default(), features: &message, age: Span::from_millis(20) }; 3];
    let run = || -> Vec<[u32; 2]> {
        let (mut robot, mut stream) = (network.robot(RobotId(0), Draw::Mean), Seed::of_run(0).stream("draw"));
        let velocities = (0..100).map(|at| robot.act(&own, &[], &neighbours[..at % 4], &mut stream));
        velocities.map(|velocity| [velocity.x.to_bits(), velocity.y.to_bits()]).collect()
    };
    let (here, there) = (run(), std::thread::scope(|scope| scope.spawn(run).join().expect("it ends")));
    assert_eq!(here, there, "on another thread, too");
}

#[test]
fn each_robot_has_its_place_in_the_team_as_an_input() {
    let of = [
        ("id-one-hot", [[0.5, 0.0], [0.0, 0.25], [-0.5, -0.25]]),
        ("id-number", [[0.0; 2], [0.125, 0.25], [0.25, 0.5]]),
    ];
    for (name, expected) in of {
        let network = network(name);
        check::check(&network).expect("it is sound");
        let own = Observation::new(Motion::default(), Vec2::zeros());
        let values = values(&network, &own);
        let own = Observation { values: &values, ..own };
        for (robot, expected) in RobotId::team(3).zip(expected) {
            let mut policy = network.robot(robot, Draw::Mean);
            policy.encode(&own, &mut []);
            let velocity = policy.act(&own, &[], &[], &mut Seed::of_run(0).stream("draw"));
            assert!((velocity - Vec2::from(expected)).norm() < 1e-6, "{name}, {robot}: {velocity}");
        }
    }
    let network = network("id-one-hot");
    let mut fourth = network.robot(RobotId(3), Draw::Mean);
    let own = Observation { values: &[0.0; 2], ..Observation::new(Motion::default(), Vec2::zeros()) };
    fourth.act(&own, &[], &[], &mut Seed::of_run(0).stream("draw"));
    assert_eq!(fourth.broadcast(), Broadcast::Failed, "the graph tells three robots apart");
    assert_eq!(network.model().most_robots(), Some(3));
    assert_eq!(self::network("id-number").model().most_robots(), None);
}

#[test]
fn graphs_of_further_hops_get_what_the_neighbours_made_in_the_hop_before() {
    let network = network("hops");
    check::check(&network).expect("it is sound");
    // A row, in which each hears those beside it.
    let goals = [1.0, 2.5, 4.0];
    let near = [vec![1], vec![0, 2], vec![1]];
    let mut robots: Vec<_> = RobotId::team(3).map(|robot| network.robot(robot, Draw::Mean)).collect();
    let seen = goals.map(|x| {
        let own = Observation::new(Motion::default(), Vec2::new(x, 0.0));
        let values = values(&network, &own);
        (own, values)
    });
    let own = |at: usize| Observation { values: &seen[at].1, ..seen[at].0 };
    let mut messages = [[0.0; 3]; 3];
    for (at, robot) in robots.iter_mut().enumerate() {
        assert_eq!(robot.hops(), 3);
        robot.encode(&own(at), &mut messages[at]);
    }
    let heard = |messages: &[[f32; 3]; 3], at: usize| -> Vec<[f32; 3]> {
        near[at].iter().map(|other: &usize| messages[*other]).collect()
    };
    fn neighbours(messages: &[[f32; 3]]) -> Vec<Neighbour<'_>> {
        let one = |features| Neighbour { motion: Motion::default(), features, age: Span::ZERO };
        messages.iter().map(|message| one(&message[..])).collect()
    }
    for hop in [1, 2] {
        let before = messages;
        for (at, robot) in robots.iter_mut().enumerate() {
            robot.relay(hop, &own(at), &mut messages[at], &neighbours(&heard(&before, at)));
        }
    }
    assert_eq!(messages, [[1.0, 3.5, 11.0], [2.5, 7.5, 17.5], [4.0, 6.5, 14.0]]);
    for (at, expected) in [0.175, 0.25, 0.175].into_iter().enumerate() {
        let mut stream = Seed::of_run(0).stream("draw");
        let velocity = robots[at].act(&own(at), &messages[at], &neighbours(&heard(&messages, at)), &mut stream);
        assert!((velocity - Vec2::new(expected, 0.0)).norm() < 1e-6, "{velocity}");
        assert_eq!(robots[at].broadcast(), Broadcast::Encoded);
    }
    // A hop that fails makes a step that counts as none.
    robots[0].encode(&own(0), &mut messages[0]);
    robots[0].relay(1, &own(0), &mut messages[0].clone(), &neighbours(&[[f32::NAN; 3]]));
    let velocity = robots[0].act(&own(0), &messages[0], &[], &mut Seed::of_run(0).stream("draw"));
    assert_eq!((velocity, robots[0].broadcast()), (Vec2::zeros(), Broadcast::Failed));
}
