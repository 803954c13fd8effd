//! Counters of one host on one link: datagrams sent, messages accepted, and everything dropped, by cause.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

use super::codec::DecodeError;

macro_rules! counts {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Counters of the datagrams and messages of one host, on one link or summed over its links.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(default)]
        pub struct LinkCounts {
            $($(#[$doc])* pub $name: u64,)*
        }

        impl Sum for LinkCounts {
            fn sum<I: Iterator<Item = LinkCounts>>(all: I) -> LinkCounts {
                all.fold(LinkCounts::default(), |sum, one| LinkCounts { $($name: sum.$name + one.$name,)* })
            }
        }
    };
}

counts! {
    /// Datagrams sent with data, without retransmissions; plus the messages that were published and stayed on the host.
    sent,
    /// Retransmissions: timed repeats, requested ones, and retries without an acknowledgement.
    copies,
    /// Datagrams sent with only soft state: heartbeats, instructions, telemetry, link reports, acknowledgements,
    /// requests.
    soft,
    /// Messages that were given up: not acknowledged by all receivers after all retransmissions.
    lapsed,
    /// Messages not sent, because they are outside the ranges of their kind.
    unfit,
    /// Messages that were received and accepted, for actors of this host.
    accepted,
    /// Messages accepted from a retransmission, because the first transmission was lost.
    repaired,
    /// Messages ignored: they are for another host, and arrive here because datagrams on this link reach all hosts. Not
    /// a fault.
    aside,
    /// Datagrams refused: they were sent by this process itself.
    own,
    /// Datagrams refused: the tag is missing or wrong, or there is a tag and no key to check it.
    auth,
    /// Of those in `auth`: they come from a host of this team, by version, team and sender, with a tag of another key.
    other_key,
    /// Of those in `auth`: they come from a host of this team without a tag, although this host has a key.
    untagged,
    /// Of those in `auth`: they come from a host of this team with a tag, although this host has no key.
    keyed,
    /// Of those in `auth`: they come from a host of this team, and are encrypted although this host's are not, or in
    /// clear although this host's are encrypted.
    confidential,
    /// Datagrams refused on a link with authentication: older than the replay window, or of an earlier incarnation.
    replay,
    /// Datagrams refused: held back on the way. Either sent before a link report that arrived long ago, or a link
    /// report that was long in transit.
    late,
    /// Datagrams refused: their number is further ahead than their sender can have sent.
    ahead,
    /// Emergency stops accepted from datagrams that are refused for their number.
    urgent,
    /// Datagrams refused: their sender has not proved its liveness yet.
    unproven,
    /// Datagrams refused: they are from a second live host with the same id.
    #[serde(rename = "twin")]
    duplicate_id,
    /// Datagrams refused: they are from another team.
    team,
    /// Datagrams refused: they have another version of the wire format.
    version,
    /// Blocks passed over in accepted datagrams: their content is of a later version.
    skipped,
    /// Messages refused: outside the ranges of their kind.
    range,
    /// Datagrams and messages refused: they were received before.
    duplicate,
    /// Messages refused: older than the newest message of their stream.
    stale,
    /// Datagrams refused: their sender sends more than the rate limit permits.
    rate,
    /// Datagrams refused: the table of accepted senders is full.
    crowd,
    /// Datagrams dropped: a queue of the transport was full.
    queue,
    /// Datagrams refused: their bytes do not have the form of the wire format.
    malformed,
    /// Messages refused: from a host that may not publish them, or about a robot that is not on this host.
    misrouted,
    /// Messages refused: without the signature that they need, such as a re-arm without that of an operator for this
    /// run of the host; or with more new signatures than are checked of one sender.
    unsigned,
    /// Messages refused: parts of a message of a robot that runs another policy, or that contradict each other.
    mixed,
    /// Parts of messages that have not arrived in time, although others of the same message have.
    incomplete,
    /// Entries of other hosts' soft state that were passed on, on a mesh.
    passed_on,
    /// Messages of other hosts that came over hops, and were believed.
    over_hops,
    /// Entries of soft state refused: without the proof of their origin, or malformed.
    forged,
    /// Entries of soft state refused: their origin made them more than two seconds ago, or nothing shows when.
    unfresh,
}

