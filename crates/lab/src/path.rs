//! Path of a station: its position over time, piecewise linear.

use murmurate::messages::geometry::Vec2;
use murmurate::time::Time;

/// Position of a station over time: straight from point to point, and at rest before the first and after the last.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Time \[s\] and position \[m\], in the order of the times.
    points: Vec<(f64, [f64; 2])>,
}

impl Path {
    /// Returns the path of a station that stays at a position \[m\]. An error describes the fault.
    pub fn fixed(position: [f64; 2]) -> Result<Path, String> {
        Path::new(&[[0.0, position[0], position[1]]])
    }

    /// Returns a path through points, each with its time \[s\] and its position \[m\]. Times must increase. An error
    /// describes the fault.
    pub fn new(points: &[[f64; 3]]) -> Result<Path, String> {
        if points.is_empty() {
            return Err("a path has at least one point, [time in s, x in m, y in m]".to_owned());
        }
        let bounded = |point: &[f64; 3]| point.iter().all(|number| number.abs() <= 1e6);
        if !points.iter().all(bounded) {
            return Err("numbers of a path are finite and at most 1000000".to_owned());
        }
        if points.windows(2).any(|pair| pair[1][0] <= pair[0][0]) {
            return Err("the times of a path must increase".to_owned());
        }
        Ok(Path { points: points.iter().map(|&[at, x, y]| (at, [x, y])).collect() })
    }

    /// Returns whether the station moves.
    pub fn moves(&self) -> bool {
        self.points.len() > 1
    }

    /// Returns the position \[m\] at a time since the start of the laboratory.
    pub fn at(&self, time: Time) -> Vec2 {
        let time = time.as_secs();
        let after = self.points.partition_point(|(at, _)| *at <= time);
        let [x, y] = match (after.checked_sub(1).map(|before| self.points[before]), self.points.get(after)) {
            (Some((since, from)), Some(&(until, to))) => {
                let share = (time - since) / (until - since);
                [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])]
            }
            (Some((_, last)), None) => last,
            (None, _) => self.points[0].1,
        };
        Vec2::new(x as f32, y as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::time::Span;

    #[test]
    fn a_path_is_straight_between_its_points_and_rests_outside() {
        let path = Path::new(&[[1.0, 0.0, 0.0], [3.0, 4.0, -2.0]]).unwrap();
        let at = |s: f64| path.at(Time::ZERO + Span::from_secs(s));
        assert_eq!([at(0.0), at(1.0)], [Vec2::new(0.0, 0.0); 2]);
        assert_eq!(at(2.0), Vec2::new(2.0, -1.0));
        assert_eq!([at(3.0), at(9.0)], [Vec2::new(4.0, -2.0); 2]);
        assert!(Path::new(&[]).is_err() && Path::new(&[[0.0, f64::NAN, 0.0]]).is_err());
    }
}
