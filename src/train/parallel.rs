//! Work on several threads. What is computed never depends on how many there are.

use std::sync::Mutex;

/// Runs `work` on every job, on this thread and up to `threads - 1` others.
pub fn in_parallel<J: Send>(threads: usize, jobs: impl Iterator<Item = J> + Send, work: impl Fn(J) + Sync) {
    if threads <= 1 {
        jobs.for_each(work);
        return;
    }
    let queue = Mutex::new(jobs);
    let drain = || {
        loop {
            let job = queue.lock().expect("a worker that panics ends the process").next();
            let Some(job) = job else { break };
            work(job);
        }
    };
    std::thread::scope(|scope| {
        (1..threads).for_each(|_| {
            scope.spawn(drain);
        });
        drain();
    });
}
