//! Key of a recorded host, followed through the record: rosters of the team change it during a run.

use std::borrow::Cow;

use data_encoding::HEXLOWER_PERMISSIVE;
use murmurate::graph::inputs::Input;
use murmurate::messages::ids::{HostId, LinkId};
use murmurate::net::protocol::codec::{self, Frame};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::roster::{ACCEPTS_FOR, Collected};
use murmurate::time::Time;

use super::identity::HostIdentity;

/// Key of a recorded host at one moment of its record.
#[derive(Clone)]
pub struct RecordedKey {
    host: HostId,
    key: Key,
    /// Pages of the next roster that had arrived.
    collected: Collected,
    /// Number and keys of a roster that had arrived and was not on disk yet.
    pending: Option<(u32, Key)>,
    /// Time of a planned change, after which the keys before it are valid for a while.
    planned: Option<Time>,
}

/// Returns the roster with which the recorded host `of` has begun; `None` if it was that of its key file.
pub fn first_roster(of: &HostIdentity) -> Option<Frame> {
    let sealed = HEXLOWER_PERMISSIVE.decode(of.roster.as_bytes()).ok().filter(|sealed| !sealed.is_empty())?;
    Some(sealed.into())
}

/// Returns the key with which the recorded host `of` has begun, from that of its key file.
pub fn first_key(key: &Key, of: &HostIdentity) -> Key {
    first_roster(of).and_then(|sealed| key.by_roster(&sealed).ok()).unwrap_or_else(|| key.clone())
}

impl RecordedKey {
    /// Returns the key at the beginning of the record of the host `of`, from that of its key file.
    pub fn new(key: &Key, of: &HostIdentity) -> RecordedKey {
        RecordedKey {
            host: of.id,
            key: first_key(key, of),
            collected: Collected::default(),
            pending: None,
            planned: None,
        }
    }

    /// Takes an input of the host at the time `now`, of which rosters change the key.
    pub fn follow(&mut self, now: Time, input: &Input) {
        if self.planned.is_some_and(|since| now.since(since) >= ACCEPTS_FOR) {
            (self.key, self.planned) = (self.key.clone().alone(), None);
        }
        match input {
            Input::Frame(link, frame, _) if codec::roster_of(frame).is_some() => {
                let Ok(Some(next)) = self.key.successor(frame, *link, &mut self.collected) else { return };
                let number = next.roster().map_or(0, |roster| roster.number);
                if self.pending.as_ref().is_none_or(|(pending, _)| *pending < number) {
                    self.pending = Some((number, next));
                }
            }
            Input::Kept(number) => {
                let Some((_, next)) = self.pending.take_if(|(pending, _)| pending == number) else { return };
                let planned = next.roster().is_some_and(|roster| roster.planned);
                let former = self.key.clone().alone();
                self.planned = planned.then_some(now);
                self.key = if planned { next.beside(&former, false) } else { next };
            }
            _ => {}
        }
    }

    /// Returns a datagram that has arrived on the link `link` without its tag, and in clear; of a roster, which has no
    /// tag, the datagram itself. `None` if the host has refused it.
    pub fn open<'a>(&self, frame: &'a [u8], link: LinkId) -> Option<Cow<'a, [u8]>> {
        if codec::roster_of(frame).is_some() {
            let taken = self.key.successor(frame, link, &mut self.collected.clone());
            return taken.is_ok().then_some(frame.into());
        }
        self.key.open(frame, link, self.host)
    }
}

#[cfg(test)]
mod tests {
    use murmurate::messages::ids::HostId;
    use murmurate::net::protocol::codec::{Flags, Header};
    use murmurate::net::protocol::key::digest;
    use murmurate::net::protocol::member::{Member, public, seal_roster};
    use murmurate::net::protocol::roster::{self, Roster};

    use super::*;

    const ROOT: [u8; 32] = [99; 32];

    fn secret(member: u16) -> [u8; 32] {
        [member as u8 + 1; 32]
    }

    /// Roster of 20 members, which has two pages.
    fn roster(number: u32) -> Roster {
        let members = (0..20).map(|member| (HostId(member), public(&secret(member)))).collect();
        Roster { number, planned: false, members }
    }

    #[test]
    fn a_roster_of_two_pages_changes_the_key_once_both_have_arrived_and_it_is_on_disk() {
        let own = Member::new(7, (HostId(3), secret(3)), public(&ROOT), (roster(1), [1; 32])).expect("a member");
        let key = Key::of(own);
        let mut recorded = RecordedKey {
            host: HostId(3),
            key: key.clone(),
            collected: Collected::default(),
            pending: None,
            planned: None,
        };
        let header = Header { flags: Flags::default(), team: 7, sender: HostId(1), incarnation: 1, sequence: 0 };
        let sealed = seal_roster((7, &roster(2)), &ROOT, &[2; 32], [2; 24]).expect("few members");
        let pages: Vec<Frame> = roster::pages(&sealed).iter().map(|page| codec::with_roster(&header, page)).collect();
        let link = LinkId(0);
        let number = |recorded: &RecordedKey| recorded.key.roster().map(|roster| roster.number);
        assert!(recorded.open(&pages[1], link).is_none(), "the page that names it has to be the first");
        for at in [1, 0, 1] {
            recorded.follow(Time::ZERO, &Input::Frame(link, Frame::clone(&pages[at]), None));
        }
        assert_eq!(number(&recorded), Some(1), "it is not on disk");
        recorded.follow(Time::ZERO, &Input::Kept(2));
        assert_eq!(number(&recorded), Some(2));
        // In a replay without keys the datagrams that were accepted take their place.
        let accepted = pages.iter().map(|page| digest(page, link)).collect();
        let mut trusting = RecordedKey { key: Key::trusting(accepted).with_trusted_rosters(None), ..recorded };
        for at in [0, 1] {
            trusting.follow(Time::ZERO, &Input::Frame(link, Frame::clone(&pages[at]), None));
        }
        trusting.follow(Time::ZERO, &Input::Kept(2));
        assert_eq!(number(&trusting), Some(2));
    }
}
