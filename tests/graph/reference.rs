//! Comparison with the published release: its network, its environment and its results. The data is not part of this
//! repository; without it, these tests print a notice and skip.

use std::path::Path;
use std::sync::Arc;

use crate::common::{bytes, floats, integers, reference};
use murmurate::deploy::Deployment;
use murmurate::messages::geometry::{Motion, Planar, Task, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::Contacts;
use murmurate::observation::Observation;
use murmurate::policy::gnn::{Gnn, GnnWeights};
use murmurate::policy::{Draw, Model, Neighbour, Policy, file};
use murmurate::results::episode::Episode;
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{self, Progress, Scenario, Settings};
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate::world::{Physics, kinematic};
use murmurate_report::outcomes::Outcomes;
use safetensors::SafeTensors;

fn passage() -> Arc<dyn Scenario> {
    scenario::build("passage", &Settings::of(5)).expect("five robots is the published team")
}

fn published(path: &Path) -> Arc<GnnWeights> {
    let file = file::read(&std::fs::read(path).expect("the file is there")).expect("the published file loads");
    assert!(file.assumed.is_some(), "a file without a manifest says what was assumed");
    Arc::new(GnnWeights::new(file))
}

fn vec2(floats: &[f32], at: usize) -> Vec2 {
    Vec2::new(floats[2 * at], floats[2 * at + 1])
}

#[test]
fn the_forward_pass_matches_every_vector() {
    let (Some(policy), Some(vectors)) = (reference("policy.safetensors"), reference("policy_vectors.safetensors"))
    else {
        return;
    };
    let network = published(&policy);
    let file = std::fs::read(vectors).expect("the file is there");
    let tensors = SafeTensors::deserialize(&file).expect("the vectors are safetensors");
    let [pos, vel, goal, hidden, out] = ["pos", "vel", "goal", "hidden", "out"].map(|name| floats(&tensors, name));
    let (agents, adjacency) = (integers(&tensors, "n_agents"), bytes(&tensors, "adjacency"));
    const PAD: usize = 8;

    let mut gnn = Gnn::new(network, Draw::Mean, RobotId(0));
    let (mut worst_hidden, mut worst_out, mut rows) = (0.0f32, 0.0f32, 0);
    for (case, &count) in agents.iter().enumerate() {
        let count = usize::try_from(count).expect("a count");
        let motion = |i: usize| Motion { position: vec2(&pos, case * PAD + i), velocity: vec2(&vel, case * PAD + i) };
        let mut features = vec![vec![0.0; gnn.interface().features]; count];
        for (i, features) in features.iter_mut().enumerate() {
            gnn.encode(&Observation::new(motion(i), vec2(&goal, case * PAD + i)), features);
            for (k, value) in features.iter().enumerate() {
                worst_hidden = worst_hidden.max((value - hidden[(case * PAD + i) * features.len() + k]).abs());
            }
        }
        for i in 0..count {
            let linked = |j: &usize| *j != i && adjacency[(case * PAD + i) * PAD + j] == 1;
            let neighbours: Vec<Neighbour> = (0..count)
                .filter(linked)
                .map(|j| Neighbour { motion: motion(j), features: &features[j], age: Span::ZERO })
                .collect();
            let own = Observation::new(motion(i), vec2(&goal, case * PAD + i));
            for (k, value) in gnn.outputs(&own, &features[i], &neighbours).iter().enumerate() {
                worst_out = worst_out.max((value - out[(case * PAD + i) * 4 + k]).abs());
            }
            rows += 1;
        }
    }
    println!(
        "forward pass: {rows} rows of {} cases, worst output {worst_out:.2e}, worst latent {worst_hidden:.2e}",
        agents.len()
    );
    assert!(rows > 0, "the file holds cases");
    assert!(worst_out <= 1e-4, "outputs differ by {worst_out:e}");
    assert!(worst_hidden <= 5e-6, "latents differ by {worst_hidden:e}");
}

/// Panics unless a position is the expected one to the last bit but one, and a velocity is near the expected one.
fn agree(place: &str, (position, p): (Vec2, Vec2), (velocity, v): (Vec2, Vec2)) {
    for axis in 0..2 {
        let ulp = (p.to_array()[axis].abs() * f32::EPSILON).max(f32::MIN_POSITIVE);
        assert!((position - p).to_array()[axis].abs() <= ulp, "{place}: position {position:?} not {p:?}");
        assert!((velocity - v).to_array()[axis].abs() <= 2e-5, "{place}: velocity {velocity:?} not {v:?}");
    }
}

#[test]
fn every_step_of_the_environment_matches() {
    let Some(vectors) = reference("env_vectors.safetensors") else { return };
    let file = std::fs::read(vectors).expect("the file is there");
    let tensors = SafeTensors::deserialize(&file).expect("the vectors are safetensors");
    let [pos, vel, action, reward] = ["pos", "vel", "action", "reward"].map(|name| floats(&tensors, name));
    let goal = floats(&tensors, "goal");
    // The data is in the policy frame, also where a rollout has placed robots on the far side.
    let start = Vec2::new(0.0, -1.5);
    let [stage, done, near] = ["stage", "done", "near"].map(|name| bytes(&tensors, name));
    let [hit_agent, hit_wall] = ["hit_agent", "hit_wall"].map(|name| bytes(&tensors, name));
    let t0 = integers(&tensors, "t0");
    const ROBOTS: usize = 5;
    // The published environment pays for no stage after this one.
    const LAST_STAGE: Progress = Progress(4);
    let steps = near.len() / t0.len();
    let scenario = passage();
    // The rules' limit in steps.
    let limit = i32::try_from(scenario.rules().limit.as_nanos() / kinematic::PERIOD.as_nanos()).expect("a few hundred");

    let (mut checked, mut skipped, mut inexact) = (0, 0, 0);
    for rollout in 0..t0.len() {
        for step in 0..steps {
            if near[rollout * steps + step] == 1 {
                skipped += 1;
                continue;
            }
            let state = |k: usize| (rollout * (steps + 1) + k) * ROBOTS;
            let (before, after, now) = (state(step), state(step + 1), (rollout * steps + step) * ROBOTS);
            let mut position: Vec<Vec2> = (0..ROBOTS).map(|i| vec2(&pos, before + i)).collect();
            let mut velocity: Vec<Vec2> = (0..ROBOTS).map(|i| vec2(&vel, before + i)).collect();
            let commands: Vec<Vec2> = (0..ROBOTS).map(|i| vec2(&action, now + i)).collect();
            let mut contacts = vec![Contacts::default(); ROBOTS];
            let mut space = vec![Vec2::zeros(); ROBOTS];
            let mut team = kinematic::TeamMotion {
                position: &mut position,
                velocity: &mut velocity,
                wheels: &mut [],
                contacts: &mut contacts,
                before: &mut space,
            };
            kinematic::step(scenario.arena(), &Physics::published(scenario.arena()), &commands, &mut team);

            let mut finished = true;
            for i in 0..ROBOTS {
                let place = format!("rollout {rollout}, step {step}, robot {i}");
                let (p, v) = (vec2(&pos, after + i), vec2(&vel, after + i));
                inexact += usize::from(position[i] != p);
                agree(&place, (position[i], p), (velocity[i], v));
                let task = Task { start, goal: vec2(&goal, rollout * ROBOTS + i) };
                let mut reached = Progress(stage[before + i]);
                let motion = Motion { position: position[i], velocity: velocity[i] };
                let earned = scenario.reward(&task, &motion, contacts[i], &mut reached).expect("the passage has one");
                let expected = Contacts { robot: hit_agent[now + i] == 1, wall: hit_wall[now + i] == 1 };
                assert_eq!(contacts[i], expected, "{place}");
                assert_eq!(reached.0, stage[after + i], "{place}: stage");
                assert!((earned - reward[now + i]).abs() <= 1e-5, "{place}: reward {earned} not {}", reward[now + i]);
                finished &= reached >= LAST_STAGE;
            }
            let late = t0[rollout] + i32::try_from(step).expect("few steps") + 1 >= limit;
            assert_eq!(finished || late, done[rollout * steps + step] == 1, "rollout {rollout}, step {step}: done");
            checked += 1;
        }
    }
    println!(
        "environment: {checked} steps match, {skipped} near a threshold skipped, {inexact} positions off by one ulp"
    );
    assert!(checked > 0, "the file holds steps");
}

/// Runs `trials` on two threads; results are in their order.
fn run_all(trials: Vec<Trial>) -> Vec<Episode> {
    let half = trials.len().div_ceil(2);
    std::thread::scope(|scope| {
        let run = |trials: &[Trial]| trials.iter().flat_map(|trial| trial.run().episodes).collect::<Vec<Episode>>();
        let threads: Vec<_> = trials.chunks(half).map(|trials| scope.spawn(move || run(trials))).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("a trial does not panic")).collect()
    })
}

