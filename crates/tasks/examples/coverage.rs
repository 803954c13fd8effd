//! Runs the baselines of coverage on worlds that `tests/peers/coverage/export.py` wrote, and compares their costs with
//! those of CoverageControl on the same worlds: one line per world and baseline, then the means.
//!
//! ```text
//! cargo run --release -p murmurate-tasks --example coverage -- DIR [--json] [--within 0.02]
//! ```
//!
//! With `--within`, the program fails if a mean differs by more than that share. With `--features`, densities are made
//! from the worlds' Gaussians, and not read from the library's maps. With `--never-rest`, robots go on where the
//! library lets them rest.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use murmurate_tasks::coverage::{
    Point,
    field::{Feature, Field},
    grid::Grid,
    run::{Baseline, Outcome, Parameters, Rest, Team, run},
};
use serde::{Deserialize, Serialize};

/// Content of the file `worlds.json` of the exporter.
#[derive(Deserialize)]
struct Exported {
    parameters: Written,
    steps: usize,
    cost_every: usize,
    worlds: Vec<World>,
}

#[derive(Deserialize)]
struct Written {
    side_m: f64,
    resolution_m: f64,
    step_s: f64,
    speed_m_s: f64,
    communication_m: f64,
    local_map_m: f64,
    sensor_m: f64,
    truncation: f64,
}

#[derive(Deserialize)]
struct World {
    density: PathBuf,
    /// Mean x and y, deviation, weight.
    features: Vec<[f64; 4]>,
    starts: Vec<Point>,
    results: BTreeMap<String, Theirs>,
}

#[derive(Deserialize)]
struct Theirs {
    mean: f64,
    #[serde(rename = "final")]
    last: f64,
    steps: usize,
    cpu_s: f64,
}

/// One baseline on one world: our result beside theirs.
#[derive(Serialize)]
struct Line {
    world: usize,
    baseline: &'static str,
    mean: f64,
    last: f64,
    steps: usize,
    their_mean: f64,
    their_last: f64,
    their_steps: usize,
    steps_per_s: f64,
    their_steps_per_s: f64,
}

/// Means of one baseline over all worlds.
#[derive(Serialize)]
struct Means {
    baseline: &'static str,
    mean: f64,
    their_mean: f64,
    /// Relative difference of the means.
    difference: f64,
    /// Largest relative difference of a world.
    largest_of_a_world: f64,
    last: f64,
    their_last: f64,
    steps_per_s: f64,
    their_steps_per_s: f64,
}

#[derive(Serialize)]
struct Report {
    lines: Vec<Line>,
    means: Vec<Means>,
    /// Largest difference of a density that is made from its Gaussians from that of the library.
    density_difference: f64,
}

struct Flags {
    folder: PathBuf,
    json: bool,
    within: Option<f64>,
    /// Whether densities are made from the Gaussians, and not read.
    features: bool,
    rest: Rest,
}

fn flags() -> Result<Flags, Box<dyn Error>> {
    let mut flags = Flags { folder: PathBuf::new(), json: false, within: None, features: false, rest: Rest::Places };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--json" => flags.json = true,
            "--features" => flags.features = true,
            "--never-rest" => flags.rest = Rest::Never,
            "--within" => flags.within = Some(words.next().ok_or("--within SHARE")?.parse()?),
            folder => flags.folder = folder.into(),
        }
    }
    Ok(flags)
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let flags = flags()?;
    let exported: Exported = serde_json::from_slice(&std::fs::read(flags.folder.join("worlds.json"))?)?;
    let report = compare(&exported, &flags)?;
    if flags.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print(&report);
    }
    let largest = report.means.iter().map(|means| means.difference.abs()).fold(0.0, f64::max);
    match flags.within {
        Some(within) if largest > within => {
            eprintln!("a mean differs by {:.2} %, more than {:.2} %", 100.0 * largest, 100.0 * within);
            Ok(ExitCode::FAILURE)
        }
        _ => Ok(ExitCode::SUCCESS),
    }
}

