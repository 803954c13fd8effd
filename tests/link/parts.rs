//! Messages in parts between five hosts on a lossy multicast link: how many are whole within their period, at what
//! cost, and what else the link carries meanwhile.

use crate::rig::{LINK, Rig, config, key, latent, multicast};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Encoding, Features, Form, Kind, Latent, Missing, Stop, Wire};
use murmurate::net::media::radio::{Channel, Radio, Topology};
use murmurate::net::protocol::codec::{self, Content};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::parts::Settings;
use murmurate::net::protocol::reliability::{Reliabilities, Reliability, Setup};
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::random::{RngExt, Seed};
use murmurate::time::{Span, Time};

const HOSTS: u16 = 5;
/// Size of the messages of CoViS-Net, from cameras.
const FLOATS: usize = 6144;
const PERIOD: Span = Span::from_millis(100);
/// Bytes of a message's floats with 16 bits each.
const BYTES: u64 = 2 * FLOATS as u64;

fn settings(missing: Missing) -> Settings {
    Settings { form: Form { encoding: Encoding::F16, missing }, floats: FLOATS, period: PERIOD, policy: 0xabcd }
}

fn team(key: &Key, setup: &dyn Fn(Reliabilities) -> Setup, mode: Reliability, missing: Missing) -> Rig {
    let kinds = || Reliabilities::from([(Kind::Latent, mode)]);
    let member = |host| config(host, HOSTS.into(), 1, Some(key.clone()), setup(kinds()));
    let parts = Some(settings(missing));
    Rig::new((0..HOSTS).map(|host| murmurate::actors::network::Config { parts, ..member(host) }))
}

/// Message number `number` of a robot; its floats say which it is.
fn wide(robot: u16, number: u32) -> Wire {
    let Wire::Latent(small) = latent(robot, 7) else { unreachable!("it is a latent") };
    let own = f32::from(robot) * 2.0 + (number % 2) as f32;
    let features = Features((0..FLOATS).map(|at| own + (at % 64) as f32).collect());
    Wire::Latent(Latent { features, ..small })
}

/// What was received of `messages` messages of each host.
struct Heard {
    /// Share of the pairs of message and receiver that were whole within the period.
    whole: f64,
    /// Bytes sent for each byte of floats.
    bytes: f64,
    /// Longest time from publication to delivery [ms].
    longest_ms: f64,
}

fn run(rig: &mut Rig, loss: f64, messages: u32) -> Heard {
    rig.run_ms(2500);
    (rig.loss, rig.sent) = (loss, Vec::new());
    let begun = rig.now;
    rig.delivered.iter_mut().for_each(Vec::clear);
    let offset = Span::from_millis(13);
    let published = |number: u32, host: u16| begun + PERIOD * u64::from(number) + offset * u64::from(host);
    for number in 0..messages {
        for host in 0..HOSTS {
            rig.run_to(published(number, host));
            rig.publish(host.into(), wide(host, number));
        }
    }
    rig.run_to(published(messages, HOSTS));
    let (mut whole, mut longest_ms) = (0_u32, 0.0_f64);
    for (to, delivered) in rig.delivered.iter().enumerate() {
        for from in (0..HOSTS).filter(|from| usize::from(*from) != to) {
            for (at, message) in delivered {
                let Wire::Latent(message) = message else { continue };
                if message.robot != RobotId(from) {
                    continue;
                }
                let age = at.since(published(0, from)).as_secs();
                let number = (age / PERIOD.as_secs()) as u32;
                let age_s = at.since(published(number, from)).as_secs();
                let Wire::Latent(wanted) = wide(from, number) else { unreachable!("it is a latent") };
                assert_eq!(message.features, wanted.features, "it is the message of this period, and whole");
                (whole, longest_ms) = (whole + 1, longest_ms.max(1000.0 * age_s));
            }
        }
    }
    let sent: usize = rig.sent.iter().map(|flight| flight.bytes).sum();
    let pairs = f64::from(messages) * f64::from(HOSTS * (HOSTS - 1));
    let bytes = sent as f64 / (f64::from(messages) * f64::from(HOSTS) * BYTES as f64);
    Heard { whole: f64::from(whole) / pairs, bytes, longest_ms }
}

/// Messages of each host in a run; more with `MURMURATE_PARTS`.
fn messages() -> u32 {
    std::env::var("MURMURATE_PARTS").ok().and_then(|number| number.parse().ok()).unwrap_or(40)
}

