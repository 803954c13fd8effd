//! Counters of a radio channel: offered frames, transmitted frames, and losses by cause.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

macro_rules! counts {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Counters of frames and airtime of one radio channel, or summed over channels. A multicast frame is lost or
        /// delivered once for each receiver.
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
    /// Number of datagrams that were offered to stations for transmission.
    offered,
    /// Number of expected deliveries: one for each offered datagram and receiver.
    wanted,
    /// Number of transmitted frames, with retries and the access point's relaying, without frames of other networks.
    transmissions,
    /// Number of transmitted frames that collided with another frame, without frames of other networks.
    collided,
    /// Number of deliveries at the final receivers; arrivals at an access point do not count.
    arrived,
    /// Number of deliveries lost because the transmit queue of a station or of the access point was full.
    lost_queue,
    /// Number of deliveries lost because a unicast frame reached its retry limit without an acknowledgement.
    lost_retries,
    /// Number of deliveries lost because a multicast frame collided.
    lost_collision,
    /// Number of deliveries lost because noise corrupted a multicast frame at the receiver.
    lost_noise,
    /// Number of deliveries lost because the receiver of a multicast frame was out of range.
    lost_range,
    /// Time in which the medium was busy with frames of this channel's stations and access point \[ns\].
    airtime_ns,
    /// Time in which the medium was busy with frames of other networks only \[ns\].
    foreign_ns,
    /// Simulated lifetime of the channel \[ns\], of which airtime is a share; for a sum of counters, of all channels
    /// together.
    channel_ns,
}

/// Counters of one station of a radio channel, or of its access point. Losses count at the station that transmits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StationCounts {
    /// Number of datagrams that were offered to the station; for an access point, that it has to relay.
    pub offered: u64,
    /// Number of frames that the station has transmitted, with retries.
    pub transmissions: u64,
    /// Number of these that were retries of an unacknowledged unicast frame.
    pub retries: u64,
    /// Number of these that collided with another frame.
    pub collided: u64,
    /// Number of datagrams delivered to the station.
    pub received: u64,
    /// Number of datagrams lost because the station's transmit queue was full.
    pub lost_queue: u64,
    /// Number of datagrams lost because a unicast frame reached its retry limit without an acknowledgement.
    pub lost_retries: u64,
    /// Number of multicast frames lost in a collision.
    pub lost_collision: u64,
    /// Number of multicast frames of others that the station did not receive because of noise.
    pub missed_noise: u64,
    /// Number of multicast frames of others that the station did not receive because it was out of range.
    pub missed_range: u64,
    /// Time that the station's frames and their acknowledgements took on the air \[ns\]. Frames that collide count at
    /// each of their senders.
    pub airtime_ns: u64,
}

impl RadioCounts {
    /// Returns the number of lost deliveries for each cause, with a text for the cause; numbers may be zero.
    pub fn causes(&self) -> impl Iterator<Item = (u64, &'static str)> {
        let multicast =
            [(self.lost_collision, "to collisions"), (self.lost_noise, "to noise"), (self.lost_range, "out of range")];
        [(self.lost_queue, "to full queues"), (self.lost_retries, "after all retries")].into_iter().chain(multicast)
    }

    /// Returns the number of lost deliveries, summed over all causes.
    pub fn lost(&self) -> u64 {
        self.causes().map(|(n, _)| n).sum()
    }

    /// Returns the share of time, 0 to 1, in which the medium was busy with this channel's stations and access point.
    /// For a sum of counters it is the mean over all channels.
    pub fn airtime(&self) -> f64 {
        self.airtime_ns as f64 / self.channel_ns.max(1) as f64
    }
}
