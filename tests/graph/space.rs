//! The radio channel with space: equal to the channel without it where all hear all, and what hidden stations, walls,
//! and an access point in a place do.

use std::sync::Arc;

use murmurate::messages::geometry::Vec2;
use murmurate::net::media::radio::channel::Transmission;
use murmurate::net::media::radio::counts::StationCounts;
use murmurate::net::media::radio::{
    Adaptation, Channel, Delivery, Destination, Powers, Radio, RadioCounts, Recovery, Topology,
};
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;

fn at_s(s: f64) -> Time {
    Time::ZERO + Span::from_secs(s)
}

fn ad_hoc() -> Radio {
    Radio { channel: Topology::AdHoc, ..Radio::default() }
}

/// All that a channel tells of a run.
type Told = (Vec<Delivery<u32>>, RadioCounts, Vec<StationCounts>, Vec<Transmission<u32>>);

/// Corners of a pentagon at which five stations are.
#[derive(Clone, Copy, Debug)]
enum Places {
    /// None.
    Nowhere,
    /// Within a square whose diagonal is 1 m.
    Close,
    /// All within 1 m of each other, but not in such a square.
    Apart,
    /// Now close and now apart.
    Changing,
    /// At unequal distances of some metres, and a sixth station on one side.
    Uneven {
        /// How far away the sixth is.
        sixth_m: f32,
    },
    /// Now close and now out of range of each other, and a sixth station on one side. All frames are for all.
    Parting {
        /// How far away the sixth is.
        sixth_m: f32,
    },
}

impl Places {
    /// Moves the stations of a channel.
    fn place(self, channel: &mut Channel<u32>, stream: &mut Stream) {
        let radius_m = match self {
            Places::Nowhere => return,
            Places::Close => 0.3,
            Places::Changing if stream.random_bool(0.5) => 0.3,
            Places::Apart | Places::Changing => 0.5,
            Places::Uneven { sixth_m } => {
                channel.place(5, Vec2::new(sixth_m, 0.0));
                4.0
            }
            Places::Parting { sixth_m } => {
                channel.place(5, Vec2::new(sixth_m, 0.0));
                if stream.random_bool(0.5) { 0.3 } else { 5.0 }
            }
        };
        for station in 0..5 {
            let (sin, cos) = (f32::from(station) * 1.2566).sin_cos();
            let farther = if matches!(self, Places::Uneven { .. }) { 0.2 * f32::from(station) } else { 0.0 };
            channel.place(station, Vec2::new(radius_m * (cos + farther), radius_m * sin));
        }
    }
}

/// Runs five stations that send frames of many sizes to one and to all, at random times, about as fast as the channel
/// carries them.
fn mixed(radio: &Radio, seed: u64, mean_s: f64, places: Places) -> Told {
    let stations = 5;
    let all_stations = stations + u16::from(matches!(places, Places::Uneven { .. } | Places::Parting { .. }));
    let mut channel = Channel::new(radio.clone(), all_stations, &Seed::of_run(seed));
    channel.record_transmissions();
    let mut stand = Seed::of_run(seed).stream("places");
    let mut load = Seed::of_run(seed).stream("load");
    let all: Arc<[u16]> = (0..stations).collect();
    let (mut arrived, mut s) = (Vec::new(), 0.0);
    for number in 0..1500 {
        s += load.random_range(0.0..2.0 * mean_s);
        channel.wake(at_s(s), &mut arrived);
        places.place(&mut channel, &mut stand);
        let from = load.random_range(0..stations);
        let to = match load.random_range(0..3) {
            0 if !matches!(places, Places::Parting { .. }) => {
                Destination::One((from + load.random_range(1..stations)) % stations)
            }
            _ => Destination::Many(Arc::clone(&all)),
        };
        channel.offer(at_s(s), from, to, load.random_range(20..1400), number);
    }
    let end = at_s(s + 5.0);
    channel.wake(end, &mut arrived);
    let of_stations = (0..stations).map(|station| channel.station_counts(station)).collect();
    let mut transmissions = channel.transmissions();
    // Of frames that collide, the one whose station comes first, or that ends first.
    transmissions.sort_by_key(|one| (one.since, one.by));
    (arrived, channel.counts(end), of_stations, transmissions)
}

