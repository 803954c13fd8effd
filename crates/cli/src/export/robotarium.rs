//! The command `murmurate export robotarium`: a folder with a team for the Robotarium, in numpy and their simulator's
//! calls.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use murmurate::config::shown::counted;
use murmurate::messages::geometry::{Planar, Task, Vec2};
use murmurate::observation::{Dynamics, PolicyFrame};
use murmurate::policy::{Model, shipped};
use murmurate::registry::Registry;
use murmurate::scenario::{Arena, Scenario, Settings, Solid};
use murmurate_robot::destination::check_folder;
use murmurate_robot::output::{read_bytes, read_text, talk};
use murmurate_robot::policy::onnx;
use murmurate_robot::whole_file::WholeFile;
use murmurate_robot::{BadInput, Ended, bad};
use serde::Serialize;

use super::network::{self, Network, Tensor};
use super::probe::{self, Step};
use crate::size::{self, SizeFlags};

/// Half the ground on which the axles of robots may be, along x and y \[m\]: the validator's bounds.
const GROUND_M: [f32; 2] = [1.6, 1.0];
/// Distance from a robot's axle to the point that the policy commands \[m\].
const POINT_AHEAD_M: f32 = 0.05;
/// Room at the sides of the ground: an axle may be so much further out than its point, and a hair \[m\].
const MARGIN_M: f32 = POINT_AHEAD_M + 0.01;
/// Radius of the least hull: half of the distance at which the validator counts a collision \[m\].
const LEAST_HULL_M: f32 = 0.055;
/// Room that hulls have to walls, and half of that to each other \[m\]. It is less than that of real hosts, whose
/// messages are late.
const HULL_MARGIN_M: f32 = 0.01;
/// Largest team.
const MOST_ROBOTS: usize = 50;

/// Files of the folder that are the same for all teams.
const FILES: [(&str, &str); 6] = [
    ("README.md", include_str!("robotarium/README.md")),
    ("main.py", include_str!("robotarium/main.py")),
    ("actor.py", include_str!("robotarium/actor.py")),
    ("guard.py", include_str!("robotarium/guard.py")),
    ("way.py", include_str!("robotarium/way.py")),
    ("check.py", include_str!("robotarium/check.py")),
];

/// Flags of `export robotarium`.
#[derive(clap::Args)]
pub struct Args {
    /// Policy of the robots: a policy file of format 1 or 2, or the name of a trained policy of the program
    #[arg(long, value_name = "NAME|FILE")]
    policy: PathBuf,
    /// Task of the team: a name, or a task file (docs/tasks.md)
    #[arg(long, visible_alias = "task", value_name = "NAME|FILE.toml")]
    scenario: String,
    /// Size of the team [default: the scenario's own]
    #[arg(long)]
    robots: Option<usize>,
    #[command(flatten)]
    size: SizeFlags,
    /// Number of episodes, each with its own starts and goals
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    episodes: u32,
    /// Seed of the starts and goals, as of `sim`
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder to write; it must not exist, or be empty
    #[arg(value_name = "OUT")]
    out: PathBuf,
}

/// Data that the folder's program reads beside the weights. Lengths are in metres.
#[derive(Serialize)]
struct Experiment<'a> {
    made_by: String,
    task: &'a str,
    policy_digest: &'a str,
    robots: usize,
    seed: u64,
    /// Whether the task's ground is that of the Robotarium after a quarter of a turn.
    turned: bool,
    half_extent_m: [f32; 2],
    walls: Vec<[f32; 4]>,
    hull_m: f32,
    arrival_m: f32,
    separation_m: f32,
    limit_s: f64,
    safety: Guarded,
    drive: Drive,
    policy: serde_json::Value,
    tensors: Vec<Tensor>,
    episodes: Vec<Episode>,
    probe: Vec<Step>,
}

/// Least distances of points \[m\], and the lag of a drive \[s\].
#[derive(Serialize)]
struct Guarded {
    distance_min_m: f32,
    walls_min_m: f32,
    lag_s: f32,
}

/// Drive of the robots. All limits are a hair below those of the actuators.
#[derive(Serialize)]
struct Drive {
    point_ahead_m: f32,
    speed_m_s: f32,
    yaw_rate_rad_s: f32,
    wheel_speed_m_s: f32,
    track_m: f32,
}

const DRIVE: Drive = Drive {
    point_ahead_m: POINT_AHEAD_M,
    speed_m_s: 0.19,
    yaw_rate_rad_s: 3.6,
    wheel_speed_m_s: 0.1999,
    track_m: 0.105,
};

