//! The command `murmurate task`: checks a task file, tries scripted navigation in it, and draws it.

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::{Context, Result};
use murmurate::config::shown::{counted, value};
use murmurate::deploy::{Deployment, Impair};
use murmurate::messages::geometry::{Planar, Task, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::policy;
use murmurate::policy::roadmap::Roadmap;
use murmurate::registry::Registry;
use murmurate::scenario::{Arena, ScenarioError, Settings, goals};
use murmurate::trial::Trial;
use murmurate_robot::output::print;
use murmurate_robot::{BadInput, Ended};
use serde::Serialize;

use crate::deployment::{ModeParser, impaired};
use crate::picture::{Flags, Pictures};
use crate::size::{self, SizeFlags};

/// Largest number of cells along each axis, into which the ground is divided in the search for closed rooms.
const CELLS: f32 = 400.0;
/// Side of a cell, in radii of the robots.
const CELL: f32 = 0.25;

/// Checks task files (docs/tasks.md).
#[derive(clap::Subcommand)]
#[command(
    after_help = "Exit codes: 0 the task can be run; 1 something in it cannot work, and the output says what; 2 \
    a flag or the file is wrong, and nothing was run."
)]
pub enum Args {
    /// Checks a task file: reads it, looks for closed rooms and for goals that no way leads to, and tries scripted
    /// navigation in some layouts
    Check(Check),
}

/// Flags of `task check`.
#[derive(clap::Args)]
pub struct Check {
    /// Task file
    #[arg(value_name = "FILE.toml")]
    file: PathBuf,
    /// Size of the team [default: the file's own]
    #[arg(long)]
    robots: Option<usize>,
    #[command(flatten)]
    size: SizeFlags,
    /// Mode of the episodes of scripted navigation (see 'murmurate deployment')
    #[arg(long, default_value = "sim", value_parser = ModeParser)]
    mode: String,
    /// Delay of the messages between robots in these episodes, in a mode whose robots are on hosts of their own \[ms\]
    #[arg(long, default_value_t = 0.0, value_name = "MS")]
    delay_ms: f64,
    /// Share of these messages that is lost, 0 to 1
    #[arg(long, default_value_t = 0.0)]
    loss: f64,
    /// Number of layouts that are looked at, and of episodes of scripted navigation
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    layouts: u32,
    /// Seed of the layouts
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    pictures: Flags,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// Result of a check.
#[derive(Serialize)]
struct Checked {
    name: String,
    about: String,
    /// Digest of the file, which hosts compare.
    digest: String,
    robots: usize,
    /// Team sizes that the task takes, in words.
    takes: String,
    half_extent_m: [f32; 2],
    hull_m: f32,
    walls: usize,
    doors: usize,
    /// Number of moving obstacles.
    movers: usize,
    /// Names of the senses that the file gives the robots.
    senses: Vec<String>,
    layouts: u32,
    /// Number of episodes in which scripted navigation succeeded.
    successes: usize,
    success_rate: f64,
    /// Success rate that the file demands of scripted navigation.
    demanded: f64,
    /// Descriptions of what cannot work.
    findings: Vec<String>,
}

/// Runs `task`.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let Args::Check(args) = args;
    let path = args.file.to_string_lossy();
    let file = registry.task_file(&path).map_err(|error| BadInput(error.to_string()))?;
    let settings = args.size.over(Settings { robots: args.robots, ..Settings::default() });
    let scenario = file.scenario(&settings).map_err(|error| match error {
        ScenarioError::TaskFile { error, .. } => BadInput(format!("the task file '{path}': {error}")),
        error => size::refused(&error, &settings, &[]),
    })?;
    let pictures = Pictures::open(&args.pictures, args.layouts)?;
    let deployment = Deployment::preset(&args.mode, scenario.robots()).expect("the parser lets only modes through");
    let scripted = policy::scripted(&*scenario);
    let model = registry.policy(scripted).context("the program has its scripted policies")?;
    let model = (model.build)(&*scenario)?;
    let deployment = impaired(deployment.sized(&settings), (args.delay_ms, args.loss), Impair::Latent)?;
    let mut trial = Trial::with_registry(registry, deployment, scenario, model);
    trial = trial.seed(args.seed).episodes(args.layouts);
    trial.steps = pictures.steps(0, trial.steps);
    let mut findings = closed_rooms(trial.scenario.arena());
    findings.extend(lost(&trial));
    let report = trial.run();
    let (successes, episodes) = (report.successes(), report.episodes.len());
    let (success_rate, demanded) = (successes as f64 / episodes.max(1) as f64, trial.scenario.scripted_success());
    if success_rate < demanded {
        let why = format!(
            "scripted_success: scripted navigation succeeds in {successes} of {episodes} episodes, and the file \
             demands {:.1} %",
            100.0 * demanded
        );
        findings.push(why);
    }
    let arena = trial.layouts.arena(0).map_or(trial.scenario.arena(), |arena| arena);
    let checked = Checked {
        name: file.name().to_owned(),
        about: file.about().to_owned(),
        digest: file.digest(),
        robots: trial.scenario.robots(),
        takes: file.team_sizes().to_string(),
        half_extent_m: arena.half_extent.to_array(),
        hull_m: arena.hull_m(),
        walls: arena.keep_outs.len(),
        doors: arena.portals.len(),
        movers: arena.movers.len(),
        senses: file.senses().keys().cloned().collect(),
        layouts: args.layouts,
        successes,
        success_rate,
        demanded,
        findings,
    };
    print(&if args.json { serde_json::to_string(&checked).context("a result is JSON")? } else { text(&checked) })?;
    pictures.draw(&trial, scripted, &[report])?;
    Ok(if checked.findings.is_empty() { Ended::Done } else { Ended::Unfit })
}

