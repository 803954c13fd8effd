//! Rosters among members that run: how soon all have a new one on a lossy link, what is lost meanwhile, and what a
//! revoked member still can.

use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::wire::Wire;
use murmurate::net::protocol::codec::{self, Flags, Frame, Header};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::member::{Member, public, seal_roster};
use murmurate::net::protocol::reliability::Reliabilities;
use murmurate::net::protocol::roster::{self, Roster};
use murmurate::random::Seed;
use murmurate::time::{Span, Time};
use rand::RngExt;

use crate::rig::{Rig, TEAM, config, latent, multicast};

const ROOT: [u8; 32] = [99; 32];
const HOSTS: u16 = 5;
/// Period of latents \[ms\].
const PERIOD_MS: u64 = 50;

fn secret(member: u16) -> [u8; 32] {
    *blake3::hash(&member.to_le_bytes()).as_bytes()
}

fn roster(number: u32, planned: bool, members: &[u16]) -> Roster {
    let members = members.iter().map(|member| (HostId(*member), public(&secret(*member)))).collect();
    Roster { number, planned, members }
}

const ALL: [u16; 5] = [0, 1, 2, 3, 4];
const REST: [u16; 4] = [0, 1, 2, 4];

fn key(host: u16) -> Key {
    key_of(host, &ALL)
}

fn key_of(host: u16, members: &[u16]) -> Key {
    let own = (HostId(host), secret(host));
    let member = Member::new(TEAM, own, public(&ROOT), (roster(1, false, members), [1; 32]));
    Key::of(member.expect("it is one of them")).confidential()
}

fn header(sender: u16) -> Header {
    Header { flags: Flags(0), team: TEAM, sender: HostId(sender), incarnation: 9, sequence: 0 }
}

fn sealed(number: u32, planned: bool, members: &[u16]) -> Vec<u8> {
    let nonce = [number as u8; 24];
    seal_roster((TEAM, &roster(number, planned, members)), &ROOT, &[number as u8; 32], nonce).expect("few members")
}

fn datagram(number: u32, planned: bool, members: &[u16]) -> Frame {
    codec::with_roster(&header(7), &roster::pages(&sealed(number, planned, members))[0])
}

fn team(loss: f64) -> Rig {
    let of = |host| config(host, HOSTS.into(), 1, Some(key(host)), multicast(Reliabilities::new()));
    let mut rig = Rig::new((0..HOSTS).map(of));
    rig.loss = loss;
    rig
}

/// Runs the team for this long, in which each host publishes latents.
fn speak(rig: &mut Rig, ms: u64) {
    for _ in 0..ms / PERIOD_MS {
        let episode = (rig.now.since(Time::ZERO).as_nanos() / 1_000_000) as u32;
        (0..HOSTS).for_each(|host| rig.publish(usize::from(host), latent(host, episode)));
        rig.run_ms(PERIOD_MS);
    }
}

/// Returns the longest time for which a host has heard nothing of another one, and the latest time that it has, both
/// from `since` on.
fn silence(rig: &Rig, (here, there): (u16, u16), since: Time) -> (Span, Time) {
    let of = |message: &Wire| matches!(message, Wire::Latent(latent) if latent.robot == RobotId(there));
    let heard = rig.delivered[usize::from(here)].iter().filter(|(at, message)| *at >= since && of(message));
    let (mut longest, mut last) = (Span::ZERO, since);
    for (at, _) in heard {
        (longest, last) = (longest.max(at.since(last)), *at);
    }
    (longest, last)
}

/// Returns by when all these hosts have kept the roster with this number, after `since`.
fn spread(rig: &Rig, number: u32, hosts: &[u16], since: Time) -> Span {
    let at = |host: &u16| match rig.rosters[usize::from(*host)] {
        Some((at, kept)) if kept == number => at.since(since),
        other => panic!("host {host} has {other:?}"),
    };
    hosts.iter().map(at).max().expect("there are hosts")
}

#[test]
fn a_planned_change_loses_no_message_and_a_revocation_few_on_a_link_that_loses_a_fifth() {
    let mut rig = team(0.2);
    speak(&mut rig, 3000);
    let planned = rig.now;
    rig.arrive(0, &datagram(2, true, &ALL));
    speak(&mut rig, 12_000);
    let took = spread(&rig, 2, &ALL, planned);
    assert!(took <= Span::from_millis(200), "{took:?}");
    // Of 240 each, as many as on a link without a change.
    for (here, there) in ALL.iter().flat_map(|here| ALL.iter().map(move |there| (*here, *there))) {
        if here != there {
            let of = |message: &Wire| matches!(message, Wire::Latent(latent) if latent.robot == RobotId(there));
            let heard = &rig.delivered[usize::from(here)];
            let count = heard.iter().filter(|(at, message)| *at >= planned && of(message)).count();
            assert!((170..=215).contains(&count), "host {here} heard {count} of host {there}");
        }
    }
    let revoked = rig.now;
    rig.arrive(0, &datagram(3, false, &REST));
    speak(&mut rig, 4000);
    let took = spread(&rig, 3, &REST, revoked);
    assert!(took <= Span::from_millis(200), "{took:?}");
    for here in REST {
        for there in REST.into_iter().filter(|there| *there != here) {
            let (longest, _) = silence(&rig, (here, there), revoked);
            assert!(longest <= Span::from_millis(500), "host {here} of host {there}: {longest:?}");
        }
        let (_, last) = silence(&rig, (here, 3), revoked);
        assert!(last.since(revoked) <= Span::from_millis(200), "host {here} hears a revoked one");
        assert!(silence(&rig, (3, here), revoked).1.since(revoked) <= Span::from_millis(200), "and is heard by it");
    }
    assert!(rig.rosters[3].is_some_and(|(_, number)| number == 2), "nothing new is for the revoked one");
}

