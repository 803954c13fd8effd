//! The radio channel against the standard and the literature: Bianchi's saturation model, retries, relays, queues,
//! range and determinism.

use std::sync::Arc;

use murmurate::deploy::{Deployment, LinkMedium, MODES};
use murmurate::messages::geometry::Vec2;
use murmurate::net::media::radio::bianchi::Saturation;
use murmurate::net::media::radio::{Channel, Counting, Delivery, Destination, Radio, RadioCounts, Recovery, Topology};
use murmurate::random::Seed;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;

fn seed(number: u64) -> Seed {
    Seed::of_run(number).child("radio")
}

fn at_s(s: f64) -> Time {
    Time::ZERO + Span::from_secs(s)
}

/// Runs a saturated channel: every station always has a frame for the next station.
fn saturated(radio: &Radio, stations: u16, bytes: usize, lasts_s: f64) -> RadioCounts {
    let mut channel = Channel::new(radio.clone(), stations, &seed(1));
    for station in 0..stations {
        channel.saturate(Time::ZERO, station, Destination::One((station + 1) % stations), bytes, ());
    }
    channel.wake(at_s(lasts_s), &mut Vec::new());
    channel.counts(at_s(lasts_s))
}

fn ad_hoc() -> Radio {
    Radio { channel: Topology::AdHoc, ..Radio::default() }
}

/// Bianchi's Table II with a payload of 8184 bits (JSAC 18(3), 2000).
const PAYLOAD_BYTES: usize = 1023;

#[test]
fn saturation_is_as_in_bianchis_model() {
    // Bianchi's backoff counts busy slots, as EDCA does; the older DCF rule must not be far from it.
    for (stages, counting) in [(3, Counting::Edca), (5, Counting::Edca), (3, Counting::Dcf), (5, Counting::Dcf)] {
        let radio = Radio { counting, ..Radio::bianchi(stages) };
        for stations in [2, 5, 10, 20, 50] {
            let model = Saturation::of_radio(&radio, usize::from(stations), PAYLOAD_BYTES);
            let seconds = 2000.0;
            let counts = saturated(&radio, stations, PAYLOAD_BYTES, seconds);
            let throughput = counts.arrived as f64 * 8184e-6 / seconds;
            let collision = counts.collided as f64 / counts.transmissions as f64;
            println!(
                "{counting:?}, m = {stages}, n = {stations:2}: throughput {throughput:.4} model {:.4} ({:+.2} %), \
                 p {collision:.4} model {:.4}",
                model.throughput,
                100.0 * (throughput / model.throughput - 1.0),
                model.collision
            );
            assert!((throughput / model.throughput - 1.0).abs() < 0.03, "n = {stations}, m = {stages}");
            assert!((collision - model.collision).abs() < 0.02, "n = {stations}, m = {stages}");
        }
    }
}

#[test]
fn saturation_with_few_retries_is_as_in_the_model() {
    for (retries, stations) in [(1, 5), (1, 10), (3, 10), (7, 10)] {
        let radio = Radio { retries, after_error: Recovery::Difs, ..ad_hoc() };
        let model = Saturation::of_radio(&radio, usize::from(stations), 200);
        let counts = saturated(&radio, stations, 200, 20.0);
        let carried = counts.arrived as f64 / 20.0;
        let collision = counts.collided as f64 / counts.transmissions as f64;
        println!("{retries} retries, n = {stations}: {carried:.0}/s model {:.0}/s", model.frames_per_s);
        assert!((carried / model.frames_per_s - 1.0).abs() < 0.03, "{carried} and {model:?}");
        assert!((collision - model.collision).abs() < 0.02, "{collision} and {model:?}");
    }
}

/// Returns the arrivals of `frames` frames, each offered long after the previous one.
fn one_by_one(channel: &mut Channel<u32>, frames: u32, to: &Destination, bytes: usize) -> Vec<Delivery<u32>> {
    let mut arrived = Vec::new();
    for frame in 0..frames {
        let now = at_s(0.1 * f64::from(frame + 1));
        channel.wake(now, &mut arrived);
        channel.offer(now, 0, to.clone(), bytes, frame);
    }
    channel.wake(at_s(0.1 * f64::from(frames + 2)), &mut arrived);
    arrived
}

