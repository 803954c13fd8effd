//! What a team costs as it grows, at constant density: scenario `swap`, scripted navigation, one thread.
//!
//! `cargo bench --bench growth`. Items are robots' seconds: the time of one is what a robot costs for each second of
//! its own time, and a team runs in real time as long as it has fewer robots than there are items in a second. The
//! start of the run is part of it.

use divan::Bencher;
use divan::counter::ItemsCount;
use murmurate::study::network::growth;
use murmurate::time::Span;
use murmurate::trial::Trial;

// As the program has it.
#[cfg(feature = "mimalloc")]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() {
    divan::main();
}

/// How much is simulated \[s\].
const LASTS_S: usize = 10;

fn team(mode: &str, robots: usize) -> Trial {
    growth::trial(mode, robots, Span::from_secs(LASTS_S as f64)).expect("there is room for them")
}

fn run(bencher: Bencher, trial: &Trial) {
    let robots = trial.deployment.robots;
    bencher.counter(ItemsCount::new(robots * LASTS_S)).bench_local(|| trial.run());
}

/// All robots of one agent on one host.
#[divan::bench(args = [5, 50, 200, 1000], sample_count = 3, sample_size = 1)]
fn sim(bencher: Bencher, robots: usize) {
    run(bencher, &team("sim", robots));
}

/// A host for every robot; latents carry a little farther than they are listened to.
#[divan::bench(args = [5, 50, 200, 1000], sample_count = 3, sample_size = 1)]
fn onboard_adhoc(bencher: Bencher, robots: usize) {
    run(bencher, &team("onboard-adhoc", robots));
}
