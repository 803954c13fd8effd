//! Reliability by kind over a lossy link: delivery, delay and number of datagrams; and the cost of soft state.

use std::collections::BTreeMap;

use crate::rig;
use crate::rig::{Rig, heartbeat, is_data, latent};
use murmurate::messages::ids::HostId;
use murmurate::messages::wire::{Kind, Wire};
use murmurate::net::protocol::reliability::{Reliabilities, Reliability};
use murmurate::time::{Span, Time};

fn kinds(latent: Reliability) -> Reliabilities {
    Reliabilities::from([(Kind::Latent, latent)])
}

/// Outcome of a run: shares delivered at all and within 20 ms, and data datagrams per message.
#[derive(Debug)]
struct Outcome {
    delivered: f64,
    in_20_ms: f64,
    datagrams: f64,
}

/// Makes every host send messages at this rate for some seconds, out of phase; the first second does not count.
fn run(rig: &mut Rig, per_s: u64, seconds: u64) -> Outcome {
    let hosts = rig.networks.len() as u64;
    let period = Span::from_nanos(1_000_000_000 / per_s);
    let (mut said, mut from) = (BTreeMap::new(), rig.now);
    let start = rig.now;
    rig.delivered.iter_mut().for_each(Vec::clear);
    for step in 0..per_s * (seconds + 1) {
        for host in 0..hosts {
            let at = start + period * step + Span::from_nanos(period.as_nanos() * host / hosts);
            rig.run_to(at);
            if step == per_s {
                from = from.max(rig.now);
            }
            rig.publish(host as usize, latent(host as u16, step as u32));
            said.insert((host as u16, step as u32), rig.now);
        }
    }
    let end = rig.now + Span::from_millis(500);
    rig.run_to(end);
    said.retain(|_, at| *at >= from);
    let mut delays = Vec::new();
    for (host, got) in rig.delivered.iter().enumerate() {
        for (at, message) in got {
            let Wire::Latent(latent) = message else { continue };
            assert_ne!(usize::from(latent.robot.0), host);
            delays.extend(said.get(&(latent.robot.0, latent.round.episode)).map(|said| at.since(*said)));
        }
    }
    let all = (said.len() as u64 * (hosts - 1)) as f64;
    let timely = delays.iter().filter(|delay| **delay <= Span::from_millis(20)).count();
    let sent = rig.sent.iter().filter(|flight| flight.at >= from && is_data(&flight.frame)).count();
    Outcome {
        delivered: delays.len() as f64 / all,
        in_20_ms: timely as f64 / all,
        datagrams: sent as f64 / said.len() as f64,
    }
}

#[test]
fn repeats_deliver_nearly_everything_at_20_percent_loss_and_cost_nothing_without_loss() {
    for per_s in [20, 60, 500] {
        let mut rig = Rig::team(5, kinds(Reliability::Repeat));
        rig.meet();
        let whole = run(&mut rig, per_s, 4);
        assert_eq!((whole.in_20_ms, whole.datagrams), (1.0, 1.0), "{per_s}/s without loss");
        rig.loss = 0.2;
        let lossy = run(&mut rig, per_s, 8);
        println!("repeat, {per_s}/s, 20 % loss: {lossy:?}");
        assert!(lossy.in_20_ms >= 0.95 && lossy.datagrams <= 2.1, "{per_s}/s: {lossy:?}");
    }
    let mut rig = Rig::team(5, Reliabilities::new());
    rig.meet();
    rig.loss = 0.2;
    let best_effort = run(&mut rig, 60, 8);
    assert!((0.77..0.83).contains(&best_effort.delivered) && best_effort.datagrams == 1.0, "{best_effort:?}");
}

#[test]
fn repeats_begin_within_half_a_second_of_loss_and_end_after_it() {
    let mut rig = Rig::team(5, kinds(Reliability::Repeat));
    rig.meet();
    run(&mut rig, 60, 1);
    let lossy = rig.now;
    rig.loss = 0.2;
    rig.sent.clear();
    run(&mut rig, 60, 2);
    let copy = |flight: &&rig::Flight| flight.from == 0 && flight.frame[1] & 4 != 0;
    let first = rig.sent.iter().find(copy).expect("it repeats").at;
    assert!(first.since(lossy) <= Span::from_millis(500), "after {}", first.since(lossy));
    rig.loss = 0.0;
    run(&mut rig, 60, 5);
    let quiet = rig.now;
    let end = run(&mut rig, 60, 1);
    assert_eq!(end.datagrams, 1.0, "after {quiet}");
}

#[test]
fn a_queue_ends_repeats_and_a_long_way_does_not() {
    let far = Span::from_millis(60);
    let mut rig = Rig::team(5, kinds(Reliability::Repeat));
    rig.meet();
    rig.loss = 0.2;
    let near = run(&mut rig, 20, 4);
    assert!(near.datagrams > 1.8, "{near:?}");
    let usual = std::mem::replace(&mut rig.delay, far);
    run(&mut rig, 20, 3);
    let queued = run(&mut rig, 20, 4);
    assert_eq!(queued.datagrams, 1.0, "a queue, in place of noise, may be what loses them");
    rig.delay = usual;
    run(&mut rig, 20, 12);
    let after = run(&mut rig, 20, 4);
    assert!(after.datagrams > 1.8, "{after:?}");
    let mut rig = Rig::team(5, kinds(Reliability::Repeat));
    rig.delay = far;
    rig.meet();
    rig.loss = 0.2;
    run(&mut rig, 20, 2);
    let away = run(&mut rig, 20, 4);
    assert!(away.datagrams > 1.8, "{away:?}");
}

