//! Acceptance of senders: restarted hosts, recordings of former runs, delayed datagrams, two hosts with one id, and
//! operators that come and go.

use std::collections::BTreeMap;

use crate::rig;
use crate::rig::{Flight, LINK, Rig, TEAM, config, heartbeat, is_data, key, latent, report};
use murmurate::actors::network::{Config, Identity};
use murmurate::messages::ids::HostId;
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Kind, Stop, Wire};
use murmurate::net::protocol::codec::TAG_BYTES;
use murmurate::net::protocol::codec::{self, Frame};
use murmurate::net::protocol::reliability::{Reliabilities, Reliability, Setup};
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::random::Seed;
use murmurate::time::{Span, Time};
use rand::RngExt;

fn setup() -> Setup {
    Setup::multicast(Reliabilities::new())
}

/// Makes these hosts send heartbeats, and data marked with `data` if it is given, for this many milliseconds.
fn talk(rig: &mut Rig, hosts: &[usize], data: Option<u32>, ms: u64) {
    for _ in 0..ms.div_ceil(20) {
        for &host in hosts {
            let robot = rig.ids[host].0;
            let turn = rig.now.as_nanos() / 20_000_000 + host as u64 * 3;
            if turn.is_multiple_of(10) {
                rig.publish(host, heartbeat(robot, 1));
            }
            if let Some(mark) = data.filter(|_| turn.is_multiple_of(4)) {
                rig.publish(host, latent(robot, mark));
            }
        }
        rig.run_ms(20);
    }
}

/// Returns the number of messages with this mark that a host has received from a robot.
fn got(rig: &Rig, host: usize, robot: u16, mark: u32) -> usize {
    let marked = |message: &Wire| match message {
        Wire::Latent(latent) => latent.robot.0 == robot && latent.round.episode == mark,
        _ => false,
    };
    rig.delivered[host].iter().filter(|(_, message)| marked(message)).count()
}

#[test]
fn a_restarted_host_is_accepted_within_a_second_with_any_incarnation() {
    let mut stream = Seed::of_run(3).stream("restarts");
    let mut rig = Rig::team(5, Reliabilities::new());
    talk(&mut rig, &[0, 1, 2, 3, 4], Some(1), 2000);
    let mut worst = Span::ZERO;
    for restart in 0..20u32 {
        let mark = 100 + restart;
        let down: u64 = stream.random_range(0..500);
        talk(&mut rig, &[0, 2, 3, 4], Some(mark), down);
        let recorded = rig.sent.len();
        rig.restart(1, config(1, 5, stream.random_range(0..=u32::MAX), Some(key()), setup()));
        let began = rig.now;
        while [0, 2, 3, 4].iter().any(|host| got(&rig, *host, 1, mark) == 0) {
            talk(&mut rig, &[0, 1, 2, 3, 4], Some(mark), 20);
            assert!(rig.now.since(began) <= Span::from_millis(1000), "restart {restart} after {down} ms");
        }
        worst = worst.max(rig.now.since(began));
        talk(&mut rig, &[0, 1, 2, 3, 4], Some(mark), 1000);
        // Replay of all datagrams of its former incarnations.
        rig.delivered[0].clear();
        let former = rig.sent[..recorded].iter().filter(|flight| flight.from == 1);
        for frame in former.map(|flight| flight.frame.clone()).collect::<Vec<_>>() {
            rig.arrive(0, &frame);
        }
        assert!(rig.delivered[0].is_empty(), "restart {restart}: a recording is accepted");
    }
    println!("heard again by all at most {worst} after the start");
}

/// Counts of datagrams of a second live host with the id of another one, at each other host, and what they show of it.
fn duplicates(rig: &mut Rig, of: u16) -> Vec<(u64, u64)> {
    let shown = |rig: &Rig, host: usize| {
        rig.peers[host].iter().filter(|peer| peer.host == of).map(|peer| peer.duplicate_ids).sum::<u64>()
    };
    let others = (0..rig.ids.len()).filter(|host| rig.ids[*host].0 != of);
    others.collect::<Vec<_>>().into_iter().map(|host| (rig.counted(host).duplicate_id, shown(rig, host))).collect()
}