#[test]
fn unicast_is_retransmitted_up_to_the_retry_limit() {
    for retries in [1, 3, 5, 7] {
        let radio = Radio { retries, noise_loss: 0.5, ..ad_hoc() };
        let mut channel = Channel::new(radio, 2, &seed(2));
        let frames = 20_000;
        one_by_one(&mut channel, frames, &Destination::One(1), 200);
        let counts = channel.counts(at_s(3000.0));
        let expected = 0.5_f64.powi(1 + retries.cast_signed());
        let lost = counts.lost_retries as f64 / f64::from(frames);
        assert!((lost - expected).abs() < 0.2 * expected + 0.002, "{lost} of {expected} lost with {retries} retries");
        assert_eq!(counts.arrived + counts.lost(), counts.wanted);
        // Out of reach, every frame is on the air once and `retries` times more.
        let mut channel = Channel::new(Radio { retries, range_m: Some(1.0), ..ad_hoc() }, 2, &seed(2));
        channel.place(0, Vec2::new(0.0, 0.0));
        channel.place(1, Vec2::new(1.5, 0.0));
        assert!(one_by_one(&mut channel, 10, &Destination::One(1), 200).is_empty());
        assert_eq!(channel.counts(at_s(1.0)).transmissions, 10 * u64::from(1 + retries));
    }
}

#[test]
fn a_relay_takes_two_airtimes() {
    let once = |radio: &Radio, to: &Destination| {
        let mut channel = Channel::new(radio.clone(), 3, &seed(3));
        let arrived = one_by_one(&mut channel, 1, to, 300);
        (arrived.len(), channel.counts(at_s(1.0)))
    };
    let infra = Radio::default();
    let (unicast, acknowledged) = (infra.frame_airtime(300), infra.times().acknowledged);
    let (arrived, counts) = once(&infra, &Destination::One(1));
    assert_eq!((arrived, counts.transmissions), (1, 2));
    assert_eq!(counts.airtime_ns, ((unicast + acknowledged) * 2).as_nanos());
    let all = Destination::Many(Arc::new([0, 1, 2]));
    let (arrived, counts) = once(&infra, &all);
    assert_eq!((arrived, counts.transmissions), (2, 2), "its sender is not among those that hear it");
    assert_eq!(counts.airtime_ns, (unicast + acknowledged + infra.multicast_airtime(300)).as_nanos());
    let (arrived, counts) = once(&ad_hoc(), &all);
    assert_eq!((arrived, counts.transmissions), (2, 1));
    assert_eq!(counts.airtime_ns, infra.multicast_airtime(300).as_nanos());
}

#[test]
fn a_frame_on_an_idle_channel_takes_its_airtime_and_less_than_a_slot() {
    let radio = ad_hoc();
    let mut channel = Channel::new(radio.clone(), 2, &seed(4));
    for delivery in one_by_one(&mut channel, 50, &Destination::One(1), 300) {
        let took = delivery.at.since(at_s(0.1 * f64::from(delivery.token + 1)));
        let airtime = radio.frame_airtime(300);
        assert!(took >= airtime && took < airtime + radio.times().slot, "{took}");
    }
}

#[test]
fn a_full_queue_drops_the_newest_frames() {
    let radio = Radio { queue: 4, ..ad_hoc() };
    let mut channel = Channel::new(radio, 2, &seed(5));
    (0..10).for_each(|frame| channel.offer(Time::ZERO, 0, Destination::One(1), 300, frame));
    let mut arrived = Vec::new();
    channel.wake(at_s(1.0), &mut arrived);
    assert_eq!(arrived.iter().map(|delivery| delivery.token).collect::<Vec<_>>(), [0, 1, 2, 3]);
    assert_eq!(channel.counts(at_s(1.0)).lost_queue, 6);
}

#[test]
fn an_access_point_has_its_own_queue() {
    // Frames go to the access point at 54 Mbit/s and from it at one: it is the bottleneck.
    let radio = Radio { queue: 8, ..Radio::default() };
    let mut channel = Channel::new(radio, 3, &seed(6));
    let all: Arc<[u16]> = Arc::new([0, 1, 2]);
    let mut arrived = Vec::new();
    for step in 0..4000 {
        let now = at_s(0.001 * f64::from(step));
        channel.wake(now, &mut arrived);
        channel.offer(now, 0, Destination::Many(Arc::clone(&all)), 300, ());
    }
    let end = at_s(10.0);
    channel.wake(end, &mut arrived);
    let counts = channel.counts(end);
    assert!(counts.lost_queue > 1000, "{counts:?}");
    assert_eq!(counts.arrived + counts.lost(), counts.wanted, "nothing is lost without a cause: {counts:?}");
    assert_eq!(counts.arrived, arrived.len() as u64);
}

#[test]
fn a_ranged_multicast_reaches_stations_within_range() {
    let mut channel = Channel::new(Radio { range_m: Some(2.0), ..ad_hoc() }, 4, &seed(7));
    for (station, x) in [(0, 0.0), (1, 1.5), (2, 2.5)] {
        channel.place(station, Vec2::new(x, 0.0));
    }
    // Station 3 has no known position, so it is within everyone's range.
    let all = Destination::Many(Arc::new([0, 1, 2, 3]));
    let reached = |arrived: &[Delivery<u32>]| arrived.iter().map(|delivery| delivery.to).collect::<Vec<_>>();
    assert_eq!(reached(&one_by_one(&mut channel, 1, &all, 100)), [1, 3]);
    assert_eq!(channel.counts(at_s(1.0)).lost_range, 1);
}

