//! Runs independent jobs on several threads. Results do not depend on the number of threads.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Returns the number of threads for `pieces` jobs: `asked`, or one per processor core if `asked` is `None`; never more
/// than there are jobs.
pub fn threads(asked: Option<u16>, pieces: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    asked.map_or(cores, usize::from).min(pieces)
}

/// Completes a list of jobs of which some have results already. `found` has one entry per job: its result, or `None`;
/// `open` lists the indices of the jobs to run. Runs these with `work` on up to `asked` threads (`None`: one per core),
/// until all are done or `stop` is set, and returns the list with their results; `None` for a job that was not run or
/// gave no result. The first error stops all jobs and is returned.
pub fn finish<T: Send>(
    (mut found, open): (Vec<Option<T>>, Vec<usize>),
    asked: Option<u16>,
    stop: &AtomicBool,
    work: impl Fn(usize) -> anyhow::Result<Option<T>> + Sync,
) -> anyhow::Result<Vec<Option<T>>> {
    // An error, such as a full disk, ends the study. Files already written are kept.
    let work = |at: usize| work(open[at]).inspect_err(|_| stop.store(true, Ordering::Relaxed));
    for (at, done) in run(open.len(), threads(asked, open.len()), stop, work) {
        found[open[at]] = done?;
    }
    Ok(found)
}

/// Runs the jobs `0..pieces` once each, on `threads` threads, until all are done or `stop` is set: job `i` is the call
/// `work(i)`. Returns index and result of each finished job, by index.
pub fn run<T: Send>(
    pieces: usize,
    threads: usize,
    stop: &AtomicBool,
    work: impl Fn(usize) -> T + Sync,
) -> Vec<(usize, T)> {
    let next = AtomicUsize::new(0);
    let worker = || {
        let mut done = Vec::new();
        loop {
            let piece = next.fetch_add(1, Ordering::Relaxed);
            if piece >= pieces || stop.load(Ordering::Relaxed) {
                return done;
            }
            done.push((piece, work(piece)));
        }
    };
    let mut done: Vec<(usize, T)> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        threads
            .into_iter()
            .flat_map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    });
    done.sort_by_key(|(piece, _)| *piece);
    done
}