fn compare(exported: &Exported, flags: &Flags) -> Result<Report, Box<dyn Error>> {
    let written = &exported.parameters;
    let parameters = Parameters {
        step_s: written.step_s,
        speed_m_s: written.speed_m_s,
        communication_m: written.communication_m,
        local_map_m: written.local_map_m,
        sensor_m: written.sensor_m,
        rest: flags.rest,
    };
    let grid = Grid { cells: (written.side_m / written.resolution_m).round() as usize, cell_m: written.resolution_m };
    let mut lines = Vec::new();
    let mut density_difference: f64 = 0.0;
    for (at, world) in exported.worlds.iter().enumerate() {
        let theirs = Field::of_cells(grid, density(&flags.folder.join(&world.density))?)?;
        let ours = Field::of_features(grid, &features(world), written.truncation)?;
        let differences =
            ours.density().iter().zip(theirs.density()).map(|(our, their)| f64::from((our - their).abs()));
        density_difference = differences.fold(density_difference, f64::max);
        let field = if flags.features { ours } else { theirs };
        for baseline in Baseline::ALL {
            let began = Instant::now();
            let team = Team::new(&field, parameters, baseline, &world.starts);
            let outcome = run(team, exported.steps, exported.cost_every);
            let theirs = world.results.get(baseline.name()).ok_or("a world without results of a baseline")?;
            lines.push(line(at, baseline, &outcome, theirs, began.elapsed().as_secs_f64()));
        }
    }
    let means = Baseline::ALL.map(|baseline| means(&lines, baseline.name())).into();
    Ok(Report { lines, means, density_difference })
}

/// Reads little-endian floats.
fn density(path: &Path) -> Result<Vec<f32>, std::io::Error> {
    let bytes = std::fs::read(path)?;
    Ok(bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
}

fn features(world: &World) -> Vec<Feature> {
    let feature = |&[x, y, deviation_m, weight]: &[f64; 4]| Feature { centre_m: [x, y], deviation_m, weight };
    world.features.iter().map(feature).collect()
}

fn line(world: usize, baseline: Baseline, ours: &Outcome, theirs: &Theirs, seconds: f64) -> Line {
    Line {
        world,
        baseline: baseline.name(),
        mean: ours.mean,
        last: ours.last,
        steps: ours.steps,
        their_mean: theirs.mean,
        their_last: theirs.last,
        their_steps: theirs.steps,
        steps_per_s: ours.steps as f64 / seconds,
        their_steps_per_s: theirs.steps as f64 / theirs.cpu_s,
    }
}

fn means(lines: &[Line], baseline: &'static str) -> Means {
    let of: Vec<&Line> = lines.iter().filter(|line| line.baseline == baseline).collect();
    let mean = |value: fn(&Line) -> f64| of.iter().map(|line| value(line)).sum::<f64>() / of.len() as f64;
    let (ours, theirs) = (mean(|line| line.mean), mean(|line| line.their_mean));
    let largest = of.iter().map(|line| (line.mean / line.their_mean - 1.0).abs()).fold(0.0, f64::max);
    Means {
        baseline,
        mean: ours,
        their_mean: theirs,
        difference: ours / theirs - 1.0,
        largest_of_a_world: largest,
        last: mean(|line| line.last),
        their_last: mean(|line| line.their_last),
        steps_per_s: mean(|line| line.steps_per_s),
        their_steps_per_s: mean(|line| line.their_steps_per_s),
    }
}

fn print(report: &Report) {
    for line in &report.lines {
        println!(
            "{:2} {:13} mean {:.4} (theirs {:.4}, {:+.2} %)  last {:.4} ({:.4})  steps {:3} ({:3})",
            line.world,
            line.baseline,
            line.mean,
            line.their_mean,
            100.0 * (line.mean / line.their_mean - 1.0),
            line.last,
            line.their_last,
            line.steps,
            line.their_steps,
        );
    }
    for means in &report.means {
        println!(
            "{:13} mean {:.4} (theirs {:.4}, {:+.2} %; a world at most {:.2} %)  last {:.4} ({:.4})  \
             {:.0} steps/s ({:.0} per CPU second)",
            means.baseline,
            means.mean,
            means.their_mean,
            100.0 * means.difference,
            100.0 * means.largest_of_a_world,
            means.last,
            means.their_last,
            means.steps_per_s,
            means.their_steps_per_s,
        );
    }
    println!("densities from Gaussians differ by at most {:.2e}", report.density_difference);
}