fn text(checked: &Checked) -> String {
    let Checked { name, about, robots, takes, walls, doors, layouts, successes, .. } = checked;
    let ground = checked.half_extent_m.map(|half_m| 2.0 * half_m);
    let about = if about.is_empty() { String::new() } else { format!(": {}", value(about)) };
    let mut lines = vec![
        format!("{name}{about}"),
        format!("  robots     {robots:>6}   of {takes}, hull {:.2} m", checked.hull_m),
        format!(
            "  ground     {} m x {} m, {}, {}",
            ground[0],
            ground[1],
            counted(*walls, "wall"),
            counted(*doors, "door")
        ),
        format!(
            "  scripted   {:>6.1} % {successes} of {}; the file demands {:.1} %",
            100.0 * checked.success_rate,
            counted(*layouts, "layout"),
            100.0 * checked.demanded
        ),
        format!("  digest     {}", checked.digest),
    ];
    if checked.movers > 0 {
        lines[2] += &format!(", {}", counted(checked.movers, "moving obstacle"));
    }
    if !checked.senses.is_empty() {
        lines.insert(3, format!("  senses     {}", checked.senses.join(", ")));
    }
    lines.extend(checked.findings.iter().map(|finding| format!("cannot work: {finding}")));
    lines.join("\n")
}

