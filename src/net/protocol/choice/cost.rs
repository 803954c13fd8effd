//! Cost of each way to send: time on the medium, load, and the share that is expected to arrive.

use super::{Measured, Way};

/// Share of the states, 0 to 1, that is to arrive at each other host.
pub(super) const GOAL: f64 = 0.993;
/// Deviation of a host's loss from the mean that chance explains: two standard deviations in 64 datagrams.
const NEAR: f64 = 0.1;
/// Largest number of transmissions of a multicast frame, in eighths.
const MOST: u8 = 32;
/// The same while the time of a frame is unknown.
const MOST_UNKNOWN: u8 = 16;
/// Time that a station waits for its turn on an idle medium \[s\]: the space AIFS and half of the least contention
/// window of 802.11 at 2.4 GHz.
const TURN_S: f64 = 105e-6;
/// Part of it that the medium is idle in a busy network \[s\]: stations count down at the same time.
const IDLE_S: f64 = 55e-6;
/// Load from which on a link sends each datagram once, and load from which on it halves the rate of its states.
const BUSY: f64 = 0.6;
const FULL: f64 = 0.8;
/// Largest divisor of the rate of states.
const MOST_DIVIDED: u8 = 8;

/// Returns the load up to which a way is taken.
pub(super) fn limit(way: Way) -> f64 {
    if way == Way::Multicast(8) { FULL } else { BUSY }
}

impl Measured {
    /// Returns the mean share of the multicast frames, 0 to 1, that another host does not receive.
    pub fn mean_loss(&self) -> f64 {
        if self.loss.is_empty() { 0.0 } else { self.loss.iter().sum::<f64>() / self.loss.len() as f64 }
    }

    /// Returns the way that costs least, among those that reach the goal and do not overload the medium, and by how
    /// much the rate of states has to be divided for it.
    pub(super) fn best(&self) -> (Way, u8) {
        let once = Way::Multicast(8);
        let multicast = Way::Multicast(self.needed());
        if self.multicast_s.is_none() {
            return if self.congested { (once, 2) } else { (multicast, 1) };
        }
        let ways = [Some(multicast), self.unicast_s.map(|_| Way::Unicast)];
        let mut divisor = 1;
        loop {
            let fits = |way: &Way| self.load(*way, divisor) <= BUSY;
            let cheapest =
                ways.into_iter().flatten().filter(fits).min_by(|a, b| self.cost_s(*a).total_cmp(&self.cost_s(*b)));
            if let Some(way) = cheapest {
                return (way, divisor);
            }
            if self.load(once, divisor) <= FULL || divisor >= MOST_DIVIDED {
                return (once, divisor);
            }
            divisor *= 2;
        }
    }

    /// Returns the other way that would reach the goal; `None` if the time of its frames is unknown.
    pub(super) fn other(&self, way: Way) -> Option<Way> {
        match way {
            Way::Unicast => self.multicast_s.map(|_| Way::Multicast(self.needed())),
            Way::Multicast(_) => self.unicast_s.map(|_| Way::Unicast),
        }
    }

    /// Returns the least number of transmissions by multicast that reaches the goal, in eighths.
    fn needed(&self) -> u8 {
        let most = if self.multicast_s.is_some() { MOST } else { MOST_UNKNOWN };
        (8..=most).find(|eighths| self.share(Way::Multicast(*eighths)) >= GOAL).unwrap_or(most)
    }

    /// Returns the share of the states, 0 to 1, that is expected to arrive at another host.
    pub(super) fn share(&self, way: Way) -> f64 {
        let Way::Multicast(eighths) = way else { return 1.0 };
        if self.loss.is_empty() {
            return 1.0;
        }
        let mean = self.mean_loss();
        let (whole, part) = (i32::from(eighths / 8), f64::from(eighths % 8) / 8.0);
        // The part is the share of datagrams that leave once more than the others.
        let lost = |loss: &f64| {
            // What lies near the mean differs by chance.
            let loss = if (loss - mean).abs() < NEAR { mean } else { *loss };
            libm::pow(loss, f64::from(whole)) * (1.0 - part + part * loss)
        };
        1.0 - self.loss.iter().map(lost).sum::<f64>() / self.loss.len() as f64
    }

    /// Returns the number of frames for a state, and the time that each takes \[s\]; `None` if it is unknown.
    fn frames(&self, way: Way) -> Option<(f64, f64)> {
        let others = self.hosts.saturating_sub(1) as f64;
        match way {
            Way::Multicast(eighths) => Some((f64::from(eighths) / 8.0, self.multicast_s?)),
            Way::Unicast => Some((others / (1.0 - self.mean_loss()).max(0.1), self.unicast_s?)),
        }
    }

    /// Returns the time that a state takes on an idle medium \[s\]; infinite if it is unknown.
    pub(super) fn cost_s(&self, way: Way) -> f64 {
        self.frames(way).map_or(f64::INFINITY, |(frames, time_s)| frames * (time_s + TURN_S))
    }

    /// Returns the share of the time in which the states of all hosts would occupy the medium, if all send as this one;
    /// 0 if it is unknown.
    pub(super) fn load(&self, way: Way, divisor: u8) -> f64 {
        let states_hz = self.hosts as f64 * self.states_hz / f64::from(divisor);
        self.frames(way).map_or(0.0, |(frames, time_s)| states_hz * frames * (time_s + IDLE_S))
    }
}