#[test]
fn where_all_hear_all_a_channel_with_space_is_the_one_without() {
    let presets =
        ["wifi", "wifi-n", "wifi-slow", "wifi-ibss", "paper"].map(|name| Radio::preset(name).expect("a preset"));
    let mut radios: Vec<Radio> = presets.to_vec();
    radios.extend(presets.map(|preset| Radio { channel: Topology::AdHoc, ..preset }));
    radios.push(Radio { after_error: Recovery::Difs, noise_loss: 0.3, ..ad_hoc() });
    radios.push(Radio { retries: 1, queue: 3, background: 0.3, ..Radio::default() });
    for (at, radio) in radios.iter().enumerate() {
        let space = Radio { sense_m: Some(1.0), ..radio.clone() };
        assert!(space.has_space() && !radio.has_space());
        for seed in 1..=3 {
            // At a slow and at a fast load.
            for mean_s in [0.006, 0.001] {
                let without = mixed(radio, seed, mean_s, Places::Nowhere);
                assert!(without.0.len() > 300, "radio {at}: {} deliveries", without.0.len());
                for places in [Places::Nowhere, Places::Close, Places::Apart, Places::Changing] {
                    let with = mixed(&space, seed, mean_s, places);
                    let what = format!("radio {at}, seed {seed}, mean {mean_s} s, {places:?}");
                    let differs = without.0.iter().zip(&with.0).position(|(one, other)| one != other);
                    assert_eq!((without.0.len(), None), (with.0.len(), differs), "deliveries, {what}");
                    assert_eq!(without.1, with.1, "{what}");
                    assert_eq!(without.2, with.2, "{what}");
                    assert!(without.3 == with.3, "transmissions, {what}");
                }
            }
        }
    }
}

#[test]
fn stations_with_powers_that_are_close_collide_as_those_do_that_are_not() {
    let powers = Some(Powers::default());
    for capture in [false, true] {
        for channel in [Topology::AdHoc, Topology::Infrastructure] {
            let radio =
                Radio { channel, capture, powers: powers.clone(), access_point_m: Some([0.5, 0.0]), ..ad_hoc() };
            let radio = Radio { access_point_m: radio.access_point_m.filter(|_| channel != Topology::AdHoc), ..radio };
            for (seed, mean_s) in [(1, 0.006), (2, 0.001), (3, 0.0003)] {
                // A sixth station says nothing; only where it stands differs.
                let [near, far] = [1.0, 5000.0].map(|sixth_m| mixed(&radio, seed, mean_s, Places::Uneven { sixth_m }));
                let what = format!("{channel:?}, capture {capture}, mean {mean_s} s");
                assert!(near.1.lost_collision > 0 || mean_s > 0.001, "{what}");
                let differs = near.0.iter().zip(&far.0).find(|(one, other)| one != other);
                assert_eq!((near.0.len(), near.1, None), (far.0.len(), far.1, differs), "{what}");
                assert!(near.3 == far.3, "transmissions, {what}");
            }
        }
    }
}

#[test]
fn a_frame_that_stations_hear_as_it_begins_is_read_though_they_part_before_its_end() {
    let radio = Radio { range_m: Some(1.0), sense_m: Some(1.2), ..ad_hoc() };
    for (seed, mean_s) in [(1, 0.006), (2, 0.001), (3, 0.0003)] {
        let [near, far] = [0.1, 5000.0].map(|sixth_m| mixed(&radio, seed, mean_s, Places::Parting { sixth_m }));
        assert!(near.1.lost_range > 0 && near.1.arrived > 0, "{:?}", near.1);
        let differs = near.0.iter().zip(&far.0).find(|(one, other)| one != other);
        assert_eq!((near.0.len(), near.1, None), (far.0.len(), far.1, differs), "mean {mean_s} s");
    }
}

/// Returns the counters of two stations that both send to a third one, at the same rate.
fn two_to_the_middle(radio: &Radio, places: [[f32; 2]; 3]) -> RadioCounts {
    let mut channel: Channel<u32> = Channel::new(radio.clone(), 3, &Seed::of_run(1));
    for (station, place) in (0..).zip(places) {
        channel.place(station, Vec2::from(place));
    }
    let mut load = Seed::of_run(1).stream("load");
    let (mut arrived, mut s) = (Vec::new(), 0.0);
    for number in 0..4000 {
        s += load.random_range(0.0..0.0016);
        channel.wake(at_s(s), &mut arrived);
        channel.offer(at_s(s), [0, 2][number as usize % 2], Destination::One(1), 200, number);
    }
    channel.wake(at_s(s + 2.0), &mut arrived);
    let mut tokens: Vec<u32> = arrived.iter().map(|one| one.token).collect();
    tokens.sort_unstable();
    assert!(tokens.windows(2).all(|pair| pair[0] < pair[1]), "no datagram is delivered twice");
    channel.counts(at_s(s + 2.0))
}

