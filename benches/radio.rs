//! Benchmark of the radio channel alone: time per transmission, including idle slots and collisions.

use std::sync::Arc;

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use murmurate::messages::geometry::Vec2;
use murmurate::net::media::radio::{Channel, Destination, Fading, Powers, Radio, Topology};
use murmurate::random::{RngExt, Seed};
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

/// A thousand robots in a field that each multicast 200 bytes 20 times a second at 6 Mbit/s, for a second of simulated
/// time. They sense about thirty others: by discs, by powers, and by powers with shadowing.
#[divan::bench(args = ["discs", "powers", "shadowed"])]
fn field(bencher: Bencher, space: &str) {
    let stations = 1000;
    let channel = || {
        let mut radio = Radio {
            channel: Topology::AdHoc,
            basic_rate: "ofdm-6".parse().expect("a rate of the table"),
            ..Radio::default()
        };
        // 31 stations in a disc of 55 m.
        match space {
            "discs" => (radio.range_m, radio.sense_m) = (Some(30.0), Some(55.0)),
            // -82 dBm at 55 m.
            "powers" => radio.powers = Some(Powers { exponent: 3.34, ..Powers::default() }),
            _ => radio.powers = Some(Powers { exponent: 3.34, shadowing_db: 4.0, ..Powers::default() }),
        }
        let side_m = (f32::from(stations) * std::f32::consts::PI / 31.0).sqrt() * 55.0;
        let mut place = Seed::of_run(1).stream("places");
        let mut channel: Channel<()> = Channel::new(radio, stations, &Seed::of_run(1));
        for station in 0..stations {
            channel.place(station, Vec2::new(place.random_range(0.0..side_m), place.random_range(0.0..side_m)));
        }
        channel
    };
    let all: Arc<[u16]> = (0..stations).collect();
    let mut load = Seed::of_run(1).stream("load");
    let mut offers: Vec<(Time, u16)> = (0..20 * u32::from(stations))
        .map(|number| (Time::ZERO + Span::from_secs(load.random_range(0.0..1.0)), (number % 1000) as u16))
        .collect();
    offers.sort_unstable();
    bencher.counter(ItemsCount::new(offers.len())).with_inputs(channel).bench_local_values(|mut channel| {
        let mut arrived = Vec::new();
        for &(now, from) in &offers {
            channel.wake(now, &mut arrived);
            channel.offer(now, from, Destination::Many(Arc::clone(&all)), 200, ());
            arrived.clear();
        }
        black_box(channel.counts(Time::ZERO).transmissions)
    });
}

/// Teams of eight robots in 1024 environments, which move and multicast 200 bytes 20 times a second for half a second,
/// at once or each at its own moment: without space, with it by discs in which all hear all and in which some are
/// hidden, by powers, and by powers with shadowing and fading. An item is a step of one environment.
#[divan::bench(args = ["without", "discs", "hidden", "powers", "faded"], consts = [0, 5_500_000], sample_count = 10)]
fn steps<const APART_NS: u64>(bencher: Bencher, space: &str) {
    let (environments, robots, steps) = (1024, 8, 10);
    let mut radio = Radio { channel: Topology::AdHoc, ..Radio::default() };
    match space {
        "without" => {}
        "discs" => radio.sense_m = Some(30.0),
        "hidden" => (radio.range_m, radio.sense_m) = (Some(2.5), Some(4.5)),
        "powers" => radio.powers = Some(Powers::default()),
        _ => radio.powers = Some(Powers { shadowing_db: 4.0, fading: Fading::Rayleigh, ..Powers::default() }),
    }
    let mut channels: Vec<Channel<()>> =
        (0..environments).map(|seed| Channel::new(radio.clone(), robots, &Seed::of_run(seed))).collect();
    let all: Arc<[u16]> = (0..robots).collect();
    let (mut arrived, mut step) = (Vec::new(), 0_u64);
    let items = ItemsCount::new(channels.len() * steps);
    bencher.counter(items).bench_local(|| {
        for _ in 0..steps {
            for channel in &mut channels {
                for robot in 0..robots {
                    channel.place(robot, Vec2::new(f32::from(robot), 0.001 * (step % 1000) as f32));
                }
                for robot in 0..robots {
                    let apart = Span::from_nanos(APART_NS * u64::from(robot));
                    let now = Time::ZERO + Span::from_millis(50) * step + apart;
                    channel.wake(now, &mut arrived);
                    channel.offer(now, robot, Destination::Many(Arc::clone(&all)), 200, ());
                }
                channel.wake(Time::ZERO + Span::from_millis(50) * (step + 1), &mut arrived);
                arrived.clear();
            }
            step += 1;
        }
        black_box(channels[0].counts(Time::ZERO).transmissions)
    });
}
