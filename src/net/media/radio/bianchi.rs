//! Saturation throughput of a radio channel by the model of G. Bianchi, "Performance analysis of the IEEE 802.11
//! distributed coordination function", IEEE JSAC 18(3), 2000. The equations are solved numerically, without simulation.
//!
//! The limit of retries is that of H. Wu et al., "Performance of reliable transport protocol over IEEE 802.11 wireless
//! LAN: analysis and enhancement", INFOCOM 2002: a frame whose last retry fails is dropped, and the window starts anew.

use super::Radio;
use crate::time::Span;

/// Performance of a radio channel on which every station always has a frame to send, by the model of Bianchi (JSAC
/// 18(3), 2000).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saturation {
    /// Probability that a station transmits in a slot: tau of Bianchi's equation (7).
    pub(crate) attempt: f64,
    /// Probability that a transmitted frame collides: p of Bianchi's equation (9).
    pub collision: f64,
    /// Share of time, 0 to 1, in which payload is transmitted without collision: S of Bianchi's equation (13).
    pub throughput: f64,
    /// Frames that all stations together deliver per second \[1/s\].
    pub frames_per_s: f64,
}

/// Time intervals of a radio channel that the saturation model of Bianchi (JSAC 18(3), 2000) needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lengths {
    /// Slot time: sigma in Bianchi's model.
    pub(crate) slot: Span,
    /// Time that the channel is busy with a successful transmission: T_s in Bianchi's model.
    pub(crate) success: Span,
    /// Time that the channel is busy with a collision: T_c in Bianchi's model.
    pub(crate) collision: Span,
    /// Airtime of the payload of a frame alone: E\[P\] in Bianchi's model.
    pub(crate) payload: Span,
}

/// Backoff of a station: its contention windows and how often it tries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Backoff {
    /// Slots of the initial contention window: W in Bianchi's model.
    pub(crate) window: u32,
    /// Largest number of times that the window is doubled: m in Bianchi's model.
    pub(crate) stages: u32,
    /// Largest number of retries of a frame; `None` for unlimited, as in Bianchi's model.
    pub(crate) retries: Option<u32>,
}

/// Largest number of retries that is not as good as unlimited.
const MOST_RETRIES: u32 = 1000;

impl Backoff {
    /// Returns the probability that a station transmits in a slot (tau); `p` is the probability that a frame collides.
    ///
    /// Without a limit it is Bianchi's equation (7), whose geometric series is summed term by term, so that p = 1/2
    /// needs no special case. With one, it is the mean number of transmissions of a frame over the mean number of slots
    /// that it takes, as by Wu et al.
    fn attempt(self, p: f64) -> f64 {
        let window = f64::from(self.window);
        match self.retries.filter(|&retries| retries < MOST_RETRIES) {
            None => {
                let series: f64 = (0..self.stages).map(|stage| (2.0 * p).powi(stage.cast_signed())).sum();
                2.0 / (1.0 + window + p * window * series)
            }
            Some(retries) => {
                let (mut sent, mut slots, mut reached) = (0.0, 0.0, 1.0);
                for retry in 0..=retries {
                    let window = window * f64::from(1_u32 << retry.min(self.stages));
                    sent += reached;
                    slots += reached * 0.5 * (window + 1.0);
                    reached *= p;
                }
                sent / slots
            }
        }
    }
}

impl Saturation {
    /// Returns the number of frames that all stations together transmit per second \[1/s\], with those that collide.
    pub fn transmitted_per_s(&self) -> f64 {
        self.frames_per_s / (1.0 - self.collision)
    }