const LINE: [[f32; 2]; 3] = [[0.0, 0.0], [25.0, 0.0], [50.0, 0.0]];

#[test]
fn hidden_stations_collide_at_the_one_between_them() {
    let near = two_to_the_middle(&Radio { sense_m: Some(60.0), ..ad_hoc() }, LINE);
    let hidden = two_to_the_middle(&Radio { range_m: Some(30.0), sense_m: Some(30.0), ..ad_hoc() }, LINE);
    assert!(hidden.collided > 5 * near.collided.max(1), "{hidden:?}\n{near:?}");
    assert_eq!((hidden.wanted, hidden.arrived + hidden.lost()), (4000, 4000));
    assert!(hidden.lost_retries < 10, "retries carry almost all: {hidden:?}");
}

#[test]
fn two_pairs_that_are_apart_share_no_airtime() {
    let run = |gap_m: f32| {
        let radio = Radio { sense_m: Some(30.0), range_m: Some(30.0), ..ad_hoc() };
        let mut channel = Channel::new(radio, 4, &Seed::of_run(3));
        for (station, x) in [(0, 0.0), (1, 10.0), (2, gap_m), (3, gap_m + 10.0)] {
            channel.place(station, Vec2::new(x, 0.0));
        }
        channel.saturate(Time::ZERO, 0, Destination::One(1), 200, ());
        channel.saturate(Time::ZERO, 2, Destination::One(3), 200, ());
        channel.wake(at_s(5.0), &mut Vec::new());
        channel.counts(at_s(5.0))
    };
    let (shared, apart) = (run(15.0), run(100.0));
    assert!(apart.arrived as f64 > 1.6 * shared.arrived as f64, "{} and {}", apart.arrived, shared.arrived);
    assert_eq!(apart.collided, 0);
}

#[test]
fn an_access_point_in_a_place_hears_stations_that_are_hidden_from_each_other() {
    let at = |sense_m: f32| {
        let radio = Radio { sense_m: Some(sense_m), access_point_m: Some([25.0, 0.0]), ..Radio::default() };
        two_to_the_middle(&radio, LINE)
    };
    let (hidden, near) = (at(30.0), at(60.0));
    assert!(hidden.collided > 4 * near.collided.max(1), "{hidden:?}\n{near:?}");
    assert_eq!(near.arrived, 4000);
}

#[test]
fn a_lost_acknowledgement_repeats_the_frame_and_delivers_it_once() {
    // What reaches the receiver at 6 Mbit/s is too weak for an acknowledgement at 54 on its way back.
    let rate = |name: &str| name.parse().expect("a rate");
    let powers = Powers { detect_db: 0.0, detect_dbm: -100.0, sense_dbm: -100.0, ..Powers::default() };
    let radio = Radio { rate: rate("ofdm-6"), ack_rate: rate("ofdm-54"), powers: Some(powers), ..ad_hoc() };
    let mut channel: Channel<u32> = Channel::new(radio, 2, &Seed::of_run(1));
    channel.place(0, Vec2::new(0.0, 0.0));
    channel.place(1, Vec2::new(110.0, 0.0));
    let mut arrived = Vec::new();
    channel.offer(Time::ZERO, 0, Destination::One(1), 200, 7);
    channel.wake(at_s(1.0), &mut arrived);
    let counts = channel.counts(at_s(1.0));
    assert_eq!((arrived.len(), counts.transmissions, counts.lost()), (1, 8, 0), "{counts:?}");
}

#[test]
fn a_wall_keeps_frames_from_the_next_room() {
    let powers = Powers { wall_db: 60.0, ..Powers::default() };
    let reached = |walls: Vec<Vec<[f32; 2]>>| {
        let mut channel = Channel::new(Radio { powers: Some(powers.clone()), ..ad_hoc() }, 3, &Seed::of_run(1));
        for (station, x) in [(0, 0.0), (1, 4.0), (2, 8.0)] {
            channel.place(station, Vec2::new(x, 0.0));
        }
        channel.wall_in(walls);
        let mut arrived = Vec::new();
        channel.offer(Time::ZERO, 0, Destination::Many(Arc::new([0, 1, 2])), 200, ());
        channel.wake(at_s(1.0), &mut arrived);
        arrived.iter().map(|one| one.to).collect::<Vec<_>>()
    };
    assert_eq!(reached(Vec::new()), [1, 2]);
    assert_eq!(reached(vec![vec![[6.0, -3.0], [6.0, 3.0]]]), [1]);
    // A thick one counts once.
    assert_eq!(reached(vec![vec![[5.0, -3.0], [6.0, -3.0], [6.0, 3.0], [5.0, 3.0]]]), [1]);
}

