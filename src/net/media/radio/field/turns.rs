//! Turns of the stations of a field: when each begins its next transmission, if nothing comes in between.

use serde::{Deserialize, Serialize};

use crate::time::Time;

/// Number of stations whose soonest turn is kept: few to search, and few of them in a large field.
const BLOCK: usize = 32;

/// Turns of all stations.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Turns {
    /// Time of each station's turn; `Time::MAX` without one.
    at: Vec<Time>,
    /// The soonest of each block of stations.
    soonest: Vec<Time>,
}

impl Turns {
    /// Returns the turns of stations that have none.
    pub fn new(stations: usize) -> Turns {
        Turns { at: vec![Time::MAX; stations], soonest: vec![Time::MAX; stations.div_ceil(BLOCK)] }
    }

    /// Sets the turn of a station; `None` takes it away.
    #[inline]
    pub fn set(&mut self, station: usize, at: Option<Time>) {
        let at = at.unwrap_or(Time::MAX);
        let before = std::mem::replace(&mut self.at[station], at);
        if before == at {
            return;
        }
        let block = station / BLOCK;
        let soonest = &mut self.soonest[block];
        if at <= *soonest {
            *soonest = at;
        } else if before == *soonest {
            let end = ((block + 1) * BLOCK).min(self.at.len());
            *soonest = self.at[block * BLOCK..end].iter().copied().min().unwrap_or(Time::MAX);
        }
    }

    /// Returns the time of the next turn; `None` without one.
    pub fn next(&self) -> Option<Time> {
        self.soonest.iter().copied().min().filter(|at| *at < Time::MAX)
    }

    /// Removes and returns the first station, by its index, whose turn is at `now` or before.
    pub fn take(&mut self, now: Time) -> Option<usize> {
        let block = self.soonest.iter().position(|soonest| *soonest <= now)?;
        let first = block * BLOCK;
        let station = first + self.at[first..].iter().position(|at| *at <= now)?;
        self.set(station, None);
        Some(station)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Span;

    #[test]
    fn turns_are_taken_in_time_and_by_index() {
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        let mut turns = Turns::new(100);
        for (station, ms) in [(70, 5), (3, 5), (40, 2), (99, 9)] {
            turns.set(station, Some(at(ms)));
        }
        assert_eq!(turns.next(), Some(at(2)));
        assert_eq!((turns.take(at(1)), turns.take(at(2)), turns.take(at(2))), (None, Some(40), None));
        turns.set(3, Some(at(6)));
        assert_eq!((turns.next(), turns.take(at(6)), turns.take(at(6))), (Some(at(5)), Some(3), Some(70)));
        turns.set(99, None);
        assert_eq!(turns.next(), None);
    }
}
