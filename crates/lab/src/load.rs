//! Traffic with which a laboratory in real time is compared to the same channel in virtual time: datagrams at random
//! times (Poisson) that ask for a share of the channel's capacity. In virtual time they are sent when they were sent in
//! real time, so that both differ by the channel alone.

use crate::ethernet::{self, HEADER_BYTES};
use crate::file::Laboratory;
use crate::medium::Medium;
use murmurate::net::media::radio::bianchi::Saturation;
use murmurate::random::{self, Seed};
use murmurate::time::{Span, Time};

/// Whether the datagrams of a load go to one station or to all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cast {
    /// Each station sends to the next one.
    Unicast,
    /// Each station sends to all others.
    Multicast,
}

impl Cast {
    /// Returns the name of the cast, such as `unicast`.
    pub fn name(self) -> &'static str {
        match self {
            Cast::Unicast => "unicast",
            Cast::Multicast => "multicast",
        }
    }
}

/// Traffic of a comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Whether datagrams go to one station or to all.
    pub cast: Cast,
    /// Datagrams of all stations together, as a share of what the saturated channel delivers by Bianchi's model. Above
    /// 1, as a multiple of what it takes from the queues of stations, so that these are full.
    pub share: f64,
    /// Length of a datagram \[bytes\].
    pub bytes: usize,
    /// Length of the traffic.
    pub lasts: Span,
}

/// Datagram that a station sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offer {
    /// Time at which it is sent.
    pub at: Time,
    /// Number of the station that sends it.
    pub station: u16,
}

/// Fates of the datagrams of a load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Number of datagrams that were sent.
    pub sent: usize,
    /// Share of the wanted deliveries that were made.
    pub delivered: f64,
    /// Number of deliveries per second, while the load lasts.
    pub deliveries_per_s: f64,
    /// Median of the delays \[ms\].
    pub p50_ms: f64,
    /// Delay that one delivery in ten exceeds \[ms\].
    pub p90_ms: f64,
}

/// Delivery of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// Time since the beginning of the load at which it arrived.
    pub after: Span,
    /// Time since it was sent.
    pub delay: Span,
}

impl Outcome {
    /// Returns the outcome of `sent` datagrams with these deliveries, each wanted by `receivers` stations, that were
    /// sent within `lasts`. Deliveries per second are those of the last three quarters of that time: before, queues
    /// fill.
    pub fn of(sent: usize, receivers: usize, lasts: Span, received: &[Received]) -> Outcome {
        let mut delays: Vec<Span> = received.iter().map(|one| one.delay).collect();
        delays.sort_unstable();
        let quantile = |share: f64| {
            let at = (share * delays.len() as f64) as usize;
            delays.get(at.min(delays.len().saturating_sub(1))).map_or(f64::NAN, |delay| 1e3 * delay.as_secs())
        };
        let begin = Span::from_nanos(lasts.as_nanos() / 4);
        let steady = received.iter().filter(|one| (begin..lasts).contains(&one.after)).count();
        Outcome {
            sent,
            delivered: delays.len() as f64 / (sent * receivers).max(1) as f64,
            deliveries_per_s: steady as f64 / (lasts - begin).as_secs(),
            p50_ms: quantile(0.5),
            p90_ms: quantile(0.9),
        }
    }
}

impl Load {
    fn saturation(&self, lab: &Laboratory) -> Saturation {
        let of = match self.cast {
            Cast::Unicast => Saturation::of_radio,
            Cast::Multicast => Saturation::of_multicast,
        };
        of(&lab.radio, usize::from(lab.stations), self.bytes)
    }

    /// Returns the number of datagrams per second that the saturated channel delivers in one hop, by Bianchi's model.
    pub fn capacity(&self, lab: &Laboratory) -> f64 {
        self.saturation(lab).frames_per_s
    }

