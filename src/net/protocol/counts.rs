//! Counters of one host on one link: datagrams sent, messages accepted, and everything dropped, by cause.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

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
    /// Datagrams refused on a link with authentication: older than the replay window, or of an earlier incarnation.
    replay,
    /// Datagrams refused: held back on the way. Either sent before a link report that arrived long ago, or a link
    /// report that was long in transit.
    late,
    /// Datagrams refused: their sender has not proved its liveness yet.
    unproven,
    /// Datagrams refused: they are from a second live host with the same id.
    #[serde(rename = "twin")]
    duplicate_id,
    /// Datagrams refused: they are from another team.
    team,
    /// Datagrams refused: they have another version of the wire format.
    version,
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
}

impl LinkCounts {
    /// Returns the number of datagrams and messages that were refused or dropped on arrival, for any cause.
    pub fn refused(&self) -> u64 {
        self.refusals().iter().map(|(_, count)| count).sum()
    }

    /// Returns the number of datagrams and messages refused or dropped on arrival, for each cause: (name, number).
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
