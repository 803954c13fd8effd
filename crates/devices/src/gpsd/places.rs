//! Last places of a robot, from which its velocity is found where a receiver measures none.

use std::collections::VecDeque;

use murmurate::messages::geometry::Vec2;

/// Time over which the velocity is a mean \[ns\]. Places of 2 cm at its ends give an error of 6 cm/s, half of it late.
const WINDOW_NS: u64 = 500_000_000;
/// Longest time between two places from which a velocity is found \[ns\]: receivers send once a second or faster.
const LONGEST_NS: u64 = 1_500_000_000;
/// Largest number of places that are kept: those of the window at 20 Hz and more.
const MOST: usize = 16;

/// Last places of a robot, the oldest first, each with its stamp \[ns\].
#[derive(Debug, Default)]
pub struct Places(VecDeque<(u64, [f64; 2])>);

impl Places {
    /// Takes a new place \[m\] with its stamp \[ns\], which is later than that of the one before. Returns the mean
    /// velocity \[m/s\] over the last half second, or since the place before; zero if there is none that is recent.
    pub fn take(&mut self, stamp_ns: u64, place: [f64; 2]) -> Vec2 {
        // The oldest is dropped when the one after it already spans the window.
        while self.0.len() >= MOST || self.0.get(1).is_some_and(|(at, _)| stamp_ns.saturating_sub(*at) >= WINDOW_NS) {
            self.0.pop_front();
        }
        let then = self.0.iter().find(|(at, _)| stamp_ns.saturating_sub(*at) <= LONGEST_NS).copied();
        self.0.push_back((stamp_ns, place));
        let Some((at, from)) = then.filter(|(at, _)| *at < stamp_ns) else { return Vec2::zeros() };
        let seconds = (stamp_ns - at) as f64 * 1e-9;
        Vec2::new(((place[0] - from[0]) / seconds) as f32, ((place[1] - from[1]) / seconds) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocity_is_that_of_the_last_half_second_and_zero_after_a_gap() {
        for period_ns in [50_000_000u64, 100_000_000, 1_000_000_000] {
            let mut places = Places::default();
            for k in 0..40u64 {
                let x = 0.6 * (period_ns * k) as f64 * 1e-9;
                let velocity = places.take(period_ns * k, [x, -x]);
                let expected = if k == 0 { 0.0 } else { 0.6 };
                assert!((velocity - Vec2::new(expected, -expected)).norm() < 1e-5, "{period_ns} {k}: {velocity:?}");
            }
            assert_eq!(places.take(period_ns * 40 + 5_000_000_000, [9.0, 9.0]), Vec2::zeros());
        }
    }
}