/// Cause for which a datagram is refused without any effect but its count: the state of the link after it is as before.
/// So a record needs the number of such datagrams and not their bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Refusal {
    /// The tag is missing or wrong, or there is a tag and no key.
    Auth,
    /// It was sent by this process itself.
    Own,
    /// It is from another team.
    Team,
    /// It has another version of the wire format.
    Version,
    /// A value in it is out of range.
    Range,
    /// Its bytes do not have the form of the wire format.
    Malformed,
    /// It was received before.
    Duplicate,
    /// It is older than the replay window, or of an earlier incarnation.
    Replay,
    /// It was held back on the way.
    Late,
    /// Its sender has not proved its liveness, and this datagram does not help it to.
    Unproven,
    /// It is from a second host with the id of this one, on a link without a key.
    DuplicateId,
    /// Its tag is wrong, and its header is that of a host of this team: that host has another key.
    OtherKey,
    /// It has no tag, and its header is that of a host of this team: that host has no key.
    Untagged,
    /// It has a tag, its header is that of a host of this team, and this host has no key.
    Keyed,
    /// Its number is further ahead than its sender can have sent.
    Ahead,
    /// Its header is that of a host of this team, and it is encrypted and this host's are not, or the reverse.
    Confidential,
}

impl Refusal {
    /// All causes, in the order of their numbers in records.
    pub const ALL: [Refusal; 16] = [
        Refusal::Auth,
        Refusal::Own,
        Refusal::Team,
        Refusal::Version,
        Refusal::Range,
        Refusal::Malformed,
        Refusal::Duplicate,
        Refusal::Replay,
        Refusal::Late,
        Refusal::Unproven,
        Refusal::DuplicateId,
        Refusal::OtherKey,
        Refusal::Untagged,
        Refusal::Keyed,
        Refusal::Ahead,
        Refusal::Confidential,
    ];
}

impl Refusal {
    /// Returns the cause of a datagram that cannot be decoded.
    pub(super) fn of(error: &DecodeError) -> Refusal {
        match error {
            DecodeError::Version(_) => Refusal::Version,
            DecodeError::Unfit(..) => Refusal::Range,
            _ => Refusal::Malformed,
        }
    }
}

impl LinkCounts {
    /// Notes that the datagram that was counted last as sent is a retransmission.
    pub(crate) fn sent_again(&mut self) {
        self.sent = self.sent.saturating_sub(1);
        self.copies += 1;
    }

    /// Counts `number` datagrams that were refused for this cause.
    pub(crate) fn refuse(&mut self, cause: Refusal, number: u64) {
        if matches!(cause, Refusal::OtherKey | Refusal::Untagged | Refusal::Keyed | Refusal::Confidential) {
            self.auth += number;
        }
        let count = match cause {
            Refusal::Auth => &mut self.auth,
            Refusal::Own => &mut self.own,
            Refusal::Team => &mut self.team,
            Refusal::Version => &mut self.version,
            Refusal::Range => &mut self.range,
            Refusal::Malformed => &mut self.malformed,
            Refusal::Duplicate => &mut self.duplicate,
            Refusal::Replay => &mut self.replay,
            Refusal::Late => &mut self.late,
            Refusal::Unproven => &mut self.unproven,
            Refusal::DuplicateId => &mut self.duplicate_id,
            Refusal::OtherKey => &mut self.other_key,
            Refusal::Untagged => &mut self.untagged,
            Refusal::Keyed => &mut self.keyed,
            Refusal::Ahead => &mut self.ahead,
            Refusal::Confidential => &mut self.confidential,
        };
        *count += number;
    }

    /// Returns the number of datagrams and messages that were refused or dropped on arrival, for any cause.
    #[cfg(test)]
    pub fn refused(&self) -> u64 {
        self.refusals().iter().map(|(_, count)| count).sum()
    }