#[test]
fn requested_datagrams_are_retransmitted_unless_superseded() {
    let mut rig = Rig::team(5, kinds(Reliability::Nack));
    rig.meet();
    rig.loss = 0.2;
    let slow = run(&mut rig, 1, 40);
    println!("nack, 1/s, 20 % loss: {slow:?}");
    assert!(slow.delivered >= 0.98 && slow.datagrams < 2.0, "{slow:?}");
    let mut rig = Rig::team(5, kinds(Reliability::Nack));
    rig.meet();
    let whole = run(&mut rig, 60, 2);
    assert_eq!((whole.delivered, whole.datagrams), (1.0, 1.0));
    let requests = rig.sent.iter().filter(|flight| flight.at > Time::ZERO + Span::from_millis(200));
    assert_eq!(requests.filter(|flight| flight.frame[14] == 0x82).count(), 0, "nothing is missing");
}

#[test]
fn unacknowledged_datagrams_are_retransmitted_up_to_a_limit() {
    let mut rig = Rig::team(5, kinds(Reliability::Ack));
    rig.meet();
    let whole = run(&mut rig, 20, 3);
    assert_eq!((whole.delivered, whole.datagrams), (1.0, 1.0));
    rig.loss = 0.2;
    let lossy = run(&mut rig, 20, 8);
    println!("ack, 20/s, 20 % loss: {lossy:?}");
    assert!(lossy.delivered >= 0.98, "{lossy:?}");
    rig.loss = 1.0;
    rig.publish(0, latent(0, 9999));
    let before = rig.sent.len();
    let end = rig.now + Span::from_millis(3000);
    rig.run_to(end);
    let retries = rig.sent[before..].iter().filter(|flight| flight.from == 0 && is_data(&flight.frame)).count();
    assert_eq!(retries, 5, "and no more");
    assert!(rig.counted(0).lapsed >= 1);
}

/// Returns the rate of host 1's datagrams with soft state alone, over ten seconds of heartbeats \[1/s\].
fn soft(per_s: Option<u64>) -> f64 {
    let mut rig = Rig::team(5, Reliabilities::new());
    rig.meet();
    rig.sent.clear();
    for ms in (0..10_000).step_by(10) {
        if ms % 200 == 0 {
            (1..5u16).for_each(|host| rig.publish(usize::from(host), heartbeat(host, ms)));
        }
        if per_s.is_some_and(|per_s| ms % (1000 / per_s as u32) == 0) {
            (1..5u16).for_each(|host| rig.publish(usize::from(host), latent(host, ms)));
        }
        let next = rig.now + Span::from_millis(10);
        rig.run_to(next);
    }
    let beats = rig.delivered[0].iter().filter(|(_, message)| message.kind() == Kind::Heartbeat).count();
    assert!(beats >= 4 * 49, "{beats} of 200 heartbeats got through");
    let count = rig.sent.iter().filter(|flight| flight.from == 1 && !is_data(&flight.frame)).count();
    count as f64 / 10.0
}

#[test]
fn soft_state_is_piggybacked_on_data_and_costs_little_alone() {
    let (alone, riding) = (soft(None), soft(Some(20)));
    assert!(alone <= 5.1, "{alone} a second without data");
    assert!(riding <= 0.2, "{riding} a second beside data");
}

#[test]
fn hosts_measure_loss_and_round_trip_time_to_each_other() {
    let mut rig = Rig::team(3, Reliabilities::new());
    rig.loss = 0.1;
    rig.meet();
    run(&mut rig, 60, 5);
    rig.counted(0);
    assert_eq!(rig.peers[0].len(), 2);
    for peer in &rig.peers[0] {
        let (round_trip, uncertainty) = (peer.round_trip_s.unwrap(), peer.uncertainty_s.unwrap());
        assert!((round_trip - 600e-6).abs() < 10e-6 && uncertainty < 1e-3, "{peer:?}");
        assert!(peer.accepted && peer.missing > 0, "{peer:?}");
        assert_ne!(HostId(peer.host), HostId(0));
    }
}

#[test]
fn hosts_that_start_together_accept_each_other_at_the_second_message() {
    let mut rig = Rig::team(50, Reliabilities::new());
    rig.delay = Span::from_nanos(200_000);
    for hello in 0..3u32 {
        for host in 0..50u16 {
            rig.publish(usize::from(host), latent(host, hello));
            let next = rig.now + Span::from_nanos(100_000);
            rig.run_to(next);
        }
        let next = Time::ZERO + Span::from_millis(500) * u64::from(hello + 1);
        rig.run_to(next);
        let heard = |host: usize| {
            let robots: std::collections::BTreeSet<u16> =
                rig.delivered[host].iter().map(|(_, message)| message.robot().0).collect();
            robots.len()
        };
        let whole = (0..50).filter(|host| heard(*host) == 49).count();
        println!("after hello {hello}: {whole} of 50 hear all others; {} datagrams", rig.sent.len());
        assert!(hello == 0 || whole == 50, "{whole} of 50 hear everyone");
    }
    assert!(rig.sent.len() <= 500, "{} datagrams", rig.sent.len());
    assert!(rig.sent.iter().all(|flight| flight.bytes <= 1200));
}
