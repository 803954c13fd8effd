//! Pieces of work on several threads. The numbers never depend on how many.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// How many threads to use for so many pieces: as asked for, or one a core.
pub fn threads(asked: Option<u16>, pieces: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    asked.map_or(cores, usize::from).min(pieces)
}

#[cfg(feature = "study")]
/// Does what is missing of some pieces, until all are there or `stop` is set: `found` is what is there already. Where
/// nothing came of a piece, or it was not begun, there is none; the first error ends everything.
pub fn finish<T: Send>(
    mut found: Vec<Option<T>>,
    asked: Option<u16>,
    stop: &AtomicBool,
    work: impl Fn(usize) -> anyhow::Result<Option<T>> + Sync,
) -> anyhow::Result<Vec<Option<T>>> {
    let open: Vec<usize> = (0..found.len()).filter(|at| found[*at].is_none()).collect();
    // A disk that is full ends the study; what was written stays.
    let work = |at: usize| work(open[at]).inspect_err(|_| stop.store(true, Ordering::Relaxed));
    for (at, done) in run(open.len(), threads(asked, open.len()), stop, work) {
        found[open[at]] = done?;
    }
    Ok(found)
}

/// Does each piece once, until all are done or `stop` is set; what came of them, in their order.
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