#[test]
fn a_host_that_is_killed_and_started_again_at_once_is_no_duplicate_whatever_is_still_in_transit() {
    let mut stream = Seed::of_run(9).stream("kills");
    for key in [Some(key()), None] {
        let own = |incarnation| config(1, 5, incarnation, key.clone(), setup());
        let mut rig = Rig::new((0..5).map(|host| config(host, 5, 1, key.clone(), setup())));
        talk(&mut rig, &[0, 1, 2, 3, 4], Some(1), 2000);
        for kill in 0..60u32 {
            // Half of them are killed again before they are accepted.
            let lives_ms = [60, 180, 700, 3000][kill as usize % 4];
            rig.jitter = Span::from_millis([0, 5, 100, 300][kill as usize / 4 % 4]);
            rig.loss = [0.0, 0.2][kill as usize % 2];
            rig.restart(1, own(stream.random_range(0..=u32::MAX)));
            talk(&mut rig, &[0, 1, 2, 3, 4], Some(kill), lives_ms);
            assert_eq!(duplicates(&mut rig, 1), [(0, 0); 4], "kill {kill} with a key: {}", key.is_some());
            assert_eq!(rig.duplicates, [None; 5], "and none ends");
        }
    }
}

#[test]
fn two_live_hosts_with_one_id_are_found_by_all_others_within_a_second() {
    for (key, ms) in [(Some(key()), 1000), (None, 2500)] {
        let own = |incarnation| config(1, 3, incarnation, key.clone(), setup());
        let other = |host| config(host, 3, 1, key.clone(), setup());
        let mut rig = Rig::new([other(0), own(1), other(2), config(9, 3, 1, None, setup())]);
        talk(&mut rig, &[0, 1, 2], Some(1), 5000);
        rig.restart(3, own(2));
        talk(&mut rig, &[0, 1, 2, 3], Some(1), ms);
        let found = duplicates(&mut rig, 1);
        assert!(found.iter().all(|(counted, shown)| *counted > 0 && counted == shown), "{found:?}");
    }
}

/// Returns all datagrams of a team in this many milliseconds.
fn recording(epochs: u32, ms: u64) -> Vec<Flight> {
    let configs = (0..5).map(|host| config(host, 5, epochs, Some(key()), setup()));
    let mut rig = Rig::new(configs);
    // Another run: other random numbers.
    (0..5u16).for_each(|host| rig.restart(usize::from(host), config(host, 5, epochs, Some(key()), setup())));
    talk(&mut rig, &[0, 1, 2, 3, 4], Some(66), ms);
    assert!(got(&rig, 0, 1, 66) > 10, "it is a run like any other");
    rig.sent
}

#[test]
fn recordings_of_former_runs_are_refused_and_do_not_delay_a_start() {
    for runs in [1, 40] {
        let former: Vec<Flight> = (0..runs).flat_map(|incarnation| recording(incarnation, 3000)).collect();
        let mut rig = Rig::new((0..5).map(|host| config(host, 5, 1000, Some(key()), setup())));
        let mut next = former.iter().cycle();
        let whole = |rig: &Rig| {
            (0..5).all(|host| (0..5u16).all(|robot| usize::from(robot) == host || got(rig, host, robot, 7) > 0))
        };
        while !whole(&rig) {
            let step = rig.now.as_nanos() / 20_000_000;
            for host in (0..5).filter(|host| (step + host * 3).is_multiple_of(4)) {
                rig.publish(host as usize, latent(host as u16, 7));
            }
            for _ in 0..20 {
                // Four a millisecond, to every host.
                for flight in next.by_ref().take(4) {
                    (0..5).for_each(|host| rig.arrive(host, &flight.frame));
                }
                rig.run_ms(1);
            }
            assert!(rig.now.as_secs() <= 2.0, "{runs} former runs: it starts within 2 s");
        }
        println!("beside 4000 recordings a second of {runs} former runs: whole after {}", rig.now);
        for host in 0..5 {
            assert_eq!((0..5).map(|robot| got(&rig, host, robot, 66)).sum::<usize>(), 0, "nothing old is accepted");
        }
    }
}