    /// Returns the number of datagrams per second that all stations together are to send.
    fn rate(&self, lab: &Laboratory) -> f64 {
        let saturation = self.saturation(lab);
        // A multicast frame that collides leaves its queue, too: most of ten saturated stations' frames do.
        let most = match self.cast {
            Cast::Multicast if self.share > 1.0 => saturation.transmitted_per_s(),
            _ => saturation.frames_per_s,
        };
        self.share * most
    }

    /// Returns the number of stations that want each datagram.
    pub fn receivers(&self, lab: &Laboratory) -> usize {
        match self.cast {
            Cast::Unicast => 1,
            Cast::Multicast => usize::from(lab.stations) - 1,
        }
    }

    /// Returns all datagrams in the order of their times. Gaps are exponential, from streams of the laboratory's seed.
    pub fn offers(&self, lab: &Laboratory) -> Vec<Offer> {
        let rate = self.rate(lab) / f64::from(lab.stations);
        let seed = Seed::of_run(lab.seed).child("load");
        let mut offers = Vec::new();
        for station in 0..lab.stations {
            let mut gaps = seed.stream(&format!("station/{station}"));
            let mut at = Time::ZERO;
            loop {
                at += Span::from_secs(random::exponential(&mut gaps) / rate);
                if at.since(Time::ZERO) > self.lasts {
                    break;
                }
                offers.push(Offer { at, station });
            }
        }
        offers.sort_by_key(|offer| (offer.at, offer.station));
        offers
    }

    /// Returns what becomes of these datagrams in virtual time.
    pub fn in_virtual_time(&self, lab: &Laboratory, offers: &[Offer]) -> Outcome {
        let mut medium = Medium::new(lab);
        for offer in offers {
            let to = match self.cast {
                Cast::Unicast => ethernet::station((offer.station + 1) % lab.stations),
                Cast::Multicast => [0xff; 6],
            };
            // The headers of Ethernet, IPv4 and UDP before the datagram.
            let frame = [&to[..], &ethernet::station(offer.station), &vec![0; HEADER_BYTES - 12 + 28 + self.bytes]];
            medium.take(offer.at, offer.station, &frame.concat());
        }
        while let Some(due) = medium.wake_at().filter(|due| due.since(Time::ZERO) < self.lasts + DRAIN) {
            medium.wake(due);
        }
        let deliveries = medium.deliveries();
        let received =
            deliveries.map(|one| Received { after: one.at.since(Time::ZERO), delay: one.at.since(one.token.taken) });
        Outcome::of(offers.len(), self.receivers(lab), self.lasts, &received.collect::<Vec<_>>())
    }
}

/// Time after the last datagram in which deliveries count.
pub const DRAIN: Span = Span::from_millis(1000);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_asks_for_its_share_and_saturation_is_bianchi_s() {
        let lab = |stations| {
            let text = format!("stations = {stations}\n[radio]\nchannel = \"ad-hoc\"\nretries = 1000\n");
            Laboratory::from_toml(&text).unwrap()
        };
        for (stations, cast) in [(5, Cast::Unicast), (5, Cast::Multicast), (10, Cast::Unicast), (10, Cast::Multicast)] {
            let lab = lab(stations);
            let load = |share| Load { cast, share, bytes: 200, lasts: Span::from_secs(20.0) };
            let half = load(0.5);
            let sent = half.offers(&lab).len() as f64 / 20.0;
            assert!((sent / (0.5 * half.capacity(&lab)) - 1.0).abs() < 0.05, "{cast:?}: {sent} a second");
            let outcome = half.in_virtual_time(&lab, &half.offers(&lab));
            let least = if cast == Cast::Unicast { 0.9999 } else { 0.9 };
            assert!(outcome.delivered > least, "{cast:?}: {outcome:?}");
            assert!(outcome.p50_ms < outcome.p90_ms, "{outcome:?}");
            let full = load(2.5);
            let ratio = full.in_virtual_time(&lab, &full.offers(&lab)).deliveries_per_s
                / (full.capacity(&lab) * full.receivers(&lab) as f64);
            assert!((ratio - 1.0).abs() < 0.03, "{stations} stations, {cast:?}: {ratio} of the model");
        }
    }
}
