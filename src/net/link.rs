//! What a host remembers of one link: its own sequence numbers, the newest frame of every sender, and a
//! count of everything that was let in or refused, by cause. Pure; no sockets, no clock.

use std::collections::BTreeMap;
use std::iter::Sum;

use serde::{Deserialize, Serialize};

use super::codec::{DecodeError, Header};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Kind;

/// Frames of one link, as one host counted them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct LinkCounts {
    /// Sent.
    pub sent: u64,
    /// Not sent: out of the ranges of their kind.
    pub unfit: u64,
    /// Received and let in.
    pub accepted: u64,
    /// Refused: own frames, heard back.
    pub own: u64,
    /// Refused: of another team.
    pub team: u64,
    /// Refused: of another version.
    pub version: u64,
    /// Refused: the same frame again.
    pub duplicate: u64,
    /// Refused: older than what is already here, or of an earlier epoch.
    pub stale: u64,
    /// Refused: not a message.
    pub malformed: u64,
    /// Refused: about a robot that is not on this host.
    pub misrouted: u64,
}

impl LinkCounts {
    /// Everything that was refused, whatever the cause.
    pub fn refused(&self) -> u64 {
        self.own + self.team + self.version + self.duplicate + self.stale + self.malformed + self.misrouted
    }
}

impl Sum for LinkCounts {
    fn sum<I: Iterator<Item = LinkCounts>>(all: I) -> LinkCounts {
        all.fold(LinkCounts::default(), |sum, one| LinkCounts {
            sent: sum.sent + one.sent,
            unfit: sum.unfit + one.unfit,
            accepted: sum.accepted + one.accepted,
            own: sum.own + one.own,
            team: sum.team + one.team,
            version: sum.version + one.version,
            duplicate: sum.duplicate + one.duplicate,
            stale: sum.stale + one.stale,
            malformed: sum.malformed + one.malformed,
            misrouted: sum.misrouted + one.misrouted,
        })
    }
}

/// One link as one host sees it.
#[derive(Clone, Debug)]
pub struct LinkState {
    host: HostId,
    team: u16,
    epoch: u32,
    next_sequence: u32,
    senders: BTreeMap<HostId, Sender>,
    counts: LinkCounts,
}

#[derive(Clone, Debug, Default)]
struct Sender {
    epoch: u32,
    /// The newest sequence number of each stream: a kind about a robot.
    newest: BTreeMap<(Kind, RobotId), u32>,
}

impl LinkState {
    /// The state at the start of `epoch`.
    pub fn new(host: HostId, team: u16, epoch: u32) -> LinkState {
        let counts = LinkCounts::default();
        LinkState { host, team, epoch, next_sequence: 0, senders: BTreeMap::new(), counts }
    }

    /// The header of the next frame that this host sends here.
    pub fn stamp(&mut self, kind: Kind) -> Header {
        let sequence = self.next_sequence;
        self.next_sequence = sequence.wrapping_add(1);
        self.counts.sent += 1;
        Header { kind, team: self.team, sender: self.host, epoch: self.epoch, sequence }
    }

    /// Whether a frame with this header is worth decoding.
    pub fn admit(&mut self, header: &Header) -> bool {
        let cause = if header.sender == self.host {
            &mut self.counts.own
        } else if header.team != self.team {
            &mut self.counts.team
        } else {
            return true;
        };
        *cause += 1;
        false
    }

    /// Whether a decoded message about `robot` is the newest of its stream; all kinds are state, so an
    /// older one is worth nothing.
    pub fn accept(&mut self, header: &Header, robot: RobotId) -> bool {
        let sender = self.senders.entry(header.sender).or_default();
        if header.epoch < sender.epoch {
            self.counts.stale += 1;
            return false;
        }
        if header.epoch > sender.epoch {
            *sender = Sender { epoch: header.epoch, newest: BTreeMap::new() };
        }
        if let Some(newest) = sender.newest.get_mut(&(header.kind, robot)) {
            // Serial number arithmetic (RFC 1982): half of the numbers are ahead, half behind.
            let ahead = header.sequence.wrapping_sub(*newest);
            if ahead == 0 {
                self.counts.duplicate += 1;
                return false;
            }
            if ahead > u32::MAX / 2 {
                self.counts.stale += 1;
                return false;
            }
            *newest = header.sequence;
        } else {
            sender.newest.insert((header.kind, robot), header.sequence);
        }
        self.counts.accepted += 1;
        true
    }

    /// Counts a message that could not be sent; whether it is the first.
    pub fn unfit(&mut self) -> bool {
        self.counts.unfit += 1;
        self.counts.unfit == 1
    }

    /// Counts bytes that are no frame.
    pub fn refuse(&mut self, error: &DecodeError) {
        match error {
            DecodeError::Version(_) => self.counts.version += 1,
            _ => self.counts.malformed += 1,
        }
    }

    /// Counts a message that nobody on this host wants.
    pub fn misrouted(&mut self) {
        self.counts.misrouted += 1;
    }

    /// What has happened so far.
    pub fn counts(&self) -> LinkCounts {
        self.counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(epoch: u32, sequence: u32) -> Header {
        Header { kind: Kind::Latent, team: 1, sender: HostId(2), epoch, sequence }
    }

    #[test]
    fn the_newest_wins_across_a_wrap_and_a_restart() {
        let mut link = LinkState::new(HostId(1), 1, 1);
        let robot = RobotId(0);
        assert!(link.accept(&header(1, u32::MAX), robot));
        assert!(link.accept(&header(1, 0), robot), "the sequence wraps");
        assert!(!link.accept(&header(1, u32::MAX), robot), "older than the newest");
        assert!(!link.accept(&header(1, 0), robot), "the same again");
        assert!(link.accept(&header(2, 0), robot), "a restarted sender starts anew");
        assert!(!link.accept(&header(1, 9), robot), "its former self is stale");
        let counts = link.counts();
        assert_eq!((counts.accepted, counts.stale, counts.duplicate), (3, 2, 1));
    }

    #[test]
    fn own_frames_and_other_teams_are_refused() {
        let mut link = LinkState::new(HostId(2), 1, 1);
        assert!(!link.admit(&header(1, 0)));
        let mut link = LinkState::new(HostId(1), 7, 1);
        assert!(!link.admit(&header(1, 0)));
        assert_eq!(link.counts().team, 1);
    }
}
