//! Counts of a host on a link: everything that left, was let in, or was dropped, each by its cause. No decisions.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

macro_rules! counts {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Datagrams and messages of one link, as one host counted them.
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
    /// Datagrams sent again: timed repeats, repairs that were asked for, retries without an acknowledgement.
    copies,
    /// Datagrams sent with nothing but soft state: heartbeats, modes, link reports, acknowledgements, requests.
    soft,
    /// Given up: sent with all retries and never acknowledged by everyone.
    lapsed,
    /// Not sent: out of the ranges of their kind.
    unfit,
    /// Messages received and let in.
    accepted,
    /// Messages let in that came by a copy: the first transmission was lost.
    repaired,
    /// Set aside: for another host of the same multicast group. Not a fault.
    aside,
    /// Refused: own datagrams, heard back.
    own,
    /// Refused: the tag is missing or wrong, or there is one and no key to check it.
    auth,
    /// Refused: too old to tell whether it is new, or of a former incarnation, on a link with authentication.
    replay,
    /// Refused: a report that was sent after it had come long before it, or it was a report itself and long under way.
    late,
    /// Refused: the sender has not shown yet that it is alive now.
    unproven,
    /// Refused: a second live host under one id.
    twin,
    /// Refused: of another team.
    team,
    /// Refused: of another version.
    version,
    /// Refused: numbers out of the ranges of their kind.
    range,
    /// Refused: the same datagram again.
    duplicate,
    /// Refused: older than what is already here.
    stale,
    /// Refused: the sender says more than it may.
    rate,
    /// Refused: more senders than are remembered.
    crowd,
    /// Dropped: a queue of the transport was full.
    queue,
    /// Refused: not a message.
    malformed,
    /// Refused: about a robot that is not on this host.
    misrouted,
}

impl LinkCounts {
    /// Everything that was refused or dropped on arrival, whatever the cause.
    pub fn refused(&self) -> u64 {
        let forged = self.own + self.auth + self.replay + self.unproven + self.twin + self.team + self.version;
        let late = self.duplicate + self.stale + self.late + self.rate + self.crowd + self.queue;
        forged + late + self.range + self.malformed + self.misrouted
    }
}