/// Starts, goals and policy frames of an episode, by robot.
#[derive(Serialize)]
struct Episode {
    start: Vec<[f32; 2]>,
    goal: Vec<[f32; 2]>,
    half_turn: Vec<bool>,
}

/// Runs `export robotarium`.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    check_out(&args.out)?;
    let settings = args.size.over(Settings { robots: args.robots, ..Settings::default() });
    let scenario =
        registry.scenario(&args.scenario, &settings).map_err(|error| size::refused(&error, &settings, &[]))?;
    let turned = check_task(&*scenario, args.seed)?;
    let (model, network) = policy(&args.policy, registry, &*scenario)?;
    let Network { policy, tensors, floats } = network;
    let hull_m = scenario.arena().hull_m();
    let safety = Guarded {
        distance_min_m: 2.0 * (hull_m + POINT_AHEAD_M + HULL_MARGIN_M),
        walls_min_m: hull_m + POINT_AHEAD_M + HULL_MARGIN_M,
        lag_s: 0.0,
    };
    let tasks: Vec<Vec<Task>> = (0..args.episodes).map(|episode| scenario.tasks(args.seed, episode)).collect();
    let frames: Vec<PolicyFrame> = tasks[0].iter().map(|task| scenario.frame(task)).collect();
    let dynamics = Dynamics { filtered: true, lag_s: safety.lag_s, point_ahead_m: POINT_AHEAD_M };
    let rules = scenario.rules();
    let experiment = Experiment {
        made_by: format!("murmurate {}", env!("CARGO_PKG_VERSION")),
        task: scenario.name(),
        policy_digest: model.digest(),
        robots: scenario.robots(),
        seed: args.seed,
        turned,
        half_extent_m: scenario.arena().half_extent.to_array(),
        walls: walls(scenario.arena())?,
        hull_m,
        arrival_m: rules.arrival_m,
        separation_m: rules.separation_m,
        limit_s: rules.limit.as_secs(),
        safety,
        drive: DRIVE,
        policy,
        tensors,
        episodes: tasks.iter().map(|tasks| episode(&*scenario, tasks)).collect(),
        probe: probe::steps(&model, scenario.arena(), &frames, dynamics, args.seed),
    };
    write(&args.out, &experiment, &floats)?;
    let (team, episodes) = (counted(experiment.robots, "robot"), counted(experiment.episodes.len(), "episode"));
    let frame = if turned { ", turned by a quarter" } else { "" };
    talk(&format!("{}: {team} of '{}'{frame}, {episodes}", args.out.display(), experiment.task));
    Ok(Ended::Done)
}

