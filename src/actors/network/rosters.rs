//! The part of a Network that changes the keys of its host: it takes rosters, asks for them to be kept, and repeats the
//! present one.

use super::{Network, Out, transmit};
use crate::messages::ids::LinkId;
use crate::net::protocol::codec::{self, Frame};
use crate::net::protocol::counts::Refusal;
use crate::net::protocol::key::Key;
use crate::net::protocol::link::LinkState;
use crate::net::protocol::roster;
use crate::net::protocol::router::Audience;
use crate::net::protocol::succession::Taken;
use crate::time::Time;

impl Network {
    /// Takes a datagram with a roster.
    #[cold]
    pub(super) fn take_roster(&mut self, now: Time, link: LinkId, frame: &Frame, out: &mut Vec<Out>) {
        let team = codec::peek(frame).map(|header| header.team);
        let taken = if team == Ok(self.local_header.team) {
            self.succession.take(now, self.key.as_ref(), (frame, link))
        } else {
            Taken::Refused(Refusal::Team)
        };
        match taken {
            Taken::Keep(number, sealed) => out.push(Out::Keep(number, sealed)),
            Taken::Noted => {}
            Taken::Removed(number) => {
                tracing::error!(
                    "the key of this process was revoked: it is not in roster {number} of its team, and no member \
                     hears it any more. Make a new key with 'key add', or end it"
                );
                self.refuse_roster((link, Refusal::Auth), frame, out);
            }
            Taken::Refused(cause) => self.refuse_roster((link, cause), frame, out),
        }
    }

    fn refuse_roster(&mut self, (link, cause): (LinkId, Refusal), frame: &Frame, out: &mut Vec<Out>) {
        if let Some(state) = self.link(link) {
            state.counts().refuse(cause, 1);
        }
        out.push(Out::Refused(link, cause, Frame::clone(frame)));
    }

    /// Returns whether a datagram that was refused for `cause` seems to be of a member with the keys of an older
    /// roster, so that the present one is sent because of it.
    pub(super) fn misses_roster(&mut self, now: Time, cause: Refusal, frame: &Frame) -> bool {
        matches!(cause, Refusal::OtherKey | Refusal::Auth)
            && codec::peek(frame).is_ok_and(|header| header.team == self.local_header.team)
            && self.succession.ask(now)
    }

    /// Puts the roster with this number in force, which is on disk now.
    pub(super) fn change_roster(&mut self, now: Time, number: u32, out: &mut Vec<Out>) {
        let Some(key) = self.key.as_ref().and_then(|key| self.succession.kept(now, key, number)) else { return };
        let members = key.roster().map_or(0, |roster| roster.members.len());
        tracing::warn!("roster {number} of this team is in force: {members} members");
        self.rekey(key, out);
        self.tell_roster(out);
    }

    /// Sends the roster and ends the keys before it when that is due.
    #[cold]
    pub(super) fn go_on_with_roster(&mut self, now: Time, out: &mut Vec<Out>) {
        let Some(key) = &self.key else { return };
        let due = self.succession.wake(now, key);
        if let Some(sealed) = key.sealed_roster().filter(|_| due.repeat) {
            let pages = roster::pages(sealed).into_iter().map(|page| codec::with_roster(&self.local_header, &page));
            let datagrams: Vec<Frame> = pages.collect();
            for (link, _) in (0..=u16::MAX).map(LinkId).zip(&self.links).filter(|(_, state)| state.is_some()) {
                self.outgoing.extend(datagrams.iter().map(|datagram| (Audience::All, Frame::clone(datagram))));
                transmit(link, &mut self.outgoing, out);
            }
        }
        if let Some(key) = due.key {
            self.rekey(key, out);
        }
    }

    fn rekey(&mut self, key: Key, out: &mut Vec<Out>) {
        self.links.iter_mut().flatten().for_each(|state: &mut LinkState| state.rekey(&key));
        out.push(Out::Keys(Box::new(key.clone())));
        self.key = Some(key);
    }

    /// Says which roster is in force, unless it is that of the key files.
    pub(super) fn tell_roster(&self, out: &mut Vec<Out>) {
        let sealed = self.key.as_ref().filter(|key| key.sealed_roster().is_some());
        out.extend(sealed.and_then(Key::roster).map(|roster| Out::Roster(Box::new(roster.clone()))));
    }
}