/// Returns a line about the robots that find no way from their starts to their goals. Where goals are unlabelled, they
/// are shared out so that as many as possible find one.
fn lost(trial: &Trial) -> Option<String> {
    let mut roadmap = Roadmap::new(trial.scenario.arena());
    let (mut layouts, mut first) = (BTreeSet::new(), None);
    for episode in 0..trial.layouts.len() {
        if let Some(arena) = trial.layouts.arena(episode) {
            roadmap = Roadmap::new(arena);
        }
        let tasks = trial.layouts.episode(episode);
        let is_lost = |robot: usize, goal: usize| {
            let course = trial.layouts.course(episode, RobotId(robot as u16));
            let ends = [&[tasks[robot].start], course.waypoints(), &[tasks[goal].goal]].concat();
            ends.windows(2).any(|leg| roadmap.path(leg[0], leg[1]).is_none())
        };
        let goals: Vec<usize> = if trial.scenario.goals().are_unlabelled() {
            let pairs = (0..tasks.len()).flat_map(|robot| (0..tasks.len()).map(move |goal| (robot, goal)));
            let costs: Vec<i64> = pairs.map(|(robot, goal)| is_lost(robot, goal).into()).collect();
            goals::assigned([tasks.len(); 2], |robot, goal| costs[robot * tasks.len() + goal])
        } else {
            (0..tasks.len()).collect()
        };
        for (robot, goal) in goals.into_iter().enumerate() {
            if is_lost(robot, goal) {
                layouts.insert(episode);
                first.get_or_insert((robot, episode, Task { start: tasks[robot].start, goal: tasks[goal].goal }));
            }
        }
    }
    let (robot, episode, task) = first?;
    Some(format!(
        "goals: no way leads from start to goal in {} of {}: first for robot {robot} in layout {}, from {:.2} to {:.2}",
        layouts.len(),
        counted(trial.layouts.len(), "layout"),
        episode + 1,
        task.start.shown(),
        task.goal.shown()
    ))
}

/// Returns a line for each part of the ground but the largest, if no robot gets from one to another.
fn closed_rooms(arena: &Arena) -> Vec<String> {
    let half = arena.half_extent;
    let cell_m = (CELL * arena.robot_radius_m).max(2.0 * half.max() / CELLS);
    let [columns, rows] = [half.x, half.y].map(|half_m| (2.0 * half_m / cell_m).floor() as usize + 1);
    let point = |at: usize| Vec2::new((at % columns) as f32, (at / columns) as f32) * cell_m - half;
    let is_open = |at: usize| arena.clearance(point(at)) > arena.robot_radius_m;
    let mut open: Vec<bool> = (0..columns * rows).map(is_open).collect();
    let mut parts: Vec<(usize, Vec2)> = Vec::new();
    for from in 0..open.len() {
        let (mut waiting, mut cells, mut sum) = (vec![from], 0, Vec2::zeros());
        while let Some(at) = waiting.pop() {
            if !std::mem::take(&mut open[at]) {
                continue;
            }
            (cells, sum) = (cells + 1, sum + point(at));
            let (x, y) = (at % columns, at / columns);
            waiting.extend((x > 0).then(|| at - 1));
            waiting.extend((x + 1 < columns).then(|| at + 1));
            waiting.extend((y > 0).then(|| at - columns));
            waiting.extend((y + 1 < rows).then(|| at + columns));
        }
        if cells > 0 {
            parts.push((cells, sum / cells as f32));
        }
    }
    parts.sort_by_key(|(cells, _)| std::cmp::Reverse(*cells));
    let closed = parts.iter().skip(1).map(|(cells, middle)| {
        let area = *cells as f32 * cell_m * cell_m;
        format!("walls: no robot gets from the rest of the ground to {area:.2} m^2 around {:.2}", middle.shown())
    });
    closed.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::scenario::KeepOut;

    #[test]
    fn a_closed_room_is_named_with_its_place_and_an_open_one_is_not() {
        let wall = |min: [f32; 2], max: [f32; 2]| KeepOut::rect(min.into(), max.into());
        let arena = |walls: Vec<KeepOut>| Arena::new(Vec2::repeat(2.0), walls, 0.25);
        assert!(closed_rooms(&arena(Vec::new())).is_empty());
        let found = closed_rooms(&arena(vec![wall([-2.0, 0.9], [2.0, 1.1])]));
        assert!(found.len() == 1 && found[0].contains("around [0.00, 1.6"), "{found:?}");
        assert!(closed_rooms(&arena(vec![wall([-1.4, 0.9], [2.0, 1.1])])).is_empty());
    }
}
