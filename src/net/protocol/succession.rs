//! Change of a process from one roster to the next: which one it takes, when that is in force, and when it repeats it
//! for those that have missed it. Pure.
//!
//! A roster is in force once it is on disk, so that a restart does not go back to an older one. If a member was
//! removed, the keys before it end at once. Otherwise both are valid for a while, so that no message is lost.

use super::codec::Frame;
use super::counts::Refusal;
use super::key::Key;
use super::link::LinkState;
use super::roster::{self, ACCEPTS_FOR, Collected, RosterError};
use crate::messages::ids::LinkId;
use crate::time::{Span, Time};

/// Time after a planned change from which datagrams leave with the new keys: all hosts that are heard have them by
/// then.
const SEALS_AFTER: Span = Span::from_millis(2000);
/// Period at which a roster is repeated, unless another member has just done so (RFC 6206).
const PERIOD: Span = Span::from_millis(1000);
/// Period of the first repetitions of a new roster, and their number.
const FIRST: (Span, u32) = (Span::from_millis(40), 5);
/// Shortest time between two rosters that are sent because a process seems to miss it, and between two arrivals of the
/// present one that are noted: an outsider can repeat it.
const ANSWER: Span = Span::from_millis(200);
/// Shortest time between two looks at a roster that does not name this process.
const LOOK: Span = Span::from_millis(10);
/// Time after which a roster that is not on disk yet is kept once more when it arrives again.
const KEEP_AGAIN: Span = Span::from_millis(1000);

/// What has become of a datagram with a roster.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Taken {
    /// The roster with this number has to be on disk before it is in force.
    Keep(u32, Frame),
    /// It was refused for this cause, and nothing has changed.
    Refused(Refusal),
    /// It does not name this process any more: the roster with this number has removed it.
    Removed(u32),
    /// It is not new, and its arrival was noted.
    Noted,
}

/// What is due.
#[derive(Debug, Default)]
pub(crate) struct Due {
    /// Keys that are in force from now on.
    pub key: Option<Key>,
    /// Whether the present roster has to be sent.
    pub repeat: bool,
}

/// Rosters of one process: that which is not in force yet, and the repetitions of the one that is.
#[derive(Debug, Default)]
pub(crate) struct Succession {
    /// Pages of the next roster that have arrived.
    collected: Collected,
    /// Pages of a roster that does not name this process, the number of the last such roster, and the time of the last
    /// look at one: an outsider can alter it, and each look may cost the check of a signature.
    without: Collected,
    removed: u32,
    looked: Option<Time>,
    /// Number and keys of a roster that is not on disk yet, with the time at which it was last asked to be kept.
    pending: Option<(u32, Key, Time)>,
    /// Keys of the roster before the present one while they are valid, and the time of the change.
    former: Option<(Key, Time)>,
    /// Whether datagrams leave with the keys of `former`.
    seals_former: bool,
    /// Time of the next repetition; `None` as long as the roster is that of the key files.
    next: Option<Time>,
    /// Number of quick repetitions that are left.
    quick: u32,
    /// Time at which the roster was last sent, and last noted.
    sent: Option<Time>,
    noted: Option<Time>,
}

impl Succession {
    /// Returns the state of a process that starts with `key`.
    pub fn new(key: Option<&Key>) -> Succession {
        let next = key.and_then(Key::sealed_roster).map(|_| Time::ZERO);
        Succession { next, ..Succession::default() }
    }

    /// Takes a datagram with a roster, in a process with the key `key`.
    pub fn take(&mut self, now: Time, key: Option<&Key>, (datagram, link): (&[u8], LinkId)) -> Taken {
        let Some(key) = key else { return Taken::Refused(Refusal::Keyed) };
        let number = super::codec::roster_of(datagram).and_then(roster::number_of);
        // To make its keys takes milliseconds, and every member repeats it.
        if self.pending.as_ref().is_some_and(|(pending, _, at)| Some(*pending) == number && now.since(*at) < KEEP_AGAIN)
        {
            return Taken::Refused(Refusal::Duplicate);
        }
        let next = match key.successor(datagram, link, &mut self.collected) {
            Ok(Some(next)) => next,
            Ok(None) => return Taken::Noted,
            Err(RosterError::Known) => return self.note(now, key, datagram),
            Err(RosterError::Malformed) => return Taken::Refused(Refusal::Malformed),
            Err(RosterError::Absent) => return self.without(now, key, datagram),
            Err(RosterError::Unsigned) => return Taken::Refused(Refusal::Auth),
            Err(RosterError::Repeated) => return Taken::Refused(Refusal::Duplicate),
        };
        let number = next.roster().map_or(0, |roster| roster.number);
        if self.pending.as_ref().is_some_and(|(pending, ..)| number < *pending) {
            return Taken::Refused(Refusal::Duplicate);
        }
        let Some(sealed) = next.sealed_roster().map(Frame::clone) else { return Taken::Refused(Refusal::Auth) };
        self.pending = Some((number, next, now));
        Taken::Keep(number, sealed)
    }

