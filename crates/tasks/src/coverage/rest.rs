//! Rule by which robots stop that come back to the same place, as CoverageControl has it.
//!
//! All of it was found by experiment (docs/coverage.md). A robot that has stood still for three steps is never moved
//! again, and an episode ends once all robots rest.

use std::collections::VecDeque;

use super::Point;

/// Number of places that are remembered at most.
const PLACES_MAX: usize = 19;
/// Number of places before the last one that are compared with it.
const COMPARED: usize = 5;
/// Number of these at which a robot rests.
const SAME_MIN: usize = 2;
/// Distance \[m\] below which two places are the same.
const SAME_M: f64 = 1e-4;

/// Last places of a robot.
#[derive(Clone, Debug, Default)]
pub struct Places {
    places: VecDeque<Point>,
}

impl Places {
    /// Adds the place of a robot after a step; its start is not added. Once 19 places are remembered, every other step
    /// forgets the oldest of them and adds none.
    pub fn add(&mut self, place: Point) {
        if self.places.len() < PLACES_MAX {
            self.places.push_back(place);
        } else {
            self.places.pop_front();
        }
    }

    /// Returns whether the robot rests: at least two of the five places before the last are the same as the last.
    pub fn at_rest(&self) -> bool {
        let mut back = self.places.iter().rev();
        let Some(last) = back.next() else { return false };
        let same = |place: &&Point| libm::hypot(place[0] - last[0], place[1] - last[1]) < SAME_M;
        back.take(COMPARED).filter(same).count() >= SAME_MIN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns for each place of a track, named by letters, whether the robot rests there.
    fn rests(track: &str) -> String {
        let mut places = Places::default();
        let rest = |letter: u8| {
            places.add([f64::from(letter), 0.0]);
            if places.at_rest() { '0' } else { '1' }
        };
        track.bytes().map(rest).collect()
    }

    #[test]
    fn a_robot_rests_where_the_library_lets_it_rest() {
        // Each pair is a track that the library was given, and what its controller did at each place.
        for (track, found) in [
            ("aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", "11000000000000000000000000000000"),
            ("abcabcabcabcabcabcabcabcabcabcabc", "111111111111111111110011110011111"),
            ("abcdabcdabcdabcdabcdabcdabcdabcd", "11111111111111111111111100000000"),
            ("aabaabaabaabaabaabaabaabaabaabaab", "111001001001001001000000000000001"),
            ("aaaabbbbccccddddeeeeffffgggghhhh", "11001100110011001100111111111111"),
        ] {
            assert_eq!(rests(track), found, "{track}");
        }
    }

    #[test]
    fn a_robot_that_moves_never_rests() {
        let mut places = Places::default();
        for step in 0..100 {
            places.add([f64::from(step) * 2e-4, 0.0]);
            assert!(!places.at_rest());
        }
    }
}
