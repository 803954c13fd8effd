//! Benchmark of whole trials: two episodes with a reset between them, in one process under virtual time.
//!
//! `cargo bench --bench graph`. `sim` has one host and no links; `offboard` sends everything through the codec.

use divan::Bencher;
use murmurate::policy;
use murmurate::trial::Trial;

fn main() {
    divan::main();
}

#[divan::bench(args = ["sim", "centralized", "offboard", "onboard-adhoc"], sample_count = 10)]
fn scripted(bencher: Bencher, mode: &str) {
    let trial = Trial::preset(mode, "passage").expect("a preset").episodes(2);
    bencher.bench_local(|| trial.run());
}

#[divan::bench(args = ["sim", "offboard"], sample_count = 10)]
fn untrained_network(bencher: Bencher, mode: &str) {
    let trial = Trial::preset(mode, "passage").expect("a preset").episodes(1);
    let trial = Trial { models: policy::untrained(1).into(), ..trial };
    bencher.bench_local(|| trial.run());
}
