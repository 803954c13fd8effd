//! Where one channel is full as a team grows, by the medium's own figures and by Bianchi's model: no simulation.
//!
//! All robots share one channel and speak at the same rate each. Density does not matter for multicast: one frame is
//! for whoever is near. By unicast each message goes to so many neighbours, whatever the size of the team.

use serde::{Deserialize, Serialize};

use super::case::Addressing;
use crate::net::media::radio::Radio;
use crate::net::media::radio::bianchi::{Lengths, Saturation};

/// The sizes of teams.
pub const SIZES: [usize; 8] = [5, 10, 20, 50, 100, 200, 500, 1000];
/// What each robot says: a message a control step \[1/s\].
pub const RATE: f64 = 20.0;
/// Whom it says it to by unicast, at constant density: as many as in a team of five.
pub const NEIGHBOURS: u32 = 4;

/// A team of one size on one channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Robots.
    pub robots: usize,
    /// How messages find their readers.
    pub addressing: Addressing,
    /// Messages of all robots together \[1/s\].
    pub messages_per_s: f64,
    /// The share of time that their frames take, acknowledgements and the spaces between frames included; more than 1
    /// cannot be.
    pub airtime: f64,
    /// The same through an access point.
    pub airtime_relayed: f64,
    /// Messages that get through in one hop if everybody always has one to send, by Bianchi's model \[1/s\].
    pub saturation_per_s: f64,
    /// The probability that a frame collides then.
    pub collision: f64,
}

impl Load {
    /// A team of so many robots with datagrams of so many bytes.
    pub fn of(radio: &Radio, addressing: Addressing, robots: usize, datagram_bytes: usize) -> Load {
        let times = radio.times();
        let unicast = (radio.frame_airtime(datagram_bytes) + times.acknowledged + times.aifs).as_secs();
        let spread = (radio.multicast_airtime(datagram_bytes) + times.aifs).as_secs();
        let neighbours = f64::from(NEIGHBOURS);
        // An access point sends everything a second time.
        let (frames, taken, again) = match addressing {
            Addressing::Unicast => (neighbours, neighbours * unicast, neighbours * unicast),
            Addressing::Multicast => (1.0, spread, unicast),
        };
        let model = match addressing {
            Addressing::Unicast => Saturation::of_radio(radio, robots, datagram_bytes),
            Addressing::Multicast => {
                let frame = radio.multicast_airtime(datagram_bytes);
                // Nobody acknowledges, so no window grows.
                let lengths = Lengths {
                    slot: times.slot,
                    success: frame + times.propagation + times.aifs,
                    collision: frame + times.propagation + times.recovery,
                    payload: radio.payload_airtime(datagram_bytes),
                };
                Saturation::of(robots, radio.cw_min + 1, 0, &lengths)
            }
        };
        let messages_per_s = RATE * robots as f64;
        Load {
            robots,
            addressing,
            messages_per_s,
            airtime: messages_per_s * taken,
            airtime_relayed: messages_per_s * (taken + again),
            saturation_per_s: model.frames_per_s / frames,
            collision: model.collision,
        }
    }

    /// Whether the channel is full.
    pub fn is_full(&self) -> bool {
        self.airtime >= 1.0 || self.messages_per_s >= self.saturation_per_s
    }
}

/// Both addressings, all sizes.
pub fn table(radio: &Radio, datagram_bytes: usize) -> Vec<Load> {
    let of = |addressing| SIZES.map(|robots| Load::of(radio, addressing, robots, datagram_bytes));
    [Addressing::Multicast, Addressing::Unicast].into_iter().flat_map(of).collect()
}

/// What to change, in one sentence.
pub fn advice(radio: &Radio, datagram_bytes: usize) -> String {
    let last = |radio: &Radio, addressing| {
        let fits = |robots: &usize| !Load::of(radio, addressing, *robots, datagram_bytes).is_full();
        (2..=5000).take_while(fits).last().unwrap_or(0)
    };
    let slow = last(radio, Addressing::Multicast);
    let fast = last(&Radio { basic_rate: radio.rate, ..radio.clone() }, Addressing::Multicast);
    let by_unicast = last(radio, Addressing::Unicast);
    let change = if fast > slow {
        format!(
            "first raise the rate of multicast frames from {} to {} (iw: mcast_rate), which makes room for {fast}",
            radio.basic_rate, radio.rate
        )
    } else {
        "first say less often or to fewer".to_owned()
    };
    format!(
        "At {RATE} messages a second and robot this channel is full, in one hop, above {slow} robots by multicast and \
         above {by_unicast} by unicast to {NEIGHBOURS} neighbours: {change}; beyond that only more channels help, or \
         less transmit power, so that distant groups no longer share one."
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_fills_with_the_team_and_an_access_point_halves_it() {
        let radio = Radio::default();
        let loads = table(&radio, 234);
        let multicast: Vec<&Load> = loads.iter().filter(|load| load.addressing == Addressing::Multicast).collect();
        assert!(multicast.windows(2).all(|pair| pair[0].airtime < pair[1].airtime));
        assert!(multicast.windows(2).all(|pair| pair[0].saturation_per_s > pair[1].saturation_per_s));
        // 300 bytes at 1 Mbit/s are 2.6 ms: 1000 robots are far too many, 5 are not.
        assert!(!multicast[0].is_full() && multicast[7].is_full());
        let unicast = Load::of(&radio, Addressing::Unicast, 20, 234);
        assert!((unicast.airtime_relayed / unicast.airtime - 2.0).abs() < 1e-9);
        assert!(advice(&radio, 234).contains("mcast_rate"));
    }
}
