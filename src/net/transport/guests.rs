//! Hosts that a unicast link sends to for a while although no file has their address: operators. Who is admitted is
//! decided elsewhere.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Guests at one time: each costs a datagram for every one that is said to all, and a team has few operators.
pub const MAX_GUESTS: usize = 32;
/// How long a guest stays after it was last admitted: a hundred of the datagrams that a live operator sends, at least.
pub const STAY: Span = Span::from_millis(10_000);

/// The guests of one link.
#[derive(Clone, Debug, Default)]
pub struct Guests(BTreeMap<HostId, (SocketAddr, Time)>);

impl Guests {
    /// Admits a guest, or goes on admitting it, from now on at this address. Where there are too many, the one that was
    /// admitted longest ago leaves.
    pub fn admit(&mut self, now: Time, host: HostId, at: SocketAddr) {
        if self.0.len() >= MAX_GUESTS && !self.0.contains_key(&host) {
            let oldest = self.0.iter().min_by_key(|(_, (_, admitted))| *admitted).map(|(host, _)| *host);
            oldest.and_then(|host| self.0.remove(&host));
        }
        self.0.insert(host, (at, now));
    }

    /// Where a guest is, if it still is one.
    pub fn find(&self, now: Time, host: HostId) -> Option<SocketAddr> {
        self.0.get(&host).filter(|(_, admitted)| now.since(*admitted) < STAY).map(|(at, _)| *at)
    }

    /// Where all guests are; those whose time is over leave.
    pub fn all(&mut self, now: Time) -> impl Iterator<Item = SocketAddr> {
        self.0.retain(|_, (_, admitted)| now.since(*admitted) < STAY);
        self.0.values().map(|(at, _)| *at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], port))
    }

    #[test]
    fn a_guest_leaves_ten_seconds_after_it_was_last_admitted() {
        let mut guests = Guests::default();
        let second = Time::ZERO + Span::from_millis(1000);
        guests.admit(Time::ZERO, HostId(1), at(1));
        guests.admit(second, HostId(1), at(2));
        assert_eq!(guests.find(Time::ZERO + STAY, HostId(1)), Some(at(2)), "it was admitted again, elsewhere");
        assert_eq!(guests.find(second + STAY, HostId(1)), None);
        assert_eq!(guests.all(second + STAY).count(), 0);
    }

    #[test]
    fn the_oldest_guest_makes_room_for_a_new_one() {
        let mut guests = Guests::default();
        for number in 0..=MAX_GUESTS as u16 {
            guests.admit(Time::from_nanos(u64::from(number)), HostId(number), at(number));
        }
        let now = Time::from_nanos(100);
        assert_eq!(guests.all(now).count(), MAX_GUESTS);
        assert_eq!(guests.find(now, HostId(0)), None);
        assert_eq!(guests.find(now, HostId(1)), Some(at(1)));
    }
}
