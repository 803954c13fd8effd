//! Steps of a team that the program's own evaluator computes, for the comparison of an exported actor with them.

use murmurate::messages::geometry::{Motion, Planar, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::observation::{Dynamics, Observation, PolicyFrame};
use murmurate::policy::{Draw, Model, Neighbour, Policy};
use murmurate::random::{Seed, Stream};
use murmurate::scenario::Arena;
use murmurate::time::Span;
use rand::RngExt;
use serde::Serialize;

/// Number of steps, one after the other: a policy may have a memory.
const STEPS: usize = 3;
/// Fastest robot along each axis \[m/s\].
const FASTEST_M_S: f32 = 0.2;

/// One step of a team, as lists with an entry of each robot.
#[derive(Debug, Serialize)]
pub struct Step {
    /// Positions \[m\], world frame.
    position: Vec<[f32; 2]>,
    /// Velocities \[m/s\], world frame.
    velocity: Vec<[f32; 2]>,
    /// Goals \[m\], world frame.
    goal: Vec<[f32; 2]>,
    /// Whether the policy frame of a robot is the world frame turned by half a turn.
    half_turn: Vec<bool>,
    /// Floats that the robots send.
    message: Vec<Vec<f32>>,
    /// Wanted velocities \[m/s\], world frame.
    action: Vec<[f32; 2]>,
}

/// Returns steps of as many robots as `frames` has, with random states on the ground of `arena`, of which each robot
/// hears those within the policy's radius in the same step. `model` draws the mean.
pub fn steps(model: &Model, arena: &Arena, frames: &[PolicyFrame], dynamics: Dynamics, seed: u64) -> Vec<Step> {
    let mut stream = Seed::of_run(seed).stream("export/probe");
    let model = model.clone().with_draw(Draw::Mean).unwrap_or_else(|| model.clone());
    let mut team: Vec<Box<dyn Policy>> =
        RobotId::team(frames.len()).map(|robot| model.instance(arena, robot)).collect();
    let radius_m = model.interface().radius_m;
    let mut draw = |half: Vec2| {
        let mut axis = |half: f32| stream.random_range(-half..half);
        Vec2::new(axis(half.x), axis(half.y))
    };
    let mut steps = Vec::new();
    for _ in 0..STEPS {
        let motions: Vec<Motion> = frames
            .iter()
            .map(|_| Motion { position: draw(arena.half_extent), velocity: draw(Vec2::repeat(FASTEST_M_S)) })
            .collect();
        let goals: Vec<Vec2> = frames.iter().map(|_| draw(arena.half_extent)).collect();
        steps.push(step(&mut team, frames, (&motions, &goals), dynamics, radius_m));
    }
    steps
}

/// Computes a step of all robots, with their messages in between.
fn step(
    team: &mut [Box<dyn Policy>],
    frames: &[PolicyFrame],
    (motions, goals): (&[Motion], &[Vec2]),
    dynamics: Dynamics,
    radius_m: f32,
) -> Step {
    let own: Vec<Observation> = (0..team.len())
        .map(|at| Observation { dynamics, ..Observation::in_frame(frames[at], goals[at], &motions[at]) })
        .collect();
    let mut message: Vec<Vec<f32>> = team.iter().map(|policy| vec![0.0; policy.interface().features]).collect();
    for ((policy, own), message) in team.iter_mut().zip(&own).zip(&mut message) {
        policy.encode(own, message);
    }
    for hop in 1..team[0].hops() {
        let before = message.clone();
        for (at, policy) in team.iter_mut().enumerate() {
            let heard = heard(at, frames[at], motions, &before, radius_m);
            policy.relay(hop, &own[at], &mut message[at], &heard);
        }
    }
    let mut unused: Stream = Seed::of_run(0).stream("export/mean");
    let action = (0..team.len()).map(|at| {
        let heard = heard(at, frames[at], motions, &message, radius_m);
        frames[at].turn(team[at].act(&own[at], &message[at], &heard, &mut unused)).to_array()
    });
    let action = action.collect();
    Step {
        position: motions.iter().map(|motion| motion.position.to_array()).collect(),
        velocity: motions.iter().map(|motion| motion.velocity.to_array()).collect(),
        goal: goals.iter().map(Planar::to_array).collect(),
        half_turn: frames.iter().map(|frame| *frame == PolicyFrame::HalfTurn).collect(),
        message,
        action,
    }
}

/// Returns what a robot hears of the others within the radius \[m\], in its policy frame.
fn heard<'a>(
    robot: usize,
    frame: PolicyFrame,
    motions: &[Motion],
    messages: &'a [Vec<f32>],
    radius_m: f32,
) -> Vec<Neighbour<'a>> {
    let near =
        |other: &usize| *other != robot && (motions[*other].position - motions[robot].position).norm() <= radius_m;
    let neighbour = |other: usize| Neighbour {
        motion: frame.turn_motion(&motions[other]),
        features: &messages[other],
        age: Span::ZERO,
    };
    (0..motions.len()).filter(near).map(neighbour).collect()
}
