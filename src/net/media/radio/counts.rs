//! Counters of a radio channel: offered and transmitted frames, and losses by cause.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

macro_rules! counts {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Counters of frames and airtime of radio channels. A multicast frame is lost or delivered once for each
        /// receiver.
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
    /// Datagrams offered to stations.
    offered,
    /// Expected deliveries: one per offered datagram and receiver.
    wanted,
    /// Transmitted frames, including retries and an access point's relaying, without those of other networks.
    transmissions,
    /// Transmitted frames that collided.
    collided,
    /// Deliveries at the final receivers; arrivals at an access point do not count.
    arrived,
    /// Lost deliveries: the transmit queue of a station or the access point was full.
    lost_queue,
    /// Lost deliveries: a unicast frame reached its retry limit without an acknowledgement.
    lost_retries,
    /// Lost deliveries: a multicast frame collided.
    lost_collision,
    /// Lost deliveries: noise corrupted a multicast frame.
    lost_noise,
    /// Lost deliveries: the receiver of a multicast frame was out of range.
    lost_range,
    /// Time in which the medium was busy with these stations and the access point \[ns\].
    airtime_ns,
    /// Time in which the medium was busy only with frames of other networks \[ns\].
    foreign_ns,
    /// Lifetime of all channels together, of which airtime is a share \[ns\].
    channel_ns,
}

impl RadioCounts {
    /// Lost deliveries with a text for each cause.
    pub fn causes(&self) -> impl Iterator<Item = (u64, &'static str)> {
        let multicast =
            [(self.lost_collision, "to collisions"), (self.lost_noise, "to noise"), (self.lost_range, "out of range")];
        [(self.lost_queue, "to full queues"), (self.lost_retries, "after all retries")].into_iter().chain(multicast)
    }

    /// Lost deliveries of all causes.
    pub fn lost(&self) -> u64 {
        self.causes().map(|(n, _)| n).sum()
    }

    /// Share of time in which the medium was busy with these stations, over all channels.
    pub fn airtime(&self) -> f64 {
        self.airtime_ns as f64 / self.channel_ns.max(1) as f64
    }
}