#[test]
fn a_recording_of_an_absent_host_s_incarnation_does_not_prove_that_it_is_alive() {
    let former = recording(1, 3000);
    let absent = config(9, 5, 1, None, setup());
    let mut rig = Rig::new((0..5).map(|host| config(host, 5, 1, Some(key()), setup())));
    rig.restart(1, absent);
    for flight in former.iter().filter(|flight| flight.from == 1) {
        (0..5).for_each(|host| rig.arrive(host, &flight.frame));
        talk(&mut rig, &[0, 2, 3, 4], Some(1), 20);
    }
    for host in [0, 2, 3, 4] {
        assert!(got(&rig, host, 1, 66) == 0 && rig.delivered[host].len() > 20);
    }
}

/// Delays the datagrams of host 1 without a report until it sends nothing but soft state. Then some time passes and all
/// of them are released; returns the number of accepted messages.
fn released(setup: &Setup, everything: bool, after_ms: u64) -> usize {
    let mut rig = Rig::new((0..2).map(|host| config(host, 2, 1, Some(key()), setup.clone())));
    talk(&mut rig, &[0, 1], Some(1), 2000);
    assert!(got(&rig, 0, 1, 1) > 5);
    let begin = rig.sent.len();
    rig.relay = Some((1, everything));
    talk(&mut rig, &[0, 1], Some(2), 1000);
    assert!(got(&rig, 0, 1, 2) < 12, "some is held back");
    let held = rig.sent[begin..].iter().filter(|flight| flight.from == 1);
    let held: Vec<_> = held.filter(|flight| everything || rig::is_held(&flight.frame)).cloned().collect();
    assert!(held.iter().any(|flight| is_data(&flight.frame)));
    talk(&mut rig, &[0, 1], None, after_ms);
    rig.relay = None;
    rig.delivered[0].clear();
    for flight in held {
        rig.arrive(0, &flight.frame);
    }
    got(&rig, 0, 1, 2)
}

#[test]
fn datagrams_delayed_while_reports_passed_are_refused_after_any_delay() {
    for after_ms in [1000, 8000, 45_000, 300_000] {
        for setup in [setup(), Setup::unicast(Reliabilities::new())] {
            assert_eq!(released(&setup, false, after_ms), 0, "{:?}, {after_ms} ms", setup.piggyback);
        }
    }
    // If no newer datagram passes that reveals the delay, the sender is not accepted either.
    for after_ms in [4000, 8000, 45_000] {
        assert_eq!(released(&setup(), true, after_ms), 0, "all of it, {after_ms} ms");
    }
}

/// Returns the number of copies of data that arrived more than 200 ms after their originals left, as only the last
/// retry can.
fn latest_copies(rig: &Rig) -> usize {
    let mut left = BTreeMap::new();
    for flight in rig.sent.iter().filter(|flight| is_data(&flight.frame)) {
        let header = codec::peek(&flight.frame).expect("a sound datagram");
        left.entry((header.sender, header.sequence)).or_insert(flight.at);
    }
    let arrived = rig.arrived.iter().flatten().filter(|(_, _, frame)| is_data(frame));
    let late = |(at, _, frame): &&(Time, usize, Frame)| {
        let header = codec::peek(frame).expect("a sound datagram");
        at.since(left[&(header.sender, header.sequence)]) > Span::from_millis(200)
    };
    arrived.filter(late).count()
}

