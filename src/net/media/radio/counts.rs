//! What is counted on a radio channel: what was offered, what was on the air, and what was lost, by its cause.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

macro_rules! counts {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Frames and airtime of radio channels. A frame for many is lost, or arrives, once a listener.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(default)]
        pub struct RadioCounts {
            $($(#[$doc])* pub $name: u64,)*
        }

        impl Sum for RadioCounts {
            fn sum<I: Iterator<Item = RadioCounts>>(all: I) -> RadioCounts {
                all.fold(RadioCounts::default(), |sum, one| RadioCounts { $($name: sum.$name + one.$name,)* })
            }
        }
    };
}

counts! {
    /// Datagrams that stations were given to send.
    offered,
    /// Copies of them that are to arrive: one a listener.
    wanted,
    /// Frames on the air, retries and an access point's relaying included, foreign ones not.
    transmissions,
    /// Those of them that collided.
    collided,
    /// Copies that arrived, counted at the last listener alone and not at an access point.
    arrived,
    /// Lost: the transmit queue of a station or the access point was full.
    lost_queue,
    /// Lost: unicast without an acknowledgement, however often it was sent again.
    lost_retries,
    /// Lost to one listener: multicast that collided.
    lost_collision,
    /// Lost to one listener: multicast that noise has spoilt.
    lost_noise,
    /// Lost to one listener: multicast, too far away.
    lost_range,
    /// How long the medium was taken by these stations and the access point \[ns\].
    airtime_ns,
    /// How long it was taken by foreign frames alone \[ns\].
    foreign_ns,
    /// How long channels have existed, all together: what airtime is a share of \[ns\].
    channel_ns,
}

impl RadioCounts {
    /// What was lost, by its cause.
    pub fn causes(&self) -> impl Iterator<Item = (u64, &'static str)> {
        let multicast =
            [(self.lost_collision, "to collisions"), (self.lost_noise, "to noise"), (self.lost_range, "out of range")];
        [(self.lost_queue, "to full queues"), (self.lost_retries, "after all retries")].into_iter().chain(multicast)
    }

    /// Everything that was lost, whatever the cause.
    pub fn lost(&self) -> u64 {
        self.causes().map(|(n, _)| n).sum()
    }

    /// The share of time in which the medium was taken by these stations, over all channels.
    pub fn airtime(&self) -> f64 {
        self.airtime_ns as f64 / self.channel_ns.max(1) as f64
    }
}
