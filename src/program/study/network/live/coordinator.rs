//! The coordinator of a measurement: waits for all hosts, compares clocks, has one case measured after the other.

use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::study::network::Source;
use crate::study::network::pages::Found;
use crate::study::network::peer::{Notes, Task};
use anyhow::{Context, Result, anyhow, bail};

use super::gather::gather;
use super::line::Line;
use super::{Answer, Instruction};
use crate::program::BadInput;
use crate::program::sim::progress;
use crate::program::study::network::cases::Journal;

/// How often a clock is asked for, and how long an answer may take.
const QUESTIONS: u32 = 16;
const PATIENCE: Duration = Duration::from_secs(20);
/// A case begins so long after everyone was told.
const LEAD: Duration = Duration::from_millis(1500);

/// What was measured, and how far off the clocks may have been \[s\].
pub struct Measured {
    /// What came of the cases that are done.
    pub results: Vec<Found>,
    /// The largest uncertainty of a one-way delay: that of two clocks.
    pub uncertainty_s: f64,
}

/// Measures all cases of a sweep between these hosts, in the order of their stations.
pub fn measure(
    journal: &Journal,
    hosts: &[String],
    (address, key): (SocketAddr, Option<[u8; 32]>),
    (stop, quiet): (&AtomicBool, bool),
) -> Result<Measured> {
    let origin = Instant::now();
    let sweep = &journal.sweep;
    let cases = sweep.cases();
    let mut found = journal.kept(Source::Live, &cases);
    let mut lines = Vec::new();
    // Nobody is needed for what is there already.
    if found.iter().any(Option::is_none) {
        let listener = TcpListener::bind(address).map_err(|e| {
            BadInput(format!("--coordinator: cannot listen at {address}: {e}; give an address of this machine"))
        })?;
        lines = gather((&listener, key), hosts, (stop, quiet))?;
    }
    let bar = progress(cases.len() as u64, quiet);
    for ((at, case), found) in cases.iter().enumerate().zip(&mut found) {
        if found.is_none() && !stop.load(Ordering::Relaxed) {
            let number = u32::try_from(at).context("so many cases there are not")?;
            let (features, stations) = (sweep.features(), sweep.stations);
            let task = Task { number, case: *case, stations, features, seconds: sweep.seconds, seed: sweep.seed };
            let (notes, uncertainty_s) = one(&task, hosts, &mut lines, origin)?;
            *found = Some(journal.keep(Source::Live, (at, case), task.outcome(&notes), uncertainty_s)?);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    for line in &mut lines {
        line.say(&Instruction::Done)?;
    }
    let uncertainty_s = found.iter().flatten().map(|record| record.uncertainty_s).fold(0.0, f64::max);
    let results = cases.into_iter().zip(found).filter_map(|(case, found)| Some((Source::Live, case, found?.outcome)));
    Ok(Measured { results: results.collect(), uncertainty_s })
}

/// How far a participant's clock is ahead of ours, and how far off that may be \[ns\].
fn offset(line: &mut Line, origin: Instant) -> Result<(i64, i64)> {
    let now = || origin.elapsed().as_nanos() as i64;
    let mut best: Option<(i64, i64)> = None;
    for _ in 0..QUESTIONS {
        let before = now();
        line.say(&Instruction::Clock)?;
        let Answer::Clock(theirs) = line.hear(Some(PATIENCE))? else { bail!("it did not say what its clock shows") };
        let after = now();
        let way = after - before;
        if best.is_none_or(|(_, least)| way / 2 < least) {
            best = Some((theirs as i64 - (before + way / 2), way / 2));
        }
    }
    best.ok_or_else(|| anyhow!("nothing was asked"))
}

/// Has one case measured.
fn one(task: &Task, hosts: &[String], lines: &mut [Line], origin: Instant) -> Result<(Vec<Notes>, f64)> {
    let named = |at: usize| {
        format!(
            "host '{}' is lost; start its program and the same command again: with --out what was measured is kept",
            hosts[at]
        )
    };
    let mut offsets = Vec::new();
    for (at, line) in lines.iter_mut().enumerate() {
        offsets.push(offset(line, origin).with_context(|| named(at))?);
    }
    let begin = (origin.elapsed() + LEAD).as_nanos() as i64;
    for (at, (line, (ahead, _))) in lines.iter_mut().zip(&offsets).enumerate() {
        let theirs = u64::try_from(begin + ahead).with_context(|| named(at))?;
        line.say(&Instruction::Measure(*task, theirs)).with_context(|| named(at))?;
    }
    let lasts = LEAD + Duration::from_secs_f64(task.lasts().as_secs());
    let mut notes = Vec::new();
    for (at, line) in lines.iter_mut().enumerate() {
        match line.hear(Some(lasts + PATIENCE)).with_context(|| named(at))? {
            Answer::Found(found) => notes.push(found),
            other => bail!("{} says {other:?} where it should say what it has found", named(at)),
        }
    }
    // How far a clock has run away meanwhile is how far off it may have been.
    let mut unsure = Vec::new();
    for (at, (line, (before, least))) in lines.iter_mut().zip(&offsets).enumerate() {
        let (after, most) = offset(line, origin).with_context(|| named(at))?;
        unsure.push((after - before).abs() + most.max(*least));
    }
    unsure.sort_unstable();
    let two: i64 = unsure.iter().rev().take(2).sum();
    Ok((notes, two as f64 * 1e-9))
}