#[test]
fn noise_corrupts_multicast_at_each_receiver_independently() {
    let mut channel = Channel::new(Radio { noise_loss: 0.16, ..ad_hoc() }, 3, &seed(8));
    let arrived = one_by_one(&mut channel, 5000, &Destination::Many(Arc::new([1, 2])), 100);
    let share = arrived.len() as f64 / 10_000.0;
    assert!((share - 0.84).abs() < 0.015, "{share}");
    let both = arrived.windows(2).filter(|pair| pair[0].token == pair[1].token).count() as f64 / 5000.0;
    assert!((both - 0.84 * 0.84).abs() < 0.02, "{both}");
    assert_eq!(channel.counts(at_s(1.0)).lost_noise, 10_000 - arrived.len() as u64);
}

#[test]
fn background_frames_take_their_share_of_the_channel() {
    let mut channel: Channel<()> = Channel::new(Radio { background: 0.3, ..ad_hoc() }, 2, &seed(9));
    channel.wake(at_s(60.0), &mut Vec::new());
    let counts = channel.counts(at_s(60.0));
    let share = counts.foreign_ns as f64 / counts.channel_ns as f64;
    assert!((share - 0.3).abs() < 0.01, "{share}");
    assert_eq!((counts.airtime_ns, counts.transmissions), (0, 0));
}

#[test]
fn a_channel_is_deterministic_and_depends_on_its_seed() {
    let run = |number: u64| {
        let radio = Radio { noise_loss: 0.1, background: 0.2, counting: Counting::Dcf, ..Radio::default() };
        let mut channel = Channel::new(radio, 5, &seed(number));
        let all: Arc<[u16]> = Arc::new([0, 1, 2, 3, 4]);
        let mut arrived = Vec::new();
        for step in 0..2000_u32 {
            let now = at_s(0.0007 * f64::from(step));
            channel.wake(now, &mut arrived);
            channel.offer(now, (step % 5) as u16, Destination::Many(Arc::clone(&all)), 250, step);
        }
        channel.wake(at_s(3.0), &mut arrived);
        (arrived, channel.counts(at_s(3.0)))
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn a_radio_is_put_on_every_wireless_link() {
    for mode in MODES {
        let preset = Deployment::preset(mode, 5).unwrap();
        let near = Radio { range_m: Some(2.0), ..ad_hoc() };
        let deployment = preset.clone().with_radio(&near);
        assert_eq!(deployment.check(), Ok(()), "{mode}");
        assert_eq!(Deployment::from_toml(&deployment.to_toml()), Ok(deployment.clone()), "{mode}");
        for link in &deployment.links {
            let expected = match link.medium {
                LinkMedium::Cable | LinkMedium::Loopback => None,
                LinkMedium::AdHoc => Some((Topology::AdHoc, Some(2.0))),
                LinkMedium::AccessPoint => Some((Topology::Infrastructure, None)),
            };
            assert_eq!(link.radio.as_ref().map(|radio| (radio.channel, radio.range_m)), expected, "{mode}");
        }
    }
    let broken = |change: fn(&mut Deployment)| {
        let mut deployment = Deployment::preset("onboard-adhoc", 5).unwrap().with_radio(&Radio::default());
        change(&mut deployment);
        deployment.check().unwrap_err().to_string()
    };
    assert!(broken(|d| d.links[0].radio.as_mut().unwrap().queue = 0).starts_with("link.radio.queue: 0"));
    assert!(broken(|d| d.links[2].radio = Some(Radio::default())).starts_with("link.radio: 'wires'"));
}

#[test]
fn a_team_on_a_radio_is_deterministic_and_loses_the_frames_of_the_radio() {
    let run = |radio: Option<Radio>| {
        let mut trial = Trial::preset("onboard-adhoc", "passage").expect("a preset").seed(5);
        trial.deployment = match &radio {
            Some(radio) => trial.deployment.with_radio(radio),
            None => trial.deployment,
        };
        let report = trial.run();
        assert!(report.finished);
        (report.totals, report.episodes)
    };
    let wifi = run(Some(Radio::default()));
    assert_eq!(wifi, run(Some(Radio::default())));
    let ideal = run(None);
    assert_ne!(wifi.0.trace, ideal.0.trace, "a frame takes its time");
    assert_eq!(ideal.0.radio, RadioCounts::default());
    let counts = wifi.0.radio;
    assert!(counts.arrived > 1000 && counts.lost() * 50 < counts.wanted, "{counts:?}");
    assert!(counts.airtime() > 0.05 && counts.airtime() < 0.5, "{counts:?}");
    // With a range, frames to robots beyond it are lost.
    let near = run(Some(Radio { range_m: Some(0.7), ..ad_hoc() })).0.radio;
    assert!(near.lost_range > counts.wanted / 10, "{near:?}");
    assert_eq!(counts.lost_range, 0);
}
