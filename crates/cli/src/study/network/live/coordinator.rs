//! Coordinator of a measurement of the network study: waits for all hosts, compares their clocks, and starts the cases
//! one after the other.

use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use murmurate_study::network::Source;
use murmurate_study::network::pages::Found;
use murmurate_study::network::peer::{StationResult, Task};

use super::connection::Connection;
use super::gather::gather;
use super::{Request, Response};
use crate::progress::progress;
use crate::study::network::cases::Journal;
use murmurate_robot::BadInput;

/// Number of requests in one comparison of clocks (`REQUESTS`), and longest wait for a participant's response
/// (`PATIENCE`).
const REQUESTS: u32 = 16;
const PATIENCE: Duration = Duration::from_secs(20);
/// Time from the sending of the requests to measure a case until the case starts at all hosts.
const LEAD: Duration = Duration::from_millis(1500);

/// Results of a measurement between hosts, with a bound on their error.
pub struct Measured {
    /// Measured cases with their outcomes.
    pub results: Vec<Found>,
    /// Bound on the error of the measured one-way delays \[s\] over all cases, as the clocks of hosts differ.
    pub uncertainty_s: f64,
}

/// Measures all cases of a network study between `hosts`, whose index is the station number, and returns the results.
/// Cases with a stored result are not measured again. The coordinator listens at `address` for the hosts and
/// authenticates them with `key`. Fails if it cannot listen there or a host is lost; ends early once `stop` is set.
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
    let mut connections = Vec::new();
    // If all cases are finished, no host is needed.
    if found.iter().any(Option::is_none) {
        let listener = TcpListener::bind(address).map_err(|e| {
            BadInput(format!("--coordinator: cannot listen at {address}: {e}; give an address of this machine"))
        })?;
        connections = gather((&listener, key), hosts, (stop, quiet))?;
    }
    let bar = progress(cases.len() as u64, quiet);
    for ((at, case), found) in cases.iter().enumerate().zip(&mut found) {
        if found.is_none() && !stop.load(Ordering::Relaxed) {
            let number = u32::try_from(at).context("too many cases")?;
            let (features, stations) = (sweep.features(), sweep.stations);
            let task = Task { number, case: *case, stations, features, seconds: sweep.seconds, seed: sweep.seed };
            let (results, uncertainty_s) = one(&task, hosts, &mut connections, origin)?;
            *found = Some(journal.keep(Source::Live, (at, case), task.outcome(&results), uncertainty_s)?);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    for connection in &mut connections {
        connection.send(&Request::Done)?;
    }
    let uncertainty_s = found.iter().flatten().map(|record| record.uncertainty_s).fold(0.0, f64::max);
    let results = cases.into_iter().zip(found).filter_map(|(case, found)| Some((Source::Live, case, found?.outcome)));
    Ok(Measured { results: results.collect(), uncertainty_s })
}

/// Returns the offset of a participant's clock from this process's clock \[ns\], and a bound on its error \[ns\]: half
/// of the shortest round trip.
fn offset(connection: &mut Connection, origin: Instant) -> Result<(i64, i64)> {
    let now = || origin.elapsed().as_nanos() as i64;
    let mut best: Option<(i64, i64)> = None;
    for _ in 0..REQUESTS {
        let before = now();
        connection.send(&Request::Clock)?;
        let Response::Clock(theirs) = connection.receive(Some(PATIENCE))? else {
            bail!("it did not send the time of its clock")
        };
        let after = now();
        let way = after - before;
        if best.is_none_or(|(_, least)| way / 2 < least) {
            best = Some((theirs as i64 - (before + way / 2), way / 2));
        }
    }
    best.ok_or_else(|| anyhow!("no request was sent"))
}

/// Measures one case at all participants at once. Returns the stations' results, and the bound on the error of their
/// one-way delays \[s\].
fn one(
    task: &Task,
    hosts: &[String],
    connections: &mut [Connection],
    origin: Instant,
) -> Result<(Vec<StationResult>, f64)> {
    let named = |at: usize| {
        format!(
            "host '{}' is lost; start its program and the same command again: with --out what was measured is kept",
            hosts[at]
        )
    };
    let mut offsets = Vec::new();
    for (at, connection) in connections.iter_mut().enumerate() {
        offsets.push(offset(connection, origin).with_context(|| named(at))?);
    }
    let begin = (origin.elapsed() + LEAD).as_nanos() as i64;
    for (at, (connection, (ahead, _))) in connections.iter_mut().zip(&offsets).enumerate() {
        let theirs = u64::try_from(begin + ahead).with_context(|| named(at))?;
        connection.send(&Request::Measure(*task, theirs)).with_context(|| named(at))?;
    }
    let lasts = LEAD + Duration::from_secs_f64(task.lasts().as_secs());
    let mut results = Vec::new();
    for (at, connection) in connections.iter_mut().enumerate() {
        match connection.receive(Some(lasts + PATIENCE)).with_context(|| named(at))? {
            Response::Found(found) => results.push(found),
            other => bail!("{} sent {other:?} instead of its result", named(at)),
        }
    }
    // Clock drift during the case adds to the uncertainty.
    let mut unsure = Vec::new();
    for (at, (connection, (before, least))) in connections.iter_mut().zip(&offsets).enumerate() {
        let (after, most) = offset(connection, origin).with_context(|| named(at))?;
        unsure.push((after - before).abs() + most.max(*least));
    }
    unsure.sort_unstable();
    let two: i64 = unsure.iter().rev().take(2).sum();
    Ok((results, two as f64 * 1e-9))
}