#[test]
fn lost_parts_are_repaired_within_the_period() {
    for (loss, whole, bytes) in [(0.0, 0.999, 1.1), (0.05, 0.99, 1.4), (0.2, 0.95, 2.5)] {
        let mut rig = team(&key(), &multicast, Reliability::Nack, Missing::Whole);
        let heard = run(&mut rig, loss, messages());
        let Heard { whole: is, bytes: cost, longest_ms } = heard;
        println!("loss {loss}: whole {is:.4}, bytes x{cost:.3}, longest {longest_ms:.1} ms");
        assert!(is >= whole, "at a loss of {loss} {is:.4} of the messages are whole within the period");
        assert!(cost <= bytes, "at a loss of {loss} a byte costs {cost:.3}");
    }
}

#[test]
fn parts_are_repaired_over_unicast_links_too() {
    let mut rig = team(&key(), &Setup::unicast, Reliability::Nack, Missing::Whole);
    let heard = run(&mut rig, 0.05, messages());
    assert!(heard.whole >= 0.99, "{:.4} are whole within the period", heard.whole);
}

#[test]
fn a_link_that_repairs_nothing_loses_the_messages_of_lost_parts() {
    let mut rig = team(&key(), &multicast, Reliability::BestEffort, Missing::Whole);
    let heard = run(&mut rig, 0.05, messages());
    let expected = 0.95_f64.powi(12);
    assert!((heard.whole - expected).abs() < 0.06, "{:.3} are whole, {expected:.3} are to be expected", heard.whole);
    let asks = rig.sent.iter().any(|flight| has(&flight.frame, Content::Lacking));
    assert!(!asks && heard.bytes < 1.1, "no host asks");
}

fn has(frame: &[u8], content: Content) -> bool {
    codec::blocks(codec::untagged(frame)).flatten().any(|(other, _)| other == content)
}

#[test]
fn a_stop_leaves_between_two_parts() {
    let mut rig = team(&key(), &multicast, Reliability::Nack, Missing::Whole);
    rig.run_ms(2500);
    for host in 0..HOSTS {
        rig.publish(host.into(), wide(host, 0));
    }
    rig.run_ms(10);
    let (before, now) = (rig.sent.len(), rig.now);
    rig.publish(0, Wire::Stop(Stop::engage(HostId(0), Latch::default())));
    assert!(has(&rig.sent[before].frame, Content::Message(Kind::Stop)), "it is the next datagram");
    rig.run_ms(1);
    let heard =
        |host: usize| rig.delivered[host].iter().any(|(at, message)| matches!(message, Wire::Stop(_)) && *at > now);
    assert!((1..usize::from(HOSTS)).all(heard));
    rig.run_ms(60);
    let whole =
        |host: usize| rig.delivered[host].iter().filter(|(_, message)| matches!(message, Wire::Latent(_))).count();
    assert!((0..usize::from(HOSTS)).all(|host| whole(host) == 4), "and the messages go on");
}

/// Returns the delays [ms], in rising order, with which stops of host 0 reach the others over a radio channel whose
/// multicast has 24 Mbit/s. The hosts send messages of `floats` floats ten times a second meanwhile, each at a
/// time of its own within the period.
fn delays_of_stops(floats: Option<usize>) -> Vec<f64> {
    let mut rig = team(&key(), &multicast, Reliability::Nack, Missing::Whole);
    let radio = Radio { channel: Topology::AdHoc, basic_rate: "ofdm-24".parse().expect("a rate"), ..Radio::default() };
    rig.radio = Some(Channel::new(radio, HOSTS, &Seed::of_run(3)));
    rig.run_ms(2500);
    let mut stream = Seed::of_run(4).stream("stops");
    let (begun, seconds) = (rig.now, 60_u64);
    let mut events: Vec<(Time, u16, Option<u32>)> = Vec::new();
    for host in 0..HOSTS {
        let phase = Span::from_secs(0.1 * stream.random::<f64>());
        let number = |number: u32| (begun + phase + PERIOD * u64::from(number), host, Some(number));
        events.extend((0..10 * seconds as u32).map(number).filter(|_| floats.is_some()));
    }
    let at = |number: u64| Span::from_secs(0.03 * (number as f64 + 0.5 * stream.random::<f64>()));
    let stops: Vec<Time> = (0..seconds * 100 / 3).map(at).map(|after| begun + after).collect();
    events.extend(stops.iter().map(|at| (*at, 0, None)));
    events.sort();
    let (mut delays, mut latches) = (Vec::new(), vec![Latch::default()]);
    rig.delivered.iter_mut().for_each(Vec::clear);
    for (at, host, number) in events {
        rig.run_to(at);
        match number {
            Some(number) => rig.publish(host.into(), wide(host, number)),
            None => {
                let stop = Stop::engage(HostId(host), latches[latches.len() - 1]);
                latches.push(stop.latch);
                rig.publish(host.into(), Wire::Stop(stop));
            }
        }
    }
    rig.run_ms(100);
    for (at, message) in rig.delivered.iter().flatten() {
        if let Wire::Stop(stop) = message {
            // The first one is that of before.
            let number = latches.iter().position(|latch| *latch == stop.latch).expect("it was sent");
            delays.push(1000.0 * at.since(stops[number - 1]).as_secs());
        }
    }
    delays.sort_by(f64::total_cmp);
    let pairs = stops.len() * usize::from(HOSTS - 1);
    println!("{} of {pairs} arrived", delays.len());
    delays
}

