//! Guests of a unicast link: operators, whose address is in no file and to which it sends for a while. The link layer
//! decides which are admitted.
//!
//! A recording of an operator can be sent from any address. So only a new datagram changes the address of an accepted
//! operator. All others have a table of their own and are sent reports only, which they need to prove their liveness.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use crate::messages::ids::HostId;
use crate::net::protocol::link::{Guest, Standing};
use crate::time::{Span, Time};

/// Most accepted guests: each costs a datagram for every one that is sent to all, and a team has few operators.
pub const MAX_GUESTS: usize = 32;
/// Time for which a guest is kept after it was last admitted: at least a hundred datagrams of a live operator.
pub const STAY: Span = Span::from_millis(10_000);
/// Most addresses of guests that have not proved their liveness: each costs a datagram for every report.
pub const MAX_UNPROVEN: usize = 32;
/// Time for which such an address is kept: as long as a stamp is echoed.
pub const UNPROVEN_STAY: Span = Span::from_millis(2000);

/// Guests of one link.
#[derive(Clone, Debug, Default)]
pub struct Guests {
    proven: BTreeMap<HostId, (SocketAddr, Time)>,
    unproven: BTreeMap<(HostId, SocketAddr), Time>,
}

impl Guests {
    /// Admits a guest or extends its stay. An accepted one is sent to at this address from now on.
    pub fn admit(&mut self, now: Time, Guest { host, at, standing }: Guest) {
        match standing {
            Standing::Proven => {
                self.unproven.remove(&(host, at));
                if !self.proven.contains_key(&host) && self.proven.len() >= MAX_GUESTS {
                    let oldest = self.proven.iter().min_by_key(|(_, (_, admitted))| *admitted).map(|(host, _)| *host);
                    oldest.and_then(|host| self.proven.remove(&host));
                }
                self.proven.insert(host, (at, now));
            }
            Standing::Unproven => {
                if !self.unproven.contains_key(&(host, at)) && self.unproven.len() >= MAX_UNPROVEN {
                    self.make_room(now);
                }
                self.unproven.insert((host, at), now);
            }
        }
    }

    /// Removes expired addresses; if there are none, the oldest address of the host with the most addresses.
    fn make_room(&mut self, now: Time) {
        self.unproven.retain(|_, admitted| now.since(*admitted) < UNPROVEN_STAY);
        if self.unproven.len() < MAX_UNPROVEN {
            return;
        }
        let addresses = |of: HostId| self.unproven.keys().filter(|(host, _)| *host == of).count();
        let weakest = self.unproven.iter().max_by_key(|((host, _), at)| (addresses(*host), now.since(**at)));
        let weakest = weakest.map(|(place, _)| *place);
        weakest.and_then(|place| self.unproven.remove(&place));
    }

    /// Returns the address of an accepted guest, unless it has expired.
    pub fn find(&self, now: Time, host: HostId) -> Option<SocketAddr> {
        self.proven.get(&host).filter(|(_, admitted)| now.since(*admitted) < STAY).map(|(at, _)| *at)
    }

    /// Returns the addresses of all accepted guests, after removing expired ones.
    pub fn proven(&mut self, now: Time) -> impl Iterator<Item = SocketAddr> {
        self.proven.retain(|_, (_, admitted)| now.since(*admitted) < STAY);
        self.proven.values().map(|(at, _)| *at)
    }

    /// Returns the addresses of guests that are not accepted yet, after removing expired ones.
    pub fn unproven(&mut self, now: Time) -> impl Iterator<Item = SocketAddr> {
        self.unproven.retain(|_, admitted| now.since(*admitted) < UNPROVEN_STAY);
        self.unproven.keys().map(|(_, at)| *at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], port))
    }

    fn proven(host: u16, port: u16) -> Guest {
        Guest { host: HostId(host), at: at(port), standing: Standing::Proven }
    }

    fn unproven(host: u16, port: u16) -> Guest {
        Guest { standing: Standing::Unproven, ..proven(host, port) }
    }

    #[test]
    fn a_guest_leaves_ten_seconds_after_it_was_last_admitted() {
        let mut guests = Guests::default();
        let second = Time::ZERO + Span::from_millis(1000);
        guests.admit(Time::ZERO, proven(1, 1));
        guests.admit(second, proven(1, 2));
        assert_eq!(guests.find(Time::ZERO + STAY, HostId(1)), Some(at(2)), "it was admitted again, elsewhere");
        assert_eq!(guests.find(second + STAY, HostId(1)), None);
        assert_eq!(guests.proven(second + STAY).count(), 0);
    }

    #[test]
    fn the_oldest_guest_makes_room_for_a_new_one() {
        let mut guests = Guests::default();
        for number in 0..=MAX_GUESTS as u16 {
            guests.admit(Time::from_nanos(u64::from(number)), proven(number, number));
        }
        let now = Time::from_nanos(100);
        assert_eq!(guests.proven(now).count(), MAX_GUESTS);
        assert_eq!(guests.find(now, HostId(0)), None);
        assert_eq!(guests.find(now, HostId(1)), Some(at(1)));
    }

    #[test]
    fn guests_that_are_not_believed_neither_redirect_nor_evict_one_that_is() {
        let mut guests = Guests::default();
        guests.admit(Time::ZERO, proven(1, 1));
        for host in 1..=100 {
            guests.admit(Time::from_nanos(host), unproven(host as u16, 1000 + host as u16));
        }
        let now = Time::from_nanos(200);
        assert_eq!(guests.find(now, HostId(1)), Some(at(1)));
        assert_eq!(guests.proven(now).collect::<Vec<_>>(), [at(1)]);
        assert_eq!(guests.unproven(now).count(), MAX_UNPROVEN);
        assert_eq!(guests.unproven(now + UNPROVEN_STAY).count(), 0, "and they leave soon");
    }

    #[test]
    fn one_operator_at_many_addresses_takes_no_place_from_another() {
        let mut guests = Guests::default();
        guests.admit(Time::ZERO, unproven(7, 7));
        for port in 1000..2000 {
            guests.admit(Time::from_nanos(u64::from(port)), unproven(8, port));
        }
        assert!(guests.unproven(Time::from_nanos(3000)).any(|there| there == at(7)));
        guests.admit(Time::from_nanos(3000), proven(7, 7));
        assert!(guests.unproven(Time::from_nanos(3000)).all(|there| there != at(7)), "it is told everything once");
    }
}
