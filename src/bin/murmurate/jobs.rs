//! Pieces of work on several threads. The numbers never depend on how many.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// How many threads to use for so many pieces: as asked for, or one a core.
pub fn threads(asked: Option<u16>, pieces: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    asked.map_or(cores, usize::from).min(pieces)
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