#[test]
fn jitter_and_retransmissions_make_nothing_late() {
    for reliability in [Reliability::BestEffort, Reliability::Repeat, Reliability::Nack, Reliability::Ack] {
        let kinds = Reliabilities::from([(Kind::Latent, reliability)]);
        for setup in [Setup::multicast(kinds.clone()), Setup::unicast(kinds)] {
            let team = (0..5).map(|host| config(host, 5, 1, Some(key()), setup.clone()));
            let mut rig = Rig::new(team.chain([config(9, 5, 1, None, setup.clone())]));
            talk(&mut rig, &[0, 1, 2, 3, 4], Some(1), 2000);
            (rig.loss, rig.jitter) = (0.2, Span::from_millis(100));
            talk(&mut rig, &[0, 1, 2, 3, 4], Some(2), 10_000);
            (0..5).for_each(|host| assert_eq!(rig.counted(host).late, 0, "{reliability:?}"));
            if reliability == Reliability::Nack {
                // A retransmission that another host requested may be late at a host that did not request it.
                continue;
            }
            // So slowly that no newer message replaces the last retry; and after each message an operator causes all
            // hosts to report at once.
            (rig.loss, rig.arrived) = (0.5, Some(Vec::new()));
            for turn in 0..100 {
                (0..5).for_each(|host| rig.publish(host, latent(host as u16, 3)));
                let mut operator = operator(turn, u32::from(turn));
                operator.links = vec![Some(Setup { report_piggyback_age: Span::ZERO, ..setup.clone() })];
                rig.restart(5, operator);
                // The report arrives as early as possible, the last retry as late as possible.
                for (jitter_ms, ms) in [(0, 40), (100, 360)] {
                    rig.jitter = Span::from_millis(jitter_ms);
                    talk(&mut rig, &[0, 1, 2, 3, 4], None, ms);
                }
            }
            (0..5).for_each(|host| assert_eq!(rig.counted(host).late, 0, "{reliability:?}"));
            let latest = latest_copies(&rig);
            assert!(latest > 10 || reliability != Reliability::Ack, "{latest} last retries arrived");
        }
    }
}

#[test]
fn of_two_live_hosts_with_one_id_the_later_one_detects_it() {
    // One starts 5 s after the other, or both at once.
    for (apart_ms, numbers) in [(5000, [1, 2]), (5000, [2, 1]), (0, [1, 2]), (0, [2, 1])] {
        let silent = config(9, 3, 1, None, setup());
        let own = |incarnation| config(1, 3, incarnation, Some(key()), setup());
        let first = |host| config(host, 3, 1, Some(key()), setup());
        let mut rig = Rig::new([first(0), own(numbers[0]), first(2), silent]);
        talk(&mut rig, &[0, 1, 2], Some(1), apart_ms);
        rig.restart(3, own(numbers[1]));
        talk(&mut rig, &[0, 1, 2, 3], Some(1), 1000);
        let told = [1, 3].map(|host| rig.duplicates[host].map(|duplicate| (duplicate.host, duplicate.incarnation)));
        let later = usize::from(apart_ms > 0 || numbers[1] < numbers[0]);
        let mut expected = [None; 2];
        expected[later] = Some((HostId(1), numbers[1 - later]));
        assert_eq!(told, expected, "{apart_ms} ms apart, {numbers:?}");
        assert_eq!((rig.duplicates[0], rig.duplicates[2]), (None, None));
    }
}

#[test]
fn a_recording_of_its_former_incarnation_ends_no_host() {
    let former = recording(5, 3000);
    let mut rig = Rig::new((0..5).map(|host| config(host, 5, 1, Some(key()), setup())));
    for flight in former.iter().filter(|flight| flight.from == 1) {
        rig.arrive(1, &flight.frame);
        talk(&mut rig, &[0, 1, 2], Some(1), 20);
    }
    assert_eq!(rig.duplicates, [None; 5]);
    assert_eq!(rig.counted(1).duplicate_id, 0);
}

