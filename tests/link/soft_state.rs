//! Cost and effect of soft state in teams of 5, 50 and 200: bytes a second, time to join, time until senders know of
//! loss, and continued acceptance. Its rate beside data that it cannot join, and through a relay.

use std::collections::BTreeSet;

use crate::rig::{Flight, LINK, Rig, TEAM, config, heartbeat, key, latent, multicast, report};
use murmurate::actors::network::{Config, Identity};
use murmurate::messages::geometry::{Motion, Task};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Kind, Mode, Phase, Reading, Round, Wire};
use murmurate::net::protocol::codec::TAG_BYTES;
use murmurate::net::protocol::codec::{self, Content, HEADER_BYTES};
use murmurate::net::protocol::reliability::{Heartbeats, Reliabilities, Setup};
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::time::Span;

/// Budget of soft state of a host \[bytes/s\]: UDP payload with tags, without `Mode`.
const MOST_BYTES_PER_S: f64 = 1500.0;
/// The same while datagrams are lost, so that heartbeats are sent twice.
const MOST_LOSSY_BYTES_PER_S: f64 = 2000.0;
/// Period of the messages of a host with little data \[ms\]: 2.4 a second.
const SLOW_MS: u64 = 416;
/// Period of heartbeats \[ms\].
const BEAT_MS: u64 = 200;

/// Returns the bytes of soft state in a datagram: all of it, or those piggybacked on data.
fn soft_bytes(flight: &Flight) -> usize {
    let plain = &flight.frame[..flight.frame.len() - TAG_BYTES];
    let mut data = 0;
    for (content, body) in codec::blocks(plain).flatten() {
        if matches!(content, Content::Message(kind) if !matches!(kind, Kind::Heartbeat | Kind::Mode)) {
            data += 3 + body.len();
        }
    }
    if data > 0 { plain.len() - HEADER_BYTES - data } else { flight.bytes }
}

/// Makes a team send heartbeats and data of `kinds` for this many milliseconds, out of phase. `each` is called after
/// each step of 20 ms and returns whether to end.
fn talk(rig: &mut Rig, kinds: &[Kind], ms: u64, mut each: impl FnMut(&mut Rig) -> bool) {
    let hosts = rig.networks.len() as u64;
    let begin = rig.now;
    for step in 0..ms / 20 {
        for host in 0..hosts {
            let due = |period: u64, phase: u64| (step + host * 7 + phase).is_multiple_of(period / 20);
            if host > 0 && due(BEAT_MS, 0) {
                rig.publish(host as usize, heartbeat(host as u16, step as u32));
            }
            if kinds.contains(&Kind::Latent) && due(SLOW_MS, 1) {
                rig.publish(host as usize, latent(host as u16, step as u32));
            }
        }
        rig.run_to(begin + Span::from_millis(20) * (step + 1));
        if each(rig) {
            return;
        }
    }
}

/// Returns the number of ordered pairs of hosts in which one has accepted the other.
fn accepted(rig: &Rig) -> usize {
    rig.peers.iter().map(|peers| peers.iter().filter(|peer| peer.accepted).count()).sum()
}

/// Returns the largest rate of soft state of a host \[bytes/s\].
fn cost(rig: &mut Rig, kinds: &[Kind], seconds: u64) -> f64 {
    rig.sent.clear();
    talk(rig, kinds, seconds * 1000, |_| false);
    let mut bytes = vec![0; rig.networks.len()];
    rig.sent.iter().for_each(|flight| bytes[flight.from] += soft_bytes(flight));
    bytes.into_iter().max().unwrap_or_default() as f64 / seconds as f64
}

/// Adds the hosts that were informed of a loss of at least 2 in 64.
fn told(rig: &mut Rig, told: &mut BTreeSet<usize>) {
    for (_, to, frame) in rig.arrived.iter_mut().flat_map(std::mem::take) {
        let heard = report(&frame, TAG_BYTES).map(|report| report.heard).unwrap_or_default();
        if heard.iter().any(|entry| usize::from(entry.host.0) == to && entry.lost >= 2) {
            told.insert(to);
        }
    }
}