    /// Returns the number of datagrams and messages refused or dropped on arrival, for each cause: (name, number).
    pub fn refusals(&self) -> [(&'static str, u64); 21] {
        [
            ("own", self.own),
            ("auth", self.auth),
            ("replay", self.replay),
            ("late", self.late),
            ("ahead", self.ahead),
            ("unproven", self.unproven),
            ("duplicate-id", self.duplicate_id),
            ("team", self.team),
            ("version", self.version),
            ("range", self.range),
            ("duplicate", self.duplicate),
            ("stale", self.stale),
            ("rate", self.rate),
            ("crowd", self.crowd),
            ("queue", self.queue),
            ("malformed", self.malformed),
            ("misrouted", self.misrouted),
            ("unsigned", self.unsigned),
            ("mixed", self.mixed),
            ("forged", self.forged),
            ("unfresh", self.unfresh),
        ]
    }

    /// Returns the number of datagrams and messages that were refused or dropped on arrival for each cause that may
    /// have lost a message: (number, cause in words), without zeros. Left out is what costs nothing: own datagrams,
    /// second copies, messages that a newer one has replaced, and datagrams of hosts that have just started or
    /// restarted.
    pub fn losses(&self) -> impl Iterator<Item = (u64, &'static str)> {
        let all = [
            (self.auth, "with a wrong tag or none"),
            (self.replay, "of former runs"),
            (self.late, "held back on the way"),
            (self.ahead, "numbered beyond what was sent"),
            (self.duplicate_id, "of a second host with one id"),
            (self.team, "of another team"),
            (self.version, "of another version"),
            (self.range, "out of range"),
            (self.rate, "beyond the rate limit"),
            (self.crowd, "of too many senders"),
            (self.queue, "by full queues"),
            (self.malformed, "malformed"),
            (self.misrouted, "from a host that may not send them"),
            (self.unsigned, "without the signature that they need"),
            (self.mixed, "of another policy"),
        ];
        all.into_iter().filter(|(count, _)| *count > 0)
    }

    /// Returns why this host understands nothing of its team although it hears it: their keys differ, or only one of
    /// the two encrypts. `None` if messages were accepted, or if nothing of the team was heard.
    pub fn key_trouble(&self) -> Option<&'static str> {
        match self {
            LinkCounts { accepted: 1.., .. } => None,
            LinkCounts { other_key: 1.., .. } => Some(
                "the team is heard, and it has another key than this machine: compare the fingerprints that \
                 'murmurate doctor' shows, here and on a host",
            ),
            LinkCounts { untagged: 1.., .. } => Some(
                "the team is heard, and it has no key, but this machine has one: leave out key_file and --key-file",
            ),
            LinkCounts { confidential: 1.., .. } => Some(
                "the team is heard, and only one of it and this machine encrypts: give both the same 'confidential' \
                 in the team file",
            ),
            LinkCounts { keyed: 1.., .. } => Some(
                "the team is heard, and it has a key, but this machine has none: give the team's key by --key-file",
            ),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_costs_no_message_is_no_loss_and_every_other_cause_has_words() {
        let one = LinkCounts { own: 1, duplicate: 1, stale: 1, unproven: 1, ..LinkCounts::default() };
        assert_eq!((one.refused(), one.losses().count()), (4, 0));
        let late = LinkCounts { late: 3, ..one };
        assert_eq!(late.losses().collect::<Vec<_>>(), [(3, "held back on the way")]);
    }

    #[test]
    fn a_key_is_blamed_only_if_the_team_is_heard_and_nothing_of_it_accepted() {
        let none = LinkCounts { auth: 5, ..LinkCounts::default() };
        assert_eq!(none.key_trouble(), None, "anybody may have sent it");
        let other = LinkCounts { other_key: 5, ..none };
        assert!(other.key_trouble().is_some_and(|why| why.contains("another key")));
        assert_eq!(LinkCounts { accepted: 1, ..other }.key_trouble(), None);
        assert!(LinkCounts { untagged: 1, ..none }.key_trouble().is_some_and(|why| why.contains("has no key")));
        let encrypts = LinkCounts { confidential: 1, ..none };
        assert!(encrypts.key_trouble().is_some_and(|why| why.contains("'confidential'")));
        assert!(LinkCounts { keyed: 1, ..none }.key_trouble().is_some_and(|why| why.contains("has none")));
    }
}
