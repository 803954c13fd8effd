//! Benchmark of growing teams at constant density: scenario `swap`, scripted navigation, one thread.
//!
//! `cargo bench --bench growth`. An item is one simulated second of one robot. A team runs in real time as long as it
//! has fewer robots than the items per second measured. The start of the run is included.

use divan::Bencher;
use divan::counter::ItemsCount;
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate_study::network::growth;

// The program's allocator.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() {
    divan::main();
}

/// Simulated time \[s\].
const DURATION_S: usize = 10;

fn team(mode: &str, robots: usize) -> Trial {
    growth::trial(mode, robots, Span::from_secs(DURATION_S as f64)).expect("there is room for them")
}

fn run(bencher: Bencher, trial: &Trial) {
    let robots = trial.deployment.robots;
    bencher.counter(ItemsCount::new(robots * DURATION_S)).bench_local(|| trial.run());
}

/// One agent for all robots, on one host.
#[divan::bench(args = [5, 50, 200, 1000], sample_count = 3, sample_size = 1)]
fn sim(bencher: Bencher, robots: usize) {
    run(bencher, &team("sim", robots));
}

/// One host per robot; the transmission range of latents is a little longer than the communication range.
#[divan::bench(args = [5, 50, 200, 1000], sample_count = 3, sample_size = 1)]
fn onboard_adhoc(bencher: Bencher, robots: usize) {
    run(bencher, &team("onboard-adhoc", robots));
}