#[test]
fn a_roster_of_two_pages_reaches_all_of_twenty_members_beside_forged_pages() {
    const MEMBERS: u16 = 20;
    let all: Vec<u16> = (0..MEMBERS).collect();
    let of = |host| config(host, MEMBERS.into(), 1, Some(key_of(host, &all)), multicast(Reliabilities::new()));
    let mut rig = Rig::new((0..MEMBERS).map(of));
    rig.loss = 0.2;
    (0..3).for_each(|_| rig.meet());
    let pages = |number: u32, members: &[u16]| roster::pages(&sealed(number, false, members));
    let arrive = |rig: &mut Rig, page: &[u8]| rig.arrive(0, &codec::with_roster(&header(7), page));
    let [first, second] = &pages(2, &all)[..] else { panic!("there are two") };
    let mut forged = second.clone();
    *forged.last_mut().expect("it is not empty") ^= 1;
    // Its own page comes last, and what claims to belong to it does not.
    for page in [second, &forged, first, &forged] {
        arrive(&mut rig, page);
    }
    assert_eq!(rig.rosters[0], None, "a page is missing");
    let changed = rig.now;
    arrive(&mut rig, second);
    rig.run_ms(1000);
    let took = spread(&rig, 2, &all, changed);
    assert!(took <= Span::from_millis(400), "{took:?}");
    let rest: Vec<u16> = all.iter().copied().filter(|member| *member != 13).collect();
    let revoked = rig.now;
    pages(3, &rest).iter().for_each(|page| arrive(&mut rig, page));
    rig.run_ms(1000);
    let took = spread(&rig, 3, &rest, revoked);
    assert!(took <= Span::from_millis(400), "{took:?}");
    assert!(rig.rosters[13].is_some_and(|(_, number)| number == 2));
    // They hear each other by the new keys.
    let heard = rig.now;
    (0..10).for_each(|episode| {
        rest.iter().for_each(|host| rig.publish(usize::from(*host), latent(*host, episode)));
        rig.run_ms(PERIOD_MS);
    });
    for (here, there) in rest.iter().flat_map(|here| rest.iter().map(move |there| (*here, *there))) {
        assert!(here == there || silence(&rig, (here, there), heard).1 > heard, "host {here} of host {there}");
    }
}

#[test]
fn a_host_that_was_away_gets_the_roster_and_an_old_one_takes_nobody_back() {
    let mut rig = team(0.0);
    speak(&mut rig, 1000);
    rig.down = Some(2);
    rig.arrive(0, &datagram(2, false, &ALL));
    speak(&mut rig, 500);
    rig.arrive(0, &datagram(3, false, &REST));
    speak(&mut rig, 5000);
    let back = rig.now;
    rig.down = None;
    speak(&mut rig, 3000);
    let took = spread(&rig, 3, &[2], back);
    assert!(took <= Span::from_millis(1200), "{took:?}");
    let (_, last) = silence(&rig, (0, 2), back);
    assert!(rig.now.since(last) <= Span::from_millis(100), "it is heard again");
    for old in [datagram(2, false, &ALL), datagram(1, false, &ALL)] {
        (0..HOSTS).for_each(|host| rig.arrive(host.into(), &old));
    }
    speak(&mut rig, 1000);
    assert_eq!(
        rig.rosters.iter().map(|kept| kept.map(|(_, number)| number)).collect::<Vec<_>>(),
        [Some(3), Some(3), Some(3), Some(2), Some(3)]
    );
}

#[test]
fn what_is_no_roster_of_the_root_changes_nothing_and_is_answered_rarely() {
    let mut rig = team(0.0);
    speak(&mut rig, 1000);
    rig.arrive(0, &datagram(2, false, &ALL));
    speak(&mut rig, 2000);
    let (mut stream, honest) = (Seed::of_run(3).stream("junk"), datagram(3, false, &ALL));
    let (begun, sent) = (rig.now, rig.sent.len());
    for round in 0..100 {
        for _ in 0..20 {
            let mut junk = honest.to_vec();
            let at = stream.random_range(codec::HEADER_BYTES..junk.len());
            junk[at] ^= 1 << stream.random_range(0..8);
            rig.arrive(0, &junk);
            // By a member that makes one with its own secret in place of the root's.
            let own = seal_roster((TEAM, &roster(9, false, &ALL)), &secret(3), &[1; 32], [round; 24]);
            rig.arrive(0, &codec::with_roster(&header(3), &roster::pages(&own.expect("few members"))[0]));
        }
        rig.arrive(0, &datagram(1, false, &ALL));
        rig.run_ms(10);
    }
    assert_eq!(rig.rosters.iter().flatten().map(|(_, number)| *number).max(), Some(2));
    let own = rig.sent[sent..].iter().filter(|flight| flight.from == 0 && codec::roster_of(&flight.frame).is_some());
    let (own, s) = (own.count(), rig.now.since(begun).as_secs());
    assert!(own as f64 <= 6.0 * s + 1.0, "{own} in {s} s");
    rig.run_ms(1500);
    assert!(rig.counts[0].auth >= 2000, "{:?}", rig.counts[0]);
}