    /// Takes a page of a roster that does not name this process: it may have been removed.
    fn without(&mut self, now: Time, key: &Key, datagram: &[u8]) -> Taken {
        let checks = self.looked.is_none_or(|at| now.since(at) >= LOOK);
        if checks {
            self.looked = Some(now);
        }
        let removed = key.removal(datagram, &mut self.without, checks).filter(|number| *number > self.removed);
        self.removed = removed.unwrap_or(self.removed);
        removed.map_or(Taken::Refused(Refusal::Auth), Taken::Removed)
    }

    /// Notes a roster that is not newer than the present one: the same, which need not be repeated so soon, or an older
    /// one, whose sender needs the present one.
    fn note(&mut self, now: Time, key: &Key, datagram: &[u8]) -> Taken {
        let Some(present) = key.sealed_roster() else { return Taken::Refused(Refusal::Duplicate) };
        let same = super::codec::roster_of(datagram).is_some_and(|page| roster::is_of(page, present));
        if !same {
            return if self.ask(now) { Taken::Noted } else { Taken::Refused(Refusal::Replay) };
        }
        if self.quick > 0 || self.noted.is_some_and(|at| now.since(at) < ANSWER) {
            return Taken::Refused(Refusal::Duplicate);
        }
        (self.noted, self.next) = (Some(now), Some(now + PERIOD));
        Taken::Noted
    }

    /// Notes that a process of the team seems to miss the present roster. Returns whether it is sent because of that.
    pub fn ask(&mut self, now: Time) -> bool {
        let due = self.next.is_some_and(|next| next > now) && self.sent.is_none_or(|at| now.since(at) >= ANSWER);
        if due {
            self.next = Some(now);
        }
        due
    }

    /// Notes that the roster with this number is on disk. Returns the keys that are in force from now on, in a process
    /// with the key `key`; `None` if that is not the one that was to be kept.
    pub fn kept(&mut self, now: Time, key: &Key, number: u32) -> Option<Key> {
        let (_, next, _) = self.pending.take_if(|(pending, ..)| *pending == number)?;
        (self.next, self.quick, self.sent) = (Some(now), FIRST.1, None);
        if next.roster().is_some_and(|roster| roster.planned) {
            let former = key.clone().alone();
            let both = next.beside(&former, true);
            (self.former, self.seals_former) = (Some((former, now)), true);
            return Some(both);
        }
        self.former = None;
        Some(next)
    }

    /// Returns the time at which `wake` has to be called next; `None` if nothing is due.
    pub fn due(&self) -> Option<Time> {
        let stage = if self.seals_former { SEALS_AFTER } else { ACCEPTS_FOR };
        let change = self.former.as_ref().map(|(_, since)| *since + stage);
        [self.next, change].into_iter().flatten().min()
    }

    /// Returns what is due at `now` in a process with the key `key`.
    pub fn wake(&mut self, now: Time, key: &Key) -> Due {
        let mut due = Due::default();
        if let Some((former, since)) = &self.former {
            let age = now.since(*since);
            if age >= ACCEPTS_FOR {
                (self.former, due.key) = (None, Some(key.clone().alone()));
            } else if age >= SEALS_AFTER && self.seals_former {
                (self.seals_former, due.key) = (false, Some(key.clone().beside(former, false)));
            }
        }
        if self.next.is_some_and(|next| next <= now) {
            let period = if self.quick > 0 { FIRST.0 } else { PERIOD };
            self.quick = self.quick.saturating_sub(1);
            (self.next, self.sent, due.repeat) = (Some(now + period), Some(now), true);
        }
        due
    }
}

