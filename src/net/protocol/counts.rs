//! Counters of a host on a link: everything sent, accepted or dropped, each by its cause. No decisions.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

macro_rules! counts {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Datagrams and messages of one link, as counted by one host.
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
    /// Datagrams sent with data, each counted once; and messages that stayed on the host.
    sent,
    /// Datagrams retransmitted: timed repeats, requested repairs, retries without an acknowledgement.
    copies,
    /// Datagrams sent with nothing but soft state: heartbeats, modes, link reports, acknowledgements, requests.
    soft,
    /// Given up: sent with all retries and never acknowledged by all receivers.
    lapsed,
    /// Not sent: out of the ranges of their kind.
    unfit,
    /// Messages received and accepted.
    accepted,
    /// Messages accepted from a retransmission: the first transmission was lost.
    repaired,
    /// Ignored: for another host of the same multicast group. Not a fault.
    aside,
    /// Refused: datagrams of this process, received back.
    own,
    /// Refused: the tag is missing or wrong, or there is one and no key to check it.
    auth,
    /// Refused: too old to tell whether it is new, or of a former incarnation, on a link with authentication.
    replay,
    /// Refused: delayed. It was sent before a report that arrived long before it, or is a report that was long in
    /// transit.
    late,
    /// Refused: the sender has not proved its liveness yet.
    unproven,
    /// Refused: from a second live host with the same id.
    #[serde(rename = "twin")]
    duplicate_id,
    /// Refused: of another team.
    team,
    /// Refused: of another version.
    version,
    /// Refused: numbers out of the ranges of their kind.
    range,
    /// Refused: duplicate of a datagram.
    duplicate,
    /// Refused: older than the newest message of its stream.
    stale,
    /// Refused: the sender exceeds its rate limit.
    rate,
    /// Refused: the table of senders is full.
    crowd,
    /// Dropped: a queue of the transport was full.
    queue,
    /// Refused: not a message.
    malformed,
    /// Refused: about a robot that is not on this host.
    misrouted,
}

impl LinkCounts {
    /// Everything refused or dropped on arrival, whatever the cause.
    pub fn refused(&self) -> u64 {
        self.refusals().iter().map(|(_, count)| count).sum()
    }

    /// Everything refused or dropped on arrival, each cause with its name.
    pub fn refusals(&self) -> [(&'static str, u64); 16] {
        [
            ("own", self.own),
            ("auth", self.auth),
            ("replay", self.replay),
            ("late", self.late),
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
        ]
    }
}
