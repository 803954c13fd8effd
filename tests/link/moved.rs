//! Hosts of a team that have moved to another address on a link that sends to single hosts.

use std::collections::BTreeSet;
use std::net::SocketAddr;

use crate::rig::{Rig, config, is_data, is_report, key, latent};
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::link::{Guest, Standing};
use murmurate::net::protocol::reliability::{Reliabilities, Setup};

fn at(last: u8) -> SocketAddr {
    SocketAddr::from(([10, 0, 0, last], 7700))
}

/// Two hosts on a unicast link with a key, which know each other.
fn pair() -> Rig {
    let setup = || Setup::unicast(Reliabilities::new());
    let mut rig = Rig::new((0..2).map(|host| config(host, 2, 1, Some(key()), setup())));
    rig.addresses = vec![Some(at(1)), Some(at(2))];
    talk(&mut rig, 2000);
    rig
}

/// Both hosts send data twenty times a second for this long.
fn talk(rig: &mut Rig, ms: u64) {
    talk_of(rig, &[0, 1], ms);
}

/// These hosts send data twenty times a second for this long.
fn talk_of(rig: &mut Rig, hosts: &[usize], ms: u64) {
    for step in 0..ms / 50 {
        for &host in hosts {
            rig.publish(host, latent(host as u16, step as u32));
        }
        rig.run_ms(50);
    }
}

/// Starts host `first` of two on a unicast link, and the other 3 s later. Host 0 is at another address than the team
/// file says. `talking` hosts send data once they run. Returns whether each receives from the other within a second.
fn start(key: Option<&Key>, first: usize, talking: &[usize], loss: f64) -> [bool; 2] {
    let of = |host: usize, run| config(host as u16, 2, run, key.cloned(), Setup::unicast(Reliabilities::new()));
    let mut rig = Rig::new((0..2).map(|host| of(host, 1)));
    rig.configured = Some(vec![at(1), at(2)]);
    rig.addresses = vec![Some(at(9)), Some(at(2))];
    rig.loss = loss;
    let second = 1 - first;
    // Until the other one starts, nothing arrives from it, and nothing at it.
    rig.down = Some(second);
    let alone: Vec<usize> = talking.iter().copied().filter(|host| *host == first).collect();
    talk_of(&mut rig, &alone, 3000);
    rig.down = None;
    rig.restart(second, of(second, 2));
    talk_of(&mut rig, talking, 1000);
    rig.delivered.iter_mut().for_each(Vec::clear);
    talk(&mut rig, 500);
    [0, 1].map(|host| !rig.delivered[host].is_empty())
}

/// Returns how host 1 was told that host 0 is at this address.
fn told(rig: &Rig, at: SocketAddr) -> Vec<Standing> {
    rig.admitted[1].iter().filter(|guest| guest.at == at).map(|guest| guest.standing).collect()
}

#[test]
fn the_transport_is_told_twice_a_second_where_a_host_is_and_not_with_each_datagram() {
    let mut rig = pair();
    rig.admitted[1].clear();
    talk(&mut rig, 5000);
    let expected = Guest { host: HostId(0), at: at(1), standing: Standing::Accepted };
    assert!(rig.admitted[1].iter().all(|guest| *guest == expected));
    assert!((8..=11).contains(&rig.admitted[1].len()), "{} times in 5 s", rig.admitted[1].len());
}

#[test]
fn a_host_that_has_moved_is_sent_data_once_it_proves_its_liveness_from_there() {
    let mut rig = pair();
    // It is without an address for so long that it has no fresh stamp of the other, which sends to its former address.
    rig.blocked = Some((1, 0, |_| true));
    rig.run_ms(3000);
    rig.addresses[0] = Some(at(9));
    // Of what goes to the new address, only reports may.
    rig.blocked = Some((1, 0, is_data));
    talk(&mut rig, 1000);
    let told = told(&rig, at(9));
    assert_eq!(told.first(), Some(&Standing::Candidate), "{told:?}");
    assert!(told.contains(&Standing::Accepted), "within a second: {told:?}");
}