#[test]
fn soft_state_keeps_its_budget_and_works_in_teams_of_any_size() {
    println!(
        "| hosts | whole after [s] | idle [B/s] | 2.4 messages/s [B/s] | all know of 30 % loss after [s] | \
         idle, 20 % loss [B/s] | 2.4 messages/s, 20 % loss [B/s] |"
    );
    for (hosts, told_ms) in [(5u16, 2000), (20, 2000), (50, 2000), (200, 4000)] {
        let mut rig = Rig::team(hosts, Reliabilities::new());
        let pairs = usize::from(hosts) * usize::from(hosts - 1);
        talk(&mut rig, &[], 4000, |rig| accepted(rig) == pairs);
        let whole = rig.now;
        assert_eq!(accepted(&rig), pairs, "{hosts} hosts are whole within 4 s");
        talk(&mut rig, &[], 2000, |_| false);
        let idle = cost(&mut rig, &[], 4);
        let slow = cost(&mut rig, &[Kind::Latent], 4);
        assert!(idle.max(slow) <= MOST_BYTES_PER_S, "{hosts} hosts: {idle} and {slow} B/s");

        (rig.loss, rig.arrived) = (0.3, Some(Vec::new()));
        let (lossy, mut knows) = (rig.now, BTreeSet::new());
        talk(&mut rig, &[Kind::Latent], told_ms, |rig| {
            told(rig, &mut knows);
            knows.len() == usize::from(hosts)
        });
        let after = rig.now.since(lossy);
        assert_eq!(knows.len(), usize::from(hosts), "{hosts} hosts: every sender knows of loss after {after}");
        rig.arrived = None;
        rig.loss = 0.2;
        let lossy = [&[][..], &[Kind::Latent]].map(|kinds| cost(&mut rig, kinds, 4));
        let most = lossy[0].max(lossy[1]);
        assert!(most <= MOST_LOSSY_BYTES_PER_S, "{hosts} hosts at 20 % loss: {lossy:?} B/s");
        let (whole, after) = (whole.as_secs(), after.as_secs());
        let [idle_lossy, slow_lossy] = lossy;
        println!("| {hosts} | {whole:.0} | {idle:.0} | {slow:.0} | {after:.2} | {idle_lossy:.0} | {slow_lossy:.0} |");

        rig.loss = 0.3;
        let mut least = pairs;
        talk(&mut rig, &[Kind::Latent], 20_000, |rig| {
            least = least.min(accepted(rig));
            false
        });
        assert_eq!(least, pairs, "{hosts} hosts: none ceases to be accepted at 30 % loss");
    }
}

/// Returns how many link reports a team sends a second, all hosts together, and how many datagrams.
fn reports_per_s(rig: &mut Rig, seconds: u64) -> (f64, f64) {
    rig.sent.clear();
    rig.run_ms(1000 * seconds);
    let reports = rig.sent.iter().filter(|flight| report(&flight.frame, TAG_BYTES).is_some()).count();
    (reports as f64 / seconds as f64, rig.sent.len() as f64 / seconds as f64)
}

#[test]
fn a_larger_team_without_loss_reports_no_more_often_than_a_small_one_until_a_host_waits_for_it() {
    for (hosts, most) in [(5u16, 20.5), (10, 20.5), (25, 20.5), (50, 34.0)] {
        let mut rig = Rig::team(hosts, Reliabilities::new());
        let pairs = usize::from(hosts) * usize::from(hosts - 1);
        rig.run_ms(5000);
        assert_eq!(accepted(&rig), pairs);
        let (reports, datagrams) = reports_per_s(&mut rig, 40);
        println!("{hosts} idle hosts: {reports} reports a second of {datagrams} datagrams");
        assert!((0.8 * most..=most).contains(&reports), "{hosts} hosts: {reports} reports a second");
        assert_eq!(accepted(&rig), pairs, "all stay accepted by reports alone");
        let last = hosts - 1;
        rig.restart(last.into(), config(last, hosts.into(), 2, Some(key()), multicast(Reliabilities::new())));
        rig.run_ms(2000);
        assert_eq!(accepted(&rig), pairs, "a host that was restarted is accepted by all");
    }
}

#[test]
fn in_a_larger_team_a_second_host_with_the_id_of_another_one_is_found_and_not_accepted() {
    let hosts = 25u16;
    let own = |host, incarnation| config(host, hosts.into(), incarnation, Some(key()), multicast(Reliabilities::new()));
    let mut rig = Rig::new((0..hosts).map(|host| own(host, 1)).chain([own(hosts, 1)]));
    rig.down = Some(usize::from(hosts));
    rig.run_ms(8000);
    rig.restart(hosts.into(), own(1, 2));
    rig.down = None;
    rig.run_ms(4000);
    rig.delivered.iter_mut().for_each(Vec::clear);
    rig.publish(1, latent(1, 7));
    rig.publish(hosts.into(), latent(1, 8));
    rig.run_ms(100);
    for host in (0..usize::from(hosts)).filter(|host| *host != 1) {
        let heard: Vec<&Wire> = rig.delivered[host].iter().map(|(_, message)| message).collect();
        assert_eq!(heard, [&latent(1, 7)], "host {host} keeps the one that was there");
    }
    assert!(rig.duplicates[usize::from(hosts)].is_some(), "the second one is told to end");
    assert_eq!(rig.duplicates[1], None, "and the first one is not");
}

/// Returns one of two hosts on an addressed link: host 0 sends readings to host 1 alone, and instructions to all.
fn of_server(host: u16) -> Config {
    let router = Router::new(2, |kind, _| match kind {
        Kind::Reading | Kind::Mode => {
            let to = if kind == Kind::Mode { Audience::All } else { Audience::Host(HostId(1)) };
            Route { local: host == 1, leaves: (host == 0).then_some((LINK, to)) }
        }
        _ => Route::default(),
    });
    let me = Identity { host: HostId(host), team: TEAM, incarnation: 1 };
    Config { me, key: Some(key()), links: vec![Some(Setup::unicast(Reliabilities::new()))], router, parts: None }
}

