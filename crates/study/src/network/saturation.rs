//! Saturation of one channel by growing teams, from airtimes and from Bianchi's model, without a simulation.
//!
//! All robots share one channel and publish at the same rate. With multicast one frame serves all receivers, so the
//! load is independent of density. With unicast each message is sent to a fixed number of neighbours.

use serde::{Deserialize, Serialize};

use super::case::Addressing;
use murmurate::net::media::radio::bianchi::Saturation;
use murmurate::net::media::radio::{Radio, Topology};

/// Team sizes for which the load of a channel is tabulated.
pub const SIZES: [usize; 8] = [5, 10, 20, 50, 100, 200, 500, 1000];
/// Message rate of a robot: one message per control step \[1/s\].
pub const RATE: f64 = 20.0;
/// Number of neighbours to which a robot sends each message by unicast, one frame to each. It is the same for all team
/// sizes, as if larger teams covered more ground at the same density; a robot in a team of five has this many.
pub const NEIGHBOURS: u32 = 4;

/// Load of one radio channel by the messages of a team.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Number of robots in the team.
    pub robots: usize,
    /// Addressing of the team's messages: unicast to [`NEIGHBOURS`] neighbours, or multicast.
    pub addressing: Addressing,
    /// Message rate of all robots together \[1/s\].
    pub messages_per_s: f64,
    /// Share of time that the team's frames need on the channel in one hop, with acknowledgements and interframe
    /// spaces. Above 1 the channel cannot carry them.
    pub airtime: f64,
    /// Share of time that the team's frames need on the channel if an access point sends each a second time. Above 1
    /// the channel cannot carry them.
    pub airtime_relayed: f64,
    /// Saturation throughput in one hop, by Bianchi's model \[messages/s\]: the most messages that the channel can
    /// carry.
    pub saturation_per_s: f64,
    /// Probability that a frame collides if every station always has one to send.
    pub collision: f64,
}

impl Load {
    /// Returns the load of the radio's channel by a team of `robots` robots, each of which sends 20 messages a second
    /// ([`RATE`]). A message is a datagram of `datagram_bytes` \[bytes\].
    pub fn of(radio: &Radio, addressing: Addressing, robots: usize, datagram_bytes: usize) -> Load {
        let times = radio.times();
        let unicast = (radio.frame_airtime(datagram_bytes) + times.acknowledged + times.aifs).as_secs();
        let spread = (radio.multicast_airtime(datagram_bytes) + times.aifs).as_secs();
        let neighbours = f64::from(NEIGHBOURS);
        // An access point sends every frame a second time.
        let (frames, taken, again) = match addressing {
            Addressing::Unicast => (neighbours, neighbours * unicast, neighbours * unicast),
            Addressing::Multicast => (1.0, spread, unicast),
        };
        let model = match addressing {
            Addressing::Unicast => Saturation::of_radio(radio, robots, datagram_bytes),
            Addressing::Multicast => Saturation::of_multicast(radio, robots, datagram_bytes),
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

    /// Returns whether the team sends at least as much in one hop as the channel can carry.
    pub fn is_full(&self) -> bool {
        self.airtime >= 1.0 || self.messages_per_s >= self.saturation_per_s
    }
}

/// Returns the load of the radio's channel for teams of 5 to 1000 robots ([`SIZES`]), first by multicast, then by
/// unicast. A message is a datagram of `datagram_bytes` \[bytes\].
pub fn table(radio: &Radio, datagram_bytes: usize) -> Vec<Load> {
    let of = |addressing| SIZES.map(|robots| Load::of(radio, addressing, robots, datagram_bytes));
    [Addressing::Multicast, Addressing::Unicast].into_iter().flat_map(of).collect()
}

/// Returns a text for the user: up to how many robots the channel suffices, and which parameter to change first to
/// serve larger teams. A message is a datagram of `datagram_bytes` \[bytes\].
pub fn advice(radio: &Radio, datagram_bytes: usize) -> String {
    let last = |radio: &Radio, addressing| {
        let fits = |robots: &usize| !Load::of(radio, addressing, *robots, datagram_bytes).is_full();
        (2..=5000).take_while(fits).last().unwrap_or(0)
    };
    let slow = last(radio, Addressing::Multicast);
    let fast = last(&Radio { basic_rate: radio.rate, ..radio.clone() }, Addressing::Multicast);
    let by_unicast = last(radio, Addressing::Unicast);
    let way = match radio.channel {
        Topology::AdHoc => "ad hoc: iw's mcast_rate",
        Topology::Infrastructure => "basic_rates of the access point; ad hoc, iw's mcast_rate",
    };
    let change = if fast > slow {
        format!(
            "first raise the rate of multicast frames from {} to {} ({way}), which suffices for {fast}",
            radio.basic_rate, radio.rate
        )
    } else {
        "first send less often or to fewer receivers".to_owned()
    };
    format!(
        "At {RATE} messages a second and robot this channel is saturated, in one hop, above {slow} robots by multicast \
         and above {by_unicast} by unicast to {NEIGHBOURS} neighbours: {change}. Beyond that only more channels help, \
         or less transmit power, so that distant groups no longer share one."
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn load_grows_with_the_team_and_an_access_point_doubles_it() {
        let radio = Radio::default();
        let loads = table(&radio, 234);
        let multicast: Vec<&Load> = loads.iter().filter(|load| load.addressing == Addressing::Multicast).collect();
        assert!(multicast.windows(2).all(|pair| pair[0].airtime < pair[1].airtime));
        assert!(multicast.windows(2).all(|pair| pair[0].saturation_per_s > pair[1].saturation_per_s));
        // 300 bytes at 1 Mbit/s are 2.6 ms: 1000 robots are far too many, 5 are not.
        assert!(!multicast[0].is_full() && multicast[7].is_full());
        let unicast = Load::of(&radio, Addressing::Unicast, 20, 234);
        assert!((unicast.airtime_relayed / unicast.airtime - 2.0).abs() < 1e-9);
        assert!(advice(&radio, 234).contains("basic_rates of the access point"));
        let ad_hoc = Radio { channel: Topology::AdHoc, ..radio };
        assert!(advice(&ad_hoc, 234).contains("(ad hoc: iw's mcast_rate)"));
    }
}