/// Checks that the folder can be made: it is not there, or empty.
fn check_out(out: &Path) -> Result<()> {
    let refuse = |why: String| BadInput(format!("OUT: '{}': {why}", out.display()));
    check_folder(out).map_err(refuse)?;
    match std::fs::read_dir(out).map(|mut files| files.next().is_some()) {
        Ok(false) => Ok(()),
        Ok(true) => Err(refuse("it exists and is not empty; name a new folder".to_owned()).into()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(refuse(format!("cannot read this folder: {error}")).into()),
    }
}

/// Checks that the Robotarium can run a task, and returns whether its ground has to be turned by a quarter.
fn check_task(scenario: &dyn Scenario, seed: u64) -> Result<bool> {
    let (name, robots) = (scenario.name(), scenario.robots());
    let refuse = |why: &str| bad(format!("--scenario: '{name}' {why}"));
    if scenario.cost().is_some() {
        return refuse("has a cost in place of goals, and the exported program drives robots to goals");
    }
    if scenario.goals().are_unlabelled() {
        return refuse("has unlabelled goals, and the exported program gives each robot its own");
    }
    if !scenario.waypoints(seed, 0).is_empty() {
        return refuse("has waypoints, which the exported program does not have");
    }
    if scenario.drawn_arena(seed, 0).is_some() || !scenario.arena().movers.is_empty() {
        return refuse("has obstacles that move or are drawn for each episode; walls must stand");
    }
    if let Some(sense) = scenario.task_file().and_then(|file| file.senses().keys().next()) {
        return refuse(&format!("has the sense '{sense}', which robots of the Robotarium do not have"));
    }
    if robots > MOST_ROBOTS {
        return bad(format!("--robots: the Robotarium takes at most {MOST_ROBOTS}, and the team has {robots}"));
    }
    let hull_m = scenario.arena().hull_m();
    if hull_m < LEAST_HULL_M - 1e-6 {
        return bad(format!("--hull-m: the robots have a radius of {LEAST_HULL_M} m, and the task's {hull_m:.3} m"));
    }
    let [x, y] = scenario.arena().half_extent.to_array();
    let [most_x, most_y] = GROUND_M.map(|half_m| half_m - MARGIN_M);
    let over = |x: f32, y: f32| (x - most_x).max(y - most_y);
    if over(x, y) <= 1e-4 {
        return Ok(false);
    }
    if over(y, x) <= 1e-4 {
        return Ok(true);
    }
    let share = (most_x / x).min(most_y / y).max((most_x / y).min(most_y / x));
    let (long, short) = (x.max(y), x.min(y));
    refuse(&format!(
        "is {:.2} m x {:.2} m, and {:.2} m x {:.2} m fit: it is {:.2} m too long and {:.2} m too wide; take --scale, \
         {:.2} of what it has now",
        2.0 * x,
        2.0 * y,
        2.0 * most_x,
        2.0 * most_y,
        (2.0 * (long - most_x)).max(0.0),
        (2.0 * (short - most_y)).max(0.0),
        (share * 100.0).floor() / 100.0
    ))
}

/// Returns the walls of an arena; only rectangles are.
fn walls(arena: &Arena) -> Result<Vec<[f32; 4]>> {
    let rect = |solid: Solid| match solid {
        Solid::Rect(rect) => Ok(rect),
        _ => bad("--scenario: it has walls that are discs or polygons; the exported filter has rectangles".to_owned()),
    };
    arena.keep_outs.iter().map(|block| rect(block.solid())).collect()
}

/// Reads the policy `named`, whose networks numpy has to compute.
fn policy(named: &Path, registry: &Registry, scenario: &dyn Scenario) -> Result<(Model, Network)> {
    let shown = named.display();
    let place = format!("the policy file '{shown}'");
    let built_in = named.to_str().and_then(|name| shipped::built_in(name, scenario.name()));
    let known = named.to_str().is_some_and(|name| registry.policy(name).is_some());
    let bytes = match built_in {
        Some(bytes) => bytes.to_vec(),
        None if known => {
            let why = "is no trained policy for this task, and numpy alone computes networks of policy files";
            return bad(format!("--policy {shown}: it {why}; name a file"));
        }
        None if onnx::is_format_3(named) => {
            let of_python = named.extension().is_some_and(|ending| ending == "toml")
                && read_text(named, "policy file")?.parse::<toml::Table>().is_ok_and(|it| it.contains_key("python"));
            let what = if of_python { "a process in Python" } else { "an ONNX graph" };
            return bad(format!(
                "{place}: it is of format 3, {what}, which numpy alone does not compute; export it in format 2 \
                 (docs/export.md)"
            ));
        }
        None => read_bytes(named, "policy file")?,
    };
    let model = Model::from_file(&bytes, scenario.name()).map_err(|error| BadInput(format!("{place}: {error}")))?;
    let Model::Gnn(weights, draw) = &model else { return bad(format!("{place}: it has no network")) };
    let mut network = network::of(weights.manifest(), &bytes)?.map_err(|why| BadInput(format!("{place}: {why}")))?;
    network.policy["draw"] = serde_json::to_value(draw)?;
    Ok((model, network))
}

fn episode(scenario: &dyn Scenario, tasks: &[Task]) -> Episode {
    let points = |of: fn(&Task) -> Vec2| tasks.iter().map(|task| of(task).to_array()).collect();
    Episode {
        start: points(|task| task.start),
        goal: points(|task| task.goal),
        half_turn: tasks.iter().map(|task| scenario.frame(task) == PolicyFrame::HalfTurn).collect(),
    }
}

/// Writes the files of the folder.
fn write(out: &Path, experiment: &Experiment, floats: &[f32]) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot make the folder '{}'", out.display()))?;
    let text = serde_json::to_string(experiment).context("an experiment is JSON")?;
    let own = [("experiment.json", text.into_bytes()), ("weights.npy", network::npy(floats))];
    let same = FILES.map(|(name, text)| (name, text.as_bytes().to_vec()));
    for (name, content) in own.into_iter().chain(same) {
        let mut file = WholeFile::create(&out.join(name))?;
        file.writer().write_all(&content).with_context(|| format!("cannot write '{name}'"))?;
        file.keep()?;
    }
    Ok(())
}