/// One row of the published closed-loop table: name, share of successes, number of episodes, makespan \[s\].
struct Row(&'static str, f64, usize, f64);

fn compare(row: &Row, episodes: &[Episode]) {
    let Row(name, rate, tried, makespan) = *row;
    let found = Outcomes::of(episodes);
    let (n, ours) = (episodes.len() as f64, found.success_rate);
    let pooled = (ours * n + rate * tried as f64) / (n + tried as f64);
    // Without failures the deviation would be zero; one failure is the smallest difference.
    let error = (pooled * (1.0 - pooled) * (1.0 / n + 1.0 / tried as f64)).sqrt().max(1.0 / n);
    let median = found.makespan_median_s.expect("some episodes succeed");
    println!(
        "{name}: success {:.1} % (published {:.1} %, {:.1} standard errors), makespan {median:.2} s \
         (published {makespan:.2} s), {} walls, {} robots, {} late",
        100.0 * ours,
        100.0 * rate,
        (ours - rate).abs() / error,
        found.wall_collisions,
        found.robot_collisions,
        found.timeouts
    );
    assert!((ours - rate).abs() <= 2.6 * error, "{name}: success {ours}, published {rate}");
    assert!((median - makespan).abs() <= 0.2, "{name}: makespan {median} s, published {makespan} s");
}

fn closed_loop(draw: Draw, random: &Row, fixed: &Row) {
    let (Some(policy), Some(file)) = (reference("policy.safetensors"), reference("episodes.json")) else { return };
    let scenario = passage();
    let deployment = Deployment::preset("sim", 5).expect("a preset");
    let trial = Trial::new(deployment, Arc::clone(&scenario), Model::Gnn(published(&policy), draw));

    let trials = (0..4).map(|seed| trial.clone().seed(seed).episodes(500)).collect();
    compare(random, &run_all(trials));

    let text = std::fs::read_to_string(file).expect("the file is there");
    let layouts = Layouts::from_json(&text, &*scenario, 16).expect("the published episodes load");
    let trials = (0..12).map(|repeat| Trial { repeat, layouts: layouts.clone(), ..trial.clone() }).collect();
    compare(fixed, &run_all(trials));
}

#[test]
fn sampled_actions_reach_the_published_results() {
    let random = Row("2000 random layouts, sampled", 0.974, 2000, 7.00);
    closed_loop(Draw::Sample, &random, &Row("16 published layouts x 12, sampled", 1.0, 192, 5.95));
}

#[test]
fn mean_actions_reach_the_published_results() {
    let random = Row("2000 random layouts, mean", 0.963, 2000, 6.85);
    closed_loop(Draw::Mean, &random, &Row("16 published layouts x 12, mean", 1.0, 192, 5.70));
}
