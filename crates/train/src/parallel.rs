//! Work on several threads, with results that do not depend on the number of threads, and the parts of buffers for it.

use std::sync::Mutex;

/// Splits off the first `length` elements of `rest`.
///
/// # Panics
/// If there are fewer.
pub fn cut<'a, T>(rest: &mut &'a mut [T], length: usize) -> &'a mut [T] {
    rest.split_off_mut(..length).expect("a buffer has a part for each environment")
}

/// Runs `work` on every job of `jobs`, on the calling thread and `threads - 1` others; returns when all are done.
pub fn in_parallel<J: Send>(threads: usize, jobs: impl Iterator<Item = J> + Send, work: impl Fn(J) + Sync) {
    if threads <= 1 {
        jobs.for_each(work);
        return;
    }
    let queue = Mutex::new(jobs);
    let run_jobs = || {
        loop {
            let job = queue.lock().expect("a worker that panics ends the process").next();
            let Some(job) = job else { break };
            work(job);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            // A system that gives no more threads leaves more work to those that there are.
            if std::thread::Builder::new().spawn_scoped(scope, run_jobs).is_err() {
                break;
            }
        }
        run_jobs();
    });
}
