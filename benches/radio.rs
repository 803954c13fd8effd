//! Benchmark of the radio channel alone: time per transmission, including idle slots and collisions.

use std::sync::Arc;

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use murmurate::net::media::radio::{Channel, Destination, Radio, Topology};
use murmurate::random::Seed;
use murmurate::time::{Span, Time};

fn main() {
    divan::main();
}

/// Saturated stations with frames of 300 bytes, for ten seconds. An item is a transmission.
#[divan::bench(args = [2, 5, 20, 50])]
fn saturated(bencher: Bencher, stations: u16) {
    let end = Time::ZERO + Span::from_millis(10_000);
    let run = || {
        let radio = Radio { channel: Topology::AdHoc, ..Radio::default() };
        let mut channel = Channel::new(radio, stations, &Seed::of_run(1));
        for station in 0..stations {
            channel.saturate(Time::ZERO, station, Destination::One((station + 1) % stations), 300, ());
        }
        let mut arrived = Vec::new();
        channel.wake(end, &mut arrived);
        channel.counts(end).transmissions
    };
    bencher.counter(ItemsCount::new(run())).bench_local(|| black_box(run()));
}

/// Robots that each multicast 20 times a second through an access point, for ten seconds, with noise and frames of
/// other networks. An item is a transmission.
#[divan::bench(args = [5, 20])]
fn team(bencher: Bencher, robots: u16) {
    let run = || {
        let radio = Radio { noise_loss: 0.1, background: 0.2, ..Radio::default() };
        let mut channel = Channel::new(radio, robots, &Seed::of_run(1));
        let all: Arc<[u16]> = (0..robots).collect();
        let mut arrived = Vec::new();
        for step in 0..200 * u64::from(robots) {
            let now = Time::ZERO + Span::from_nanos(step * 50_000_000 / u64::from(robots));
            channel.wake(now, &mut arrived);
            channel.offer(now, (step % u64::from(robots)) as u16, Destination::Many(Arc::clone(&all)), 300, ());
            arrived.clear();
        }
        channel.counts(Time::ZERO).transmissions
    };
    bencher.counter(ItemsCount::new(run())).bench_local(|| black_box(run()));
}