#[test]
fn a_station_finds_a_rate_for_each_receiver() {
    let powers = Powers { detect_db: 0.0, detect_dbm: -100.0, sense_dbm: -100.0, ..Powers::default() };
    let run = |adaptation: Adaptation| {
        let mut channel =
            Channel::new(Radio { adaptation, powers: Some(powers.clone()), ..ad_hoc() }, 3, &Seed::of_run(1));
        for (station, x) in [(0, 0.0), (1, 10.0), (2, 90.0)] {
            channel.place(station, Vec2::new(x, 0.0));
        }
        let mut arrived = Vec::new();
        for number in 0..2000_u32 {
            let now = at_s(0.01 * f64::from(number + 1));
            channel.wake(now, &mut arrived);
            channel.offer(now, 0, Destination::One(1 + (number % 2) as u16), 200, ());
        }
        channel.wake(at_s(30.0), &mut arrived);
        [1, 2].map(|to| arrived.iter().filter(|one| one.to == to).count())
    };
    assert_eq!(run(Adaptation::Fixed), [1000, 0], "54 Mbit/s does not reach so far");
    assert_eq!(run(Adaptation::Minstrel), [1000, 1000]);
}

#[test]
fn beacons_take_a_hundredth_of_a_slow_channel() {
    for channel in [Topology::AdHoc, Topology::Infrastructure] {
        let mut channel: Channel<()> =
            Channel::new(Radio { channel, beacon_ms: 102.4, ..Radio::default() }, 5, &Seed::of_run(1));
        channel.wake(at_s(60.0), &mut Vec::new());
        let counts = channel.counts(at_s(60.0));
        assert_eq!((counts.transmissions, counts.wanted, counts.lost()), (585, 0, 0));
        assert!((counts.airtime() - 0.011).abs() < 0.002, "{}", counts.airtime());
    }
}

#[test]
fn a_channel_with_space_continues_from_where_it_was_stored() {
    let powers = Powers { shadowing_db: 4.0, ..Powers::default() };
    let radio = Radio { powers: Some(powers), adaptation: Adaptation::Minstrel, ..ad_hoc() };
    let mut channel: Channel<u32> = Channel::new(radio, 6, &Seed::of_run(4));
    for station in 0..6 {
        channel.place(station, Vec2::new(12.0 * f32::from(station), 0.0));
    }
    let run = |channel: &mut Channel<u32>, steps: std::ops::Range<u32>| {
        let mut arrived = Vec::new();
        for step in steps {
            let now = at_s(0.0004 * f64::from(step + 1));
            channel.wake(now, &mut arrived);
            channel.offer(now, (step % 6) as u16, Destination::One(((step + 1) % 6) as u16), 200, step);
        }
        arrived
    };
    run(&mut channel, 0..500);
    let stored = rmp_serde::to_vec_named(&channel).expect("a channel is stored");
    let mut again: Channel<u32> = rmp_serde::from_slice(&stored).expect("what was stored");
    let (first, second) = (run(&mut channel, 500..1500), run(&mut again, 500..1500));
    assert!(first.len() > 300, "{}", first.len());
    assert_eq!(first, second);
}

#[test]
fn robots_of_a_run_lose_what_is_sent_far_from_them() {
    // The power at 1 m is -24 dBm, and robots of the passage are up to 3 m apart.
    let lost = |detect_dbm: f64| {
        let powers = Powers { detect_dbm, sense_dbm: -60.0, ..Powers::default() };
        let mut trial = Trial::preset("onboard-adhoc", "passage").expect("a preset").seed(5);
        trial.deployment = trial.deployment.with_radio(&Radio { powers: Some(powers), ..ad_hoc() });
        trial.run().totals.radio.lost_range
    };
    let (far, near) = (lost(-33.0), lost(-60.0));
    assert!(near == 0 && far > 500, "{far} and {near}");
}
