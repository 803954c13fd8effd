//! Accepted senders of one link, in two bounded tables: hosts of the team, and guests. Guests are operators and hosts
//! that the deployment does not know. A new guest may replace an old one, but never a host.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use super::router::Audience;
use super::sender::Sender;
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Largest number of hosts of the team that are accepted on a link.
pub const MAX_SENDERS: usize = 1024;
/// Largest number of guests (operators, and hosts that the deployment does not know) that are accepted in addition to
/// the hosts of the team.
pub const MAX_GUESTS: usize = 128;
/// Time without a datagram after which a host is removed if the table is full.
const FORGET: Span = Span::from_millis(20_000);

/// Identity of a sender: its host id, and its incarnation (random number of one run).
pub type SenderId = (HostId, u32);

/// Table of the senders that are accepted on one link, of limited size.
#[derive(Clone, Debug)]
pub struct Senders {
    /// State of each sender, by its identity. A state is large, and boxed, so that a search reads few lines of memory.
    all: BTreeMap<SenderId, Box<Sender>>,
    first_guest: HostId,
    forgot: Time,
}

/// Returns the range of all incarnations of the hosts `from` to `to`.
fn ids(from: HostId, to: HostId) -> RangeInclusive<SenderId> {
    (from, 0)..=(to, u32::MAX)
}

impl Senders {
    /// Returns an empty table. Hosts of the team have ids below `first_guest`; guests (operators, and hosts that the
    /// deployment does not know) have the others.
    pub fn new(first_guest: HostId) -> Senders {
        Senders { all: BTreeMap::new(), first_guest, forgot: Time::ZERO }
    }

    /// Returns the state of a sender; `None` if it is not accepted.
    pub fn get(&self, id: SenderId) -> Option<&Sender> {
        self.all.get(&id).map(|sender| &**sender)
    }

    /// Returns the state of a sender, to be changed; `None` if it is not accepted.
    pub fn get_mut(&mut self, id: SenderId) -> Option<&mut Sender> {
        self.all.get_mut(&id).map(|sender| &mut **sender)
    }

    /// Returns all accepted senders, to be changed.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = (SenderId, &mut Sender)> {
        self.all.iter_mut().map(|(id, sender)| (*id, &mut **sender))
    }

    /// Returns all accepted senders in the order of host and incarnation.
    pub fn iter(&self) -> impl Iterator<Item = (SenderId, &Sender)> {
        self.all.iter().map(|(id, sender)| (*id, &**sender))
    }

    /// Returns the number of accepted senders.
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Whether any incarnation of this host is accepted.
    pub fn knows(&self, host: HostId) -> bool {
        self.all.range(ids(host, host)).next().is_some()
    }

    /// Returns another accepted incarnation of the host of `(host, incarnation)`; `None` if there is none. Always
    /// `None` for an operator, since several operators may have drawn the same id.
    pub fn other_incarnation(&self, (host, incarnation): SenderId) -> Option<SenderId> {
        let mut all = self.all.range(ids(host, host)).map(|(id, _)| *id);
        all.find(|id| id.1 != incarnation).filter(|_| !host.is_operator())
    }

    /// Adds an accepted sender to the table, or replaces its state.
    pub fn insert(&mut self, id: SenderId, sender: Sender) {
        self.all.insert(id, Box::new(sender));
    }

    /// Removes a sender from the table, so that it is no longer accepted.
    pub fn remove(&mut self, id: SenderId) {
        self.all.remove(&id);
    }

    /// Removes the senders of all hosts for which `stays` is false.
    pub fn keep(&mut self, stays: impl Fn(HostId) -> bool) {
        self.all.retain(|(host, _), _| stays(*host));
    }

    /// Makes room in the table for a new sender of the host `host`; returns `false` if there is none. Among too many
    /// guests, the one that has been silent longest is removed; it is accepted again with its next datagram. Among too
    /// many hosts of the team, those that have been silent for 20 s are removed.
    pub fn make_room(&mut self, now: Time, host: HostId) -> bool {
        let guests = || ids(self.first_guest, HostId(u16::MAX));
        let count = self.all.range(guests()).count();
        if host >= self.first_guest {
            let silent = |sender: &Sender| (sender.age(now).unwrap_or(Span::ZERO), now.since(sender.since));
            let leaves = self.all.range(guests()).max_by_key(|(_, sender)| silent(sender)).map(|(id, _)| *id);
            if let Some(id) = leaves.filter(|_| count >= MAX_GUESTS) {
                self.remove(id);
            }
            return true;
        }
        let full = |senders: &Senders| senders.all.len() - count >= MAX_SENDERS;
        // Limited in frequency, so that forged senders do not cause a search each.
        if full(self) && now.since(self.forgot) >= FORGET {
            self.forgot = now;
            let (first_guest, silent) =
                (self.first_guest, |sender: &Sender| sender.age(now).is_none_or(|age| age >= FORGET));
            self.all.retain(|(host, _), sender| *host >= first_guest || !silent(sender));
        }
        !full(self)
    }

    /// Returns how many times a message to the hosts in `audience` is to be sent again, 0 to 2, by the loss that they
    /// report.
    pub fn repeats(&self, now: Time, audience: Audience) -> u8 {
        let asked = |sender: &Sender| sender.repeat_until.iter().filter(|until| **until > now).count() as u8;
        let asking = match audience {
            Audience::Host(host) => ids(host, host),
            Audience::All => ids(HostId(0), HostId(u16::MAX)),
        };
        self.all.range(asking).map(|(_, sender)| asked(sender)).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn take_up(senders: &mut Senders, ms: u64, id: SenderId) -> bool {
        let room = senders.make_room(at(ms), id.0);
        if room {
            let mut sender = Sender::new(at(ms), None);
            sender.heard(at(ms));
            senders.insert(id, sender);
        }
        room
    }

    #[test]
    fn of_too_many_guests_the_one_that_was_silent_longest_leaves_and_hosts_stay() {
        let mut senders = Senders::new(HostId(3));
        (0..3).for_each(|host| assert!(take_up(&mut senders, 0, (HostId(host), 1))));
        let lively = (HostId::operator(5), 1);
        assert!(take_up(&mut senders, 1, lively));
        for ms in 2..2000u64 {
            let made_up = if ms % 2 == 0 { HostId::operator(ms as u16) } else { HostId(ms as u16) };
            assert!(take_up(&mut senders, ms, (made_up, 2)));
            senders.get_mut(lively).expect("it says something all the time").heard(at(ms));
        }
        assert_eq!(senders.iter().count(), 3 + MAX_GUESTS);
        assert!((0..3).all(|host| senders.knows(HostId(host))));
        assert!(senders.knows(HostId::operator(1998)) && !senders.knows(HostId::operator(10)));
    }

    #[test]
    fn guests_take_no_room_from_hosts() {
        let mut senders = Senders::new(HostId(2000));
        (0..MAX_GUESTS as u16).for_each(|number| assert!(take_up(&mut senders, 0, (HostId::operator(number), 1))));
        for host in 0..MAX_SENDERS as u16 + 10 {
            assert_eq!(take_up(&mut senders, 1, (HostId(host), 1)), usize::from(host) < MAX_SENDERS);
        }
        assert!(take_up(&mut senders, 20_001, (HostId(1999), 1)), "who has been silent for long makes room");
        assert_eq!(senders.iter().count(), 1 + MAX_GUESTS);
    }
}