impl LinkState {
    /// Takes the keys of another roster. Of members that are not in it nothing is accepted from now on.
    pub(crate) fn rekey(&mut self, key: &Key) {
        (self.key, self.outgoing.key) = (Some(key.clone()), Some(key.clone()));
        self.outgoing.room = key.room();
        let members = key.roster().map(|roster| &roster.members);
        if let Some(members) = members.filter(|members| !members.is_empty()) {
            self.incoming.senders.keep(|host| members.contains_key(&host));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::codec::{self, Flags, Header};
    use super::super::member::{Member, public, seal_roster};
    use super::super::roster::Roster;
    use super::*;
    use crate::messages::ids::HostId;

    const LINK: LinkId = LinkId(0);
    const ROOT: [u8; 32] = [99; 32];

    fn secret(member: u16) -> [u8; 32] {
        *blake3::hash(&member.to_le_bytes()).as_bytes()
    }

    fn roster(number: u32, planned: bool) -> Roster {
        let members = (0..2).map(|member| (HostId(member), public(&secret(member)))).collect();
        Roster { number, planned, members }
    }

    fn key(host: u16) -> Key {
        let own = (HostId(host), secret(host));
        Member::new(7, own, public(&ROOT), (roster(1, false), [1; 32])).map(Key::of).expect("it is one of them")
    }

    fn header(sender: u16) -> Header {
        Header { flags: Flags(0), team: 7, sender: HostId(sender), incarnation: 1, sequence: 1 }
    }

    fn datagram(number: u32, planned: bool) -> Frame {
        let sealed = seal_roster((7, &roster(number, planned)), &ROOT, &[number as u8; 32], [number as u8; 24]);
        codec::with_roster(&header(1), &roster::pages(&sealed.expect("few members"))[0])
    }

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Whether host 0 and host 1, with these keys, hear each other: the first the second, and the reverse.
    fn hear(first: &Key, second: &Key) -> [bool; 2] {
        let hears = |here: (u16, &Key), there: (u16, &Key)| {
            let mut sealed = codec::start(&header(there.0));
            there.1.seal(&mut sealed, LINK, None);
            here.1.open(&sealed, LINK, HostId(here.0)).is_some()
        };
        [hears((0, first), (1, second)), hears((1, second), (0, first))]
    }

    /// Takes the datagram and keeps its roster at once; returns the keys from then on.
    fn changed(rosters: &mut Succession, ms: u64, key: &Key, datagram: &Frame) -> Key {
        let Taken::Keep(number, _) = rosters.take(at(ms), Some(key), (datagram, LINK)) else { panic!("it is new") };
        rosters.kept(at(ms), key, number).expect("it was to be kept")
    }

    #[test]
    fn nothing_is_in_force_or_sent_before_a_roster_is_on_disk() {
        let (key, mut rosters) = (key(0), Succession::default());
        assert_eq!(rosters.due(), None);
        let second = datagram(2, false);
        assert!(matches!(rosters.take(at(0), Some(&key), (&second, LINK)), Taken::Keep(2, _)));
        assert_eq!(rosters.due(), None);
        let again = |rosters: &mut Succession, ms| rosters.take(at(ms), Some(&key), (&second, LINK));
        assert_eq!(again(&mut rosters, 1), Taken::Refused(Refusal::Duplicate));
        assert!(matches!(again(&mut rosters, 1000), Taken::Keep(2, _)), "it could not be written");
        assert!(rosters.kept(at(1001), &key, 3).is_none(), "another one");
        // A newer one takes its place.
        assert!(matches!(rosters.take(at(1002), Some(&key), (&datagram(3, false), LINK)), Taken::Keep(3, _)));
        assert!(rosters.kept(at(1003), &key, 2).is_none());
        let third = rosters.kept(at(1004), &key, 3).expect("it is on disk");
        assert_eq!(third.roster().map(|roster| roster.number), Some(3));
        assert_eq!(rosters.take(at(1005), Some(&third), (&second, LINK)), Taken::Refused(Refusal::Replay));
        assert_eq!(rosters.take(at(1005), None, (&second, LINK)), Taken::Refused(Refusal::Keyed));
    }

    #[test]
    fn after_a_revocation_the_keys_before_it_end_at_once_and_after_a_planned_change_later() {
        let (old, there) = (key(0), key(1));
        let mut rosters = Succession::default();
        let revoked = changed(&mut rosters, 0, &old, &datagram(2, false));
        let other = changed(&mut Succession::default(), 0, &there, &datagram(2, false));
        assert_eq!((hear(&revoked, &there), hear(&revoked, &other)), ([false; 2], [true; 2]));

        let planned = changed(&mut rosters, 0, &revoked, &datagram(3, true));
        let other_third = changed(&mut Succession::default(), 0, &other, &datagram(3, true));
        assert_eq!(hear(&planned, &other), [true; 2], "one that has missed it");
        assert_eq!(hear(&planned, &other_third), [true; 2]);
        let keys_at = |rosters: &mut Succession, ms, key: &Key| {
            let due =
                std::iter::from_fn(|| rosters.due().filter(|due| *due <= at(ms)).map(|due| rosters.wake(due, key)));
            due.filter_map(|due| due.key).last().expect("it is due")
        };
        let seals = keys_at(&mut rosters, 2000, &planned);
        assert_eq!(hear(&seals, &other), [true, false]);
        let alone = keys_at(&mut rosters, 10_000, &seals);
        assert_eq!((hear(&alone, &other), hear(&alone, &other_third.alone())), ([false; 2], [true; 2]));
    }

    #[test]
    fn a_roster_is_repeated_soon_and_then_once_a_second_unless_another_member_has_done_so() {
        let mut rosters = Succession::default();
        let second = datagram(2, false);
        let key = changed(&mut rosters, 0, &key(0), &second);
        let mut sent = Vec::new();
        let mut run = |rosters: &mut Succession, to: u64| {
            sent.clear();
            while let Some(due) = rosters.due().filter(|due| *due <= at(to)) {
                if rosters.wake(due, &key).repeat {
                    sent.push(due.since(Time::ZERO).as_nanos() / 1_000_000);
                }
            }
            sent.clone()
        };
        assert_eq!(run(&mut rosters, 2500), [0, 40, 80, 120, 160, 200, 1200, 2200]);
        assert_eq!(rosters.take(at(3000), Some(&key), (&second, LINK)), Taken::Noted);
        for ms in 3001..3200 {
            assert_eq!(rosters.take(at(ms), Some(&key), (&second, LINK)), Taken::Refused(Refusal::Duplicate));
        }
        assert_eq!(run(&mut rosters, 4100), [4000]);
        // A process with an older one, or none, gets it.
        assert_eq!(rosters.take(at(4210), Some(&key), (&datagram(1, false), LINK)), Taken::Noted);
        assert_eq!(run(&mut rosters, 4300), [4210]);
        assert!(!rosters.ask(at(4300)) && rosters.ask(at(4500)));
        assert_eq!(run(&mut rosters, 4600), [4500]);
    }

    #[test]
    fn a_process_that_was_removed_learns_it_once_from_the_root_key_alone() {
        let (key, mut rosters) = (key(0), Succession::default());
        let without = |number: u32, root: &[u8; 32], members: &[u16]| {
            let members = members.iter().map(|member| (HostId(*member), public(&secret(*member)))).collect();
            let roster = Roster { number, planned: false, members };
            let sealed = seal_roster((7, &roster), root, &[1; 32], [1; 24]).expect("few members");
            roster::pages(&sealed).iter().map(|page| codec::with_roster(&header(1), page)).collect::<Vec<Frame>>()
        };
        let take = |rosters: &mut Succession, ms: u64, frames: &[Frame]| -> Vec<Taken> {
            frames.iter().map(|frame| rosters.take(at(ms), Some(&key), (frame, LINK))).collect()
        };
        let refused = [Taken::Refused(Refusal::Auth)];
        assert_eq!(take(&mut rosters, 0, &without(2, &[98; 32], &[1])), refused, "of another root");
        assert_eq!(take(&mut rosters, 1, &without(2, &ROOT, &[1])), refused, "no more looks for a while");
        assert_eq!(take(&mut rosters, 20, &without(2, &ROOT, &[1])), [Taken::Removed(2)]);
        assert_eq!(take(&mut rosters, 40, &without(2, &ROOT, &[1])), refused, "it is said once");
        let many: Vec<u16> = (1..20).collect();
        assert_eq!(
            take(&mut rosters, 60, &without(3, &ROOT, &many)),
            [Taken::Refused(Refusal::Auth), Taken::Removed(3)]
        );
        let all: Vec<u16> = (0..20).collect();
        let named = take(&mut rosters, 80, &without(4, &ROOT, &all));
        assert!(matches!(&named[..], [Taken::Noted, Taken::Keep(4, _)]), "it is back: {named:?}");
    }
}
