//! Guests of a unicast link: operators, whose addresses are not in the team file. The link sends to them for a while
//! after each of their datagrams. The link layer decides which ones are admitted. Also candidates for the new address
//! of a host of the team.
//!
//! A recording of an operator's datagrams can be sent from any address. So only a new datagram changes the address of
//! an accepted operator. All others are kept in a separate table and receive only reports, which they need to prove
//! their liveness.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use crate::messages::ids::HostId;
use crate::net::protocol::link::{Guest, Standing};
use crate::time::{Span, Time};

/// Largest number of accepted guests (operators) that a unicast link sends to. Each costs an additional datagram for
/// every one that is sent to all hosts.
pub const MAX_GUESTS: usize = 32;
/// Time after an accepted operator's last datagram for which a unicast link goes on sending to it: at least a hundred
/// datagrams of a live operator.
pub const GUEST_LIFETIME: Span = Span::from_millis(10_000);
/// Largest number of addresses of operators that have not proved their liveness, to which a unicast link sends reports.
/// Each costs a datagram for every report.
pub const MAX_CANDIDATES: usize = 32;
/// Time for which the address of an operator that has not proved its liveness is kept: as long as its stamp is echoed.
pub const CANDIDATE_LIFETIME: Span = Span::from_millis(2000);

/// Addresses of the guests (operators, which are not in the team file) of one unicast link.
#[derive(Clone, Debug, Default)]
pub struct Guests {
    accepted: BTreeMap<HostId, (SocketAddr, Time)>,
    candidates: BTreeMap<(HostId, SocketAddr), Time>,
}

impl Guests {
    /// Records the address `at` of a guest from which a datagram arrived at `now`. An accepted guest is sent all
    /// datagrams at this address from now on; one that has not proved its liveness (a candidate), only link reports.
    /// Beyond 32 accepted guests, the one that has been silent longest is removed.
    pub fn admit(&mut self, now: Time, Guest { host, at, standing }: Guest) {
        match standing {
            Standing::Accepted => {
                self.candidates.remove(&(host, at));
                if !self.accepted.contains_key(&host) && self.accepted.len() >= MAX_GUESTS {
                    let oldest = self.accepted.iter().min_by_key(|(_, (_, admitted))| *admitted).map(|(host, _)| *host);
                    oldest.and_then(|host| self.accepted.remove(&host));
                }
                self.accepted.insert(host, (at, now));
            }
            Standing::Candidate => {
                if !self.candidates.contains_key(&(host, at)) && self.candidates.len() >= MAX_CANDIDATES {
                    self.make_room(now);
                }
                self.candidates.insert((host, at), now);
            }
        }
    }

    /// Removes the address `at` of a host that has proved its liveness from the candidates.
    pub fn forget(&mut self, host: HostId, at: SocketAddr) {
        self.candidates.remove(&(host, at));
    }

    /// Removes expired candidate addresses; if there are none, the oldest address of the host with the most addresses.
    fn make_room(&mut self, now: Time) {
        self.candidates.retain(|_, admitted| now.since(*admitted) < CANDIDATE_LIFETIME);
        if self.candidates.len() < MAX_CANDIDATES {
            return;
        }
        let addresses = |of: HostId| self.candidates.keys().filter(|(host, _)| *host == of).count();
        let weakest = self.candidates.iter().max_by_key(|((host, _), at)| (addresses(*host), now.since(**at)));
        let weakest = weakest.map(|(place, _)| *place);
        weakest.and_then(|place| self.candidates.remove(&place));
    }

    /// Returns the address of an accepted guest; `None` if it is not accepted or its last datagram arrived 10 s ago or
    /// more.
    pub fn find(&self, now: Time, host: HostId) -> Option<SocketAddr> {
        self.accepted.get(&host).filter(|(_, admitted)| now.since(*admitted) < GUEST_LIFETIME).map(|(at, _)| *at)
    }

    /// Removes accepted guests that have been silent for 10 s, and returns the addresses of the others.
    pub fn accepted(&mut self, now: Time) -> impl Iterator<Item = SocketAddr> {
        self.accepted.retain(|_, (_, admitted)| now.since(*admitted) < GUEST_LIFETIME);
        self.accepted.values().map(|(at, _)| *at)
    }

    /// Removes addresses of guests without a liveness proof that have been silent for 2 s, and returns the remaining
    /// ones.
    pub fn candidates(&mut self, now: Time) -> impl Iterator<Item = SocketAddr> {
        self.candidates.retain(|_, admitted| now.since(*admitted) < CANDIDATE_LIFETIME);
        self.candidates.keys().map(|(_, at)| *at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], port))
    }

    fn accepted_guest(host: u16, port: u16) -> Guest {
        Guest { host: HostId(host), at: at(port), standing: Standing::Accepted }
    }

    fn candidate(host: u16, port: u16) -> Guest {
        Guest { standing: Standing::Candidate, ..accepted_guest(host, port) }
    }

    #[test]
    fn a_guest_leaves_ten_seconds_after_it_was_last_admitted() {
        let mut guests = Guests::default();
        let second = Time::ZERO + Span::from_millis(1000);
        guests.admit(Time::ZERO, accepted_guest(1, 1));
        guests.admit(second, accepted_guest(1, 2));
        assert_eq!(
            guests.find(Time::ZERO + GUEST_LIFETIME, HostId(1)),
            Some(at(2)),
            "it was admitted again, elsewhere"
        );
        assert_eq!(guests.find(second + GUEST_LIFETIME, HostId(1)), None);
        assert_eq!(guests.accepted(second + GUEST_LIFETIME).count(), 0);
    }

    #[test]
    fn the_oldest_guest_makes_room_for_a_new_one() {
        let mut guests = Guests::default();
        for number in 0..=MAX_GUESTS as u16 {
            guests.admit(Time::from_nanos(u64::from(number)), accepted_guest(number, number));
        }
        let now = Time::from_nanos(100);
        assert_eq!(guests.accepted(now).count(), MAX_GUESTS);
        assert_eq!(guests.find(now, HostId(0)), None);
        assert_eq!(guests.find(now, HostId(1)), Some(at(1)));
    }

    #[test]
    fn guests_that_are_not_accepted_neither_redirect_nor_evict_one_that_is() {
        let mut guests = Guests::default();
        guests.admit(Time::ZERO, accepted_guest(1, 1));
        for host in 1..=100 {
            guests.admit(Time::from_nanos(host), candidate(host as u16, 1000 + host as u16));
        }
        let now = Time::from_nanos(200);
        assert_eq!(guests.find(now, HostId(1)), Some(at(1)));
        assert_eq!(guests.accepted(now).collect::<Vec<_>>(), [at(1)]);
        assert_eq!(guests.candidates(now).count(), MAX_CANDIDATES);
        assert_eq!(guests.candidates(now + CANDIDATE_LIFETIME).count(), 0, "and they leave soon");
    }

    #[test]
    fn one_operator_at_many_addresses_takes_no_place_from_another() {
        let mut guests = Guests::default();
        guests.admit(Time::ZERO, candidate(7, 7));
        for port in 1000..2000 {
            guests.admit(Time::from_nanos(u64::from(port)), candidate(8, port));
        }
        assert!(guests.candidates(Time::from_nanos(3000)).any(|there| there == at(7)));
        guests.admit(Time::from_nanos(3000), accepted_guest(7, 7));
        assert!(guests.candidates(Time::from_nanos(3000)).all(|there| there != at(7)), "it is told everything once");
    }
}