#[test]
fn on_a_radio_a_stop_waits_for_a_part_and_little_more() {
    let [without, with] = [None, Some(FLOATS)].map(delays_of_stops);
    let at = |delays: &[f64], share: f64| delays[(share * (delays.len() - 1) as f64) as usize];
    let radio = Radio { basic_rate: "ofdm-24".parse().expect("a rate"), ..Radio::default() };
    let part_ms = 1000.0 * radio.multicast_airtime(1100).as_secs();
    for share in [0.5, 0.9, 0.99, 1.0] {
        println!("{share}: {:.3} ms without, {:.3} ms with", at(&without, share), at(&with, share));
    }
    let later = at(&with, 0.99) - at(&without, 0.99);
    println!("a part takes {part_ms:.3} ms; the p99 of {} stops is {later:.3} ms later", with.len());
    assert!(later <= part_ms + 1.0, "{later:.3} ms later, with parts of {part_ms:.3} ms");
}

#[test]
fn messages_of_another_policy_are_never_used_and_counted() {
    let mut rig = team(&key(), &multicast, Reliability::Nack, Missing::Zero);
    let other = Settings { policy: 0xef01, ..settings(Missing::Zero) };
    let kinds = Reliabilities::from([(Kind::Latent, Reliability::Nack)]);
    let config = config(4, HOSTS.into(), 2, Some(key()), multicast(kinds));
    rig.restart(4, murmurate::actors::network::Config { parts: Some(other), ..config });
    run(&mut rig, 0.0, 3);
    for (host, delivered) in rig.delivered.iter().enumerate() {
        let from = |robot: u16| {
            let of = |message: &Wire| matches!(message, Wire::Latent(latent) if latent.robot == RobotId(robot));
            delivered.iter().filter(|(_, message)| of(message)).count()
        };
        let expected = |robot: u16| if host == 4 || robot == 4 || usize::from(robot) == host { 0 } else { 3 };
        assert!((0..HOSTS).all(|robot| from(robot) == expected(robot)), "host {host}");
    }
    assert_eq!((rig.counted(0).mixed, rig.counted(4).mixed), (36, 4 * 36));
}

#[test]
fn robots_of_one_host_hear_a_message_in_parts_once_and_as_a_whole() {
    let routes = |_: Kind, _: RobotId| Route { local: true, leaves: Some((LINK, Audience::All)) };
    let setup = multicast(Reliabilities::from([(Kind::Latent, Reliability::Nack)]));
    let both = config(0, 2, 1, Some(key()), setup);
    let both = murmurate::actors::network::Config {
        parts: Some(settings(Missing::Whole)),
        router: Router::new(2, routes),
        ..both
    };
    let mut rig = Rig::new([both]);
    rig.publish(0, wide(1, 0));
    rig.run_ms(100);
    let [(_, Wire::Latent(heard))] = &rig.delivered[0][..] else { panic!("{} messages", rig.delivered[0].len()) };
    assert_eq!((heard.features.0.len(), heard.part.is_none()), (FLOATS, true));
    assert!(rig.sent.len() >= 12);
}

#[test]
fn a_host_that_is_started_again_is_heard_with_its_first_message() {
    let mut rig = team(&key(), &multicast, Reliability::Nack, Missing::Whole);
    run(&mut rig, 0.0, 5);
    let kinds = Reliabilities::from([(Kind::Latent, Reliability::Nack)]);
    let again = config(0, HOSTS.into(), 2, Some(key()), multicast(kinds));
    rig.down = Some(0);
    rig.run_ms(1000);
    rig.down = None;
    rig.restart(0, murmurate::actors::network::Config { parts: Some(settings(Missing::Whole)), ..again });
    rig.run_ms(2500);
    rig.delivered.iter_mut().for_each(Vec::clear);
    rig.publish(0, wide(0, 0));
    rig.run_ms(60);
    assert!((1..usize::from(HOSTS)).all(|host| rig.delivered[host].len() == 1));
}