#[test]
fn instructions_to_all_do_not_wait_for_data_to_one_host() {
    let mut rig = Rig::new((0..2).map(of_server));
    rig.run_ms(2500);
    let task = Task { start: Motion::default().position, goal: Motion::default().position };
    let instruction = |episode| Mode {
        round: Round { term: 1, episode },
        repeat: 0,
        phase: Phase::Running,
        first: RobotId(1),
        tasks: vec![task].into(),
        latch: Latch::default(),
    };
    // An instruction beside every third reading, a moment before one that waits would be due, which it would replace.
    for number in 0..300 {
        if number % 3 == 0 {
            rig.publish(0, Wire::Mode(instruction(number as u32)));
        }
        rig.publish(0, Wire::Reading(Reading::of_point(RobotId(1), number, Motion::default())));
        rig.run_ms(33);
    }
    let arrived = |kind| rig.delivered[1].iter().filter(|(_, message)| message.kind() == kind).count();
    assert_eq!(arrived(Kind::Reading), 300);
    assert!(arrived(Kind::Mode) >= 99, "{} of 100 instructions have arrived in time", arrived(Kind::Mode));
}

/// Returns how many of 300 heartbeats arrive when this share of all datagrams is lost, on a link with the setup
/// `setup`, and how many datagrams of their sender left. It sends data as well, this often [Hz].
fn beats_heard(setup: &Setup, loss: f64, data_hz: u64) -> (usize, usize) {
    let router = |host: u16| {
        Router::new(2, move |kind, _| match kind {
            Kind::Heartbeat | Kind::Latent => {
                Route { local: host == 1, leaves: (host == 0).then_some((LINK, Audience::All)) }
            }
            _ => Route::default(),
        })
    };
    let mut rig = Rig::new((0..2).map(|host| {
        let me = Identity { host: HostId(host), team: TEAM, incarnation: 1 };
        Config { me, key: Some(key()), links: vec![Some(setup.clone())], router: router(host), parts: None }
    }));
    rig.run_ms(2500);
    rig.loss = loss;
    for number in 0..330 {
        // The other host has told of the loss by then.
        if number == 30 {
            rig.delivered[1].clear();
            rig.sent.clear();
        }
        rig.publish(0, heartbeat(0, number));
        let between = (data_hz * BEAT_MS / 1000).max(1);
        for _ in 0..between {
            if data_hz > 0 {
                rig.publish(0, latent(0, number));
            }
            rig.run_ms(BEAT_MS / between);
        }
    }
    let episode = |message: &Wire| if let Wire::Heartbeat(beat) = message { Some(beat.round.episode) } else { None };
    let heard = rig.delivered[1].iter().filter_map(|(_, message)| episode(message)).collect::<BTreeSet<_>>().len();
    (heard, rig.sent.iter().filter(|flight| flight.from == 0).count())
}

#[test]
fn a_heartbeat_leaves_twice_on_a_link_with_a_relay_and_on_any_that_loses_datagrams() {
    let none = Reliabilities::new;
    let once = |setup: Setup| Setup { heartbeats: Heartbeats::Once, ..setup };
    for setup in [Setup::unicast(none()), Setup::multicast(none())] {
        let (alone, twice) = (beats_heard(&once(setup.clone()), 0.4, 0).0, beats_heard(&setup, 0.4, 0).0);
        assert!((150..=210).contains(&alone), "{alone} of 300 have arrived");
        assert!((235..=275).contains(&twice), "{twice} of 300 have arrived, one in six should be lost");
    }
    let relayed = beats_heard(&Setup::relayed(none()), 0.4, 0).0;
    assert!((235..=275).contains(&relayed), "{relayed} of 300 have arrived, one in six should be lost");
}

#[test]
fn without_loss_no_heartbeat_leaves_twice_and_beside_data_none_costs_a_datagram() {
    let setup = Setup::multicast(Reliabilities::new());
    let once = Setup { heartbeats: Heartbeats::Once, ..setup.clone() };
    let datagrams = |setup: &Setup, loss, data_hz| beats_heard(setup, loss, data_hz).1;
    assert_eq!(datagrams(&setup, 0.0, 0), datagrams(&once, 0.0, 0));
    let (alone, beside) = (datagrams(&setup, 0.2, 0) as f64, datagrams(&setup, 0.2, 20) as f64);
    let (alone_once, beside_once) = (datagrams(&once, 0.2, 0) as f64, datagrams(&once, 0.2, 20) as f64);
    println!("datagrams of 60 s at 20 % loss: {alone_once} and {alone} without data, {beside_once} and {beside} with");
    assert!(alone > 1.3 * alone_once, "they leave twice");
    assert!(beside < 1.02 * beside_once, "they share the datagrams of data");
}