#[test]
fn a_host_that_starts_elsewhere_is_found_whoever_starts_first_and_whoever_sends_data() {
    for key in [Some(key()), Some(key().confidential()), None] {
        for first in [0, 1] {
            for talking in [&[][..], &[0], &[1], &[0, 1]] {
                for loss in [0.0, 0.1] {
                    let found = start(key.as_ref(), first, talking, loss);
                    assert_eq!(found, [true; 2], "host {first} first, data of {talking:?}, loss {loss}, {key:?}");
                }
            }
        }
    }
}

#[test]
fn a_host_that_starts_elsewhere_is_found_by_a_team_of_thirty_within_two_seconds() {
    const COUNT: usize = 30;
    let of = |host: usize, run| config(host as u16, COUNT, run, Some(key()), Setup::unicast(Reliabilities::new()));
    let mut rig = Rig::new((0..COUNT).map(|host| of(host, 1)));
    let places: Vec<SocketAddr> = (1..).map(at).take(COUNT).collect();
    rig.addresses = places.iter().copied().map(Some).collect();
    (rig.addresses[0], rig.configured) = (Some(at(99)), Some(places));
    (rig.loss, rig.down) = (0.05, Some(0));
    let all: Vec<usize> = (0..COUNT).collect();
    talk_of(&mut rig, &all[1..], 3000);
    rig.down = None;
    rig.restart(0, of(0, 2));
    talk_of(&mut rig, &all, 2000);
    rig.delivered.iter_mut().for_each(Vec::clear);
    talk_of(&mut rig, &all, 500);
    for (host, delivered) in rig.delivered.iter().enumerate() {
        let heard: BTreeSet<u16> = delivered.iter().map(|(_, message)| message.robot().0).collect();
        assert_eq!(heard.len(), COUNT - 1, "host {host} hears {heard:?}");
    }
}

#[test]
fn a_recording_from_another_address_redirects_nothing() {
    let mut rig = pair();
    rig.blocked = Some((0, 1, |_| true));
    rig.publish(0, latent(0, 1000));
    let held = rig.last_data(0);
    rig.blocked = None;
    rig.arrive_from(1, &held, Some(at(66)));
    talk(&mut rig, 3000);
    assert!(told(&rig, at(66)).iter().all(|standing| *standing == Standing::Candidate), "{:?}", told(&rig, at(66)));
    assert!(told(&rig, at(1)).contains(&Standing::Accepted));
}

#[test]
fn a_recorded_run_from_another_address_redirects_nothing_and_costs_four_reports_a_second() {
    let mut recorded = pair();
    talk(&mut recorded, 3000);
    let run: Vec<_> =
        recorded.sent.iter().filter(|flight| flight.from == 0).map(|flight| flight.frame.clone()).collect();
    let setup = Setup::unicast(Reliabilities::new());
    let mut rig = Rig::new((0..2).map(|host| config(host, 2, 2, Some(key()), setup.clone())));
    (rig.configured, rig.addresses) = (Some(vec![at(1), at(2)]), vec![Some(at(1)), Some(at(2))]);
    rig.down = Some(0);
    // With stamps of its own.
    rig.restart(1, config(1, 2, 2, Some(key()), setup));
    talk_of(&mut rig, &[1], 1000);
    let before = rig.sent.len();
    for frame in &run {
        rig.arrive_from(1, frame, Some(at(66)));
        talk_of(&mut rig, &[1], 50);
    }
    let heard = told(&rig, at(66));
    assert!(!heard.is_empty() && heard.iter().all(|standing| *standing == Standing::Candidate), "{heard:?}");
    let reports = rig.sent[before..].iter().filter(|flight| flight.from == 1 && is_report(&flight.frame)).count();
    let most = run.len() * 50 / 250 + 1;
    assert!((1..=most).contains(&reports), "{reports} datagrams of reports alone, at most {most}");
}