    /// Solves Bianchi's model of a saturated channel for `stations` stations. `lengths` has the time intervals of the
    /// channel.
    pub(crate) fn of(stations: usize, backoff: Backoff, lengths: &Lengths) -> Saturation {
        let n = stations as f64;
        // Equations (7) and (9) have one common solution, since one falls and the other grows with p: bisection.
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let p = f64::midpoint(low, high);
            let collides = 1.0 - libm::pow(1.0 - backoff.attempt(p), n - 1.0);
            if collides > p { low = p } else { high = p }
        }
        let collision = f64::midpoint(low, high);
        let attempt = backoff.attempt(collision);
        // Equations (10), (11) and (13).
        let busy = 1.0 - libm::pow(1.0 - attempt, n);
        let alone = n * attempt * libm::pow(1.0 - attempt, n - 1.0);
        let step = (1.0 - busy) * lengths.slot.as_secs()
            + alone * lengths.success.as_secs()
            + (busy - alone) * lengths.collision.as_secs();
        Saturation {
            attempt,
            collision,
            throughput: alone * lengths.payload.as_secs() / step,
            frames_per_s: alone / step,
        }
    }

    /// Solves Bianchi's model for `stations` stations on the channel `radio`. Each station always has a unicast
    /// datagram of `datagram_bytes` bytes to send, which reaches its receiver in one hop.
    pub fn of_radio(radio: &Radio, stations: usize, datagram_bytes: usize) -> Saturation {
        let times = radio.times();
        let frame = radio.frame_airtime(datagram_bytes);
        let lengths = Lengths {
            slot: times.slot,
            success: frame + times.propagation + times.acknowledged + times.aifs,
            collision: frame + times.propagation + times.recovery,
            payload: radio.payload_airtime(datagram_bytes),
        };
        let stages = ((radio.cw_max + 1) / (radio.cw_min + 1)).ilog2();
        let backoff = Backoff { window: radio.cw_min + 1, stages, retries: Some(radio.retries) };
        Saturation::of(stations, backoff, &lengths)
    }

    /// Solves Bianchi's model for `stations` stations on the channel `radio` that always have a multicast datagram of
    /// `datagram_bytes` bytes to send, in one hop. It is not acknowledged, so the contention window never grows.
    pub fn of_multicast(radio: &Radio, stations: usize, datagram_bytes: usize) -> Saturation {
        let times = radio.times();
        let frame = radio.multicast_airtime(datagram_bytes);
        let lengths = Lengths {
            slot: times.slot,
            success: frame + times.propagation + times.aifs,
            collision: frame + times.propagation + times.recovery,
            payload: radio.payload_airtime(datagram_bytes),
        };
        let backoff = Backoff { window: radio.cw_min + 1, stages: 0, retries: None };
        Saturation::of(stations, backoff, &lengths)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_has_the_published_optimum() {
        let times = |success, collision| Lengths {
            slot: Span::from_nanos(50_000),
            success: Span::from_nanos(success),
            collision: Span::from_nanos(collision),
            payload: Span::from_nanos(8_184_000),
        };
        let backoff = |window, stages| Backoff { window, stages, retries: None };
        // Table II: T_s = 8982 us and T_c = 8713 us of basic access (179.64 and 174.26 slots).
        let lengths = times(8_982_000, 8_713_000);
        let all = [2, 5, 10, 20, 50].map(|n| Saturation::of(n, backoff(32, 3), &lengths));
        assert!(all.windows(2).all(|pair| pair[0].throughput > pair[1].throughput), "{all:?}");
        assert!(all.windows(2).all(|pair| pair[0].collision < pair[1].collision), "{all:?}");
        // Equation (28): with K = 9.334, the optimal window for the number of stations gives 0.824.
        let (n, k): (usize, f64) = (50, (8713.0_f64 / 50.0 / 2.0).sqrt());
        assert!((k - 9.334).abs() < 1e-3);
        let window = (2.0 * n as f64 * k) as u32 - 1;
        let best = Saturation::of(n, backoff(window, 0), &lengths).throughput;
        assert!((best - 0.824).abs() < 2e-3, "{best}");
        let alone = Saturation::of(1, backoff(32, 3), &lengths);
        assert!(alone.collision < 1e-12 && (alone.attempt - 2.0 / 33.0).abs() < 1e-12);
    }

    #[test]
    fn many_retries_are_as_good_as_unlimited_ones_and_few_leave_the_window_small() {
        let attempt = |retries| Backoff { window: 32, stages: 3, retries }.attempt(0.3);
        assert!((attempt(Some(60)) - attempt(None)).abs() < 1e-6, "{:?} {:?}", attempt(Some(60)), attempt(None));
        assert!(attempt(Some(1)) > 1.1 * attempt(Some(7)));
    }
}
