//! Finds the cost per robot of growing teams: simulates one team after the other and measures its processor time. The
//! simulation is in another module of the library.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use murmurate::net::media::radio::Radio;
use murmurate::simulate::Proceed;
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate_report::cost::Cost;
use murmurate_study::network::growth::{self, Growth};
use murmurate_study::network::{Medium, Sweep};
use murmurate_study::origin::Origin;
use nix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

use super::cases;
use crate::progress::progress;
use crate::study::folder::Folder;
use murmurate_robot::bad;

/// Team of one size and mode, which is simulated to find its cost per robot.
pub struct SizedTeam {
    mode: &'static str,
    robots: usize,
    seed: u64,
    trial: Trial,
}

impl SizedTeam {
    fn origin(&self) -> Origin {
        Origin::here(
            murmurate_robot::build::digest(),
            "network, growing teams",
            self.seed,
            "",
            &(self.mode, self.robots, growth::DURATION_S),
        )
    }
}

/// Stored result of a simulated team: its network load, and the processor time of the simulation.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CostRecord {
    /// Origin of the record: study, program, seed and conditions.
    origin: Origin,
    mode: String,
    cost: Cost,
    cpu_s: f64,
}

/// Returns a team of each of these sizes (numbers of robots) in each of two modes: one agent for all robots, and one
/// host per robot. An error names the flag.
pub fn of_sizes(sizes: &[usize], seed: u64) -> Result<Vec<SizedTeam>> {
    let mut teams = Vec::new();
    for mode in growth::MODES {
        for &robots in sizes {
            match growth::trial(mode, robots, Span::from_secs(growth::DURATION_S)) {
                Ok(trial) => teams.push(SizedTeam { mode, robots, seed, trial: trial.seed(seed) }),
                Err(error) => return bad(format!("--teams: {error}")),
            }
        }
    }
    Ok(teams)
}

/// Returns the cost per robot of each team: reads stored results from the folder, and simulates the other teams one at
/// a time. If `stop` is set, the teams that were not simulated are missing.
pub fn run(
    teams: &[SizedTeam],
    sweep: &Sweep,
    folder: Option<&Folder>,
    quiet: bool,
    stop: &AtomicBool,
) -> Result<Vec<Growth>> {
    let radio: Option<&Radio> = match &sweep.medium {
        Medium::Radio(radio) => Some(radio),
        Medium::Shaped(_) => None,
    };
    let bar = progress(teams.iter().map(|team| team.robots as u64).sum(), quiet);
    let mut grown = Vec::new();
    for team in teams {
        let name = cases::team(team.mode, team.robots);
        let kept: Option<CostRecord> = folder.and_then(|folder| folder.kept(&name));
        let record = match kept.filter(|kept| kept.origin == team.origin()) {
            Some(kept) => kept,
            None if stop.load(Ordering::Relaxed) => continue,
            None => {
                // On a thread of its own, so that its memory is not fragmented by earlier teams.
                let thread = std::thread::scope(|scope| scope.spawn(|| measured(team, stop)).join());
                let Some(record) = thread.unwrap_or_else(|panic| std::panic::resume_unwind(panic))? else { continue };
                folder.map_or(Ok(()), |folder| folder.keep(&name, &record))?;
                record
            }
        };
        bar.inc(team.robots as u64);
        grown.push(Growth::of(team.mode, &record.cost, record.cpu_s, radio));
    }
    bar.finish_and_clear();
    Ok(grown)
}

fn measured(team: &SizedTeam, stop: &AtomicBool) -> Result<Option<CostRecord>> {
    let began = cpu_s()?;
    let report = team.trial.run_while(|_| match stop.load(Ordering::Relaxed) {
        true => Proceed::Stop,
        false => Proceed::Continue,
    });
    let cpu_s = cpu_s()? - began;
    let record = || CostRecord {
        origin: team.origin(),
        mode: team.mode.to_owned(),
        cost: Cost::of(team.robots, &report),
        cpu_s,
    };
    Ok((!stop.load(Ordering::Relaxed)).then(record))
}

/// Returns the processor time of this thread \[s\].
fn cpu_s() -> Result<f64> {
    let time = clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).context("cannot read the processor time")?;
    Ok(time.tv_sec() as f64 + 1e-9 * time.tv_nsec() as f64)
}