/// Returns an operator, which sends stops and receives only reports.
fn operator(number: u16, incarnation: u32) -> Config {
    let router = Router::new(5, |kind, _| match kind {
        Kind::Stop => Route { local: true, leaves: Some((LINK, Audience::All)) },
        _ => Route::default(),
    });
    let eager = Setup { report_piggyback_age: Span::ZERO, ..setup() };
    let me = Identity { host: HostId::operator(number), team: TEAM, incarnation };
    Config { me, key: Some(key()), links: vec![Some(eager)], router, parts: None }
}

fn stop(number: u16) -> Wire {
    Wire::Stop(Stop::engage(HostId::operator(number), Latch::default()))
}

/// Returns the operators of which a host has received a stop.
fn stops(rig: &Rig, host: usize) -> Vec<HostId> {
    let by = |message: &Wire| if let Wire::Stop(stop) = message { Some(stop.by) } else { None };
    rig.delivered[host].iter().filter_map(|(_, message)| by(message)).collect()
}

#[test]
fn simultaneous_operators_are_all_accepted_at_once_even_with_the_same_number() {
    for loss in [0.0, 0.2] {
        // Ten operators, two of them with the same number; the eleventh has been there for a minute.
        let numbers = [1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 10];
        let team = (0..5).map(|host| config(host, 5, 1, Some(key()), setup()));
        let mut rig = Rig::new(team.chain(numbers.map(|_| config(9, 5, 1, None, setup()))));
        rig.restart(15, operator(10, 77));
        talk(&mut rig, &[0, 1, 2, 3, 4], Some(1), 60_000);
        rig.loss = loss;
        let duplicates: Vec<u64> = (0..5).map(|host| rig.counted(host).duplicate_id).collect();
        for (at, number) in numbers[..10].iter().enumerate() {
            rig.restart(5 + at, operator(*number, at as u32 * 1000));
        }
        let began = rig.now;
        let mut after = Vec::new();
        while after.len() < 4 {
            for (at, number) in numbers.iter().enumerate() {
                rig.publish(5 + at, stop(*number));
            }
            talk(&mut rig, &[0, 1, 2, 3, 4], Some(1), 20);
            let heard = |host: &usize| (1..=10).all(|number| stops(&rig, *host).contains(&HostId::operator(number)));
            // In the routing table of these tests robot 0 belongs to host 0, and so do messages about no robot.
            let now = (1..5).filter(heard).count();
            after.resize(now.max(after.len()), rig.now.since(began));
            assert!(rig.now.since(began) <= Span::from_millis(400), "loss {loss}: {after:?}");
        }
        println!("loss {loss}: ten operators at once are heard by 1 to 4 hosts after {after:?}");
        rig.loss = 0.0;
        rig.run_ms(2000);
        assert_eq!(
            (0..5).map(|host| rig.counted(host).duplicate_id).collect::<Vec<_>>(),
            duplicates,
            "none is refused for another"
        );
        let ninth = rig.peers[0].iter().filter(|peer| peer.host == HostId::operator(9).0 && peer.accepted).count();
        assert_eq!(ninth, 2, "side by side");
    }
}

#[test]
fn a_new_operator_is_accepted_within_one_round_trip() {
    let team = (0..5).map(|host| config(host, 5, 1, Some(key()), setup()));
    let mut rig = Rig::new(team.chain([config(9, 5, 1, None, setup())]));
    talk(&mut rig, &[0, 1, 2, 3, 4], None, 3000);
    rig.restart(5, operator(3, 12));
    let began = rig.sent.len();
    rig.delay = Span::from_millis(2);
    rig.run_ms(5);
    let hello = rig.sent[began..].iter().find(|flight| flight.from == 5).expect("it says hello at once");
    let said = report(&hello.frame, TAG_BYTES).expect("a report");
    assert!(said.heard.is_empty() && !is_data(&hello.frame));
    // The first report, the answer, and the first stop take 2 ms each.
    rig.publish(5, stop(3));
    rig.run_ms(2);
    (1..5).for_each(|host| assert_eq!(stops(&rig, host).len(), 1, "host {host} obeys its first stop"));
}
