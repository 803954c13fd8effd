//! Who is near: points of the plane in square cells, so that nobody of a large team has to look at everyone.
//!
//! It gives candidates: all points within reach and a few just beyond, in the order of their numbers. Whoever asks
//! measures for itself, in its own arithmetic, so that no result depends on them. That they are few matters: each is
//! somebody whose state lies elsewhere in memory.

use crate::messages::geometry::Vec2;

/// Up to so many points it is quicker to look at all of them.
pub const FEW: usize = 32;

/// The smallest side of a cell \[m\].
const LEAST_CELL_M: f64 = 1e-3;
/// How much farther than the reach is looked: more than rounding can take from it.
const SLACK: f64 = 1.001;

/// A point and the cell that it is in.
#[derive(Clone, Copy, Debug)]
struct Entry {
    cell: (i32, i32),
    at: Vec2,
    number: u32,
}

/// Points in cells. Cells are spread over as many buckets as there are points, so no outlier makes it large.
#[derive(Clone, Debug, Default)]
pub struct Cells {
    cell_m: f64,
    /// Bucket b holds the entries from `starts[b]` to `starts[b + 1]`, in the order of their numbers.
    starts: Vec<u32>,
    entries: Vec<Entry>,
}

impl Cells {
    /// Points \[m\], numbered from zero, to be found within `reach_m` of anywhere; `None` if that is everywhere or no
    /// distance at all.
    pub fn new(reach_m: f32, points: impl Iterator<Item = Vec2>) -> Option<Cells> {
        if !(0.0..f32::INFINITY).contains(&reach_m) {
            return None;
        }
        let cell_m = (f64::from(reach_m) * SLACK).max(LEAST_CELL_M);
        let unsorted: Vec<Entry> =
            (0..).zip(points).map(|(number, at)| Entry { cell: cell(at, cell_m), at, number }).collect();
        let buckets = unsorted.len().next_power_of_two();
        let mut cells = Cells { cell_m, starts: vec![0; buckets + 1], entries: unsorted.clone() };
        for entry in &unsorted {
            cells.starts[bucket(entry.cell, buckets) + 1] += 1;
        }
        for at in 1..=buckets {
            cells.starts[at] += cells.starts[at - 1];
        }
        let mut next = cells.starts.clone();
        for entry in unsorted {
            let place = &mut next[bucket(entry.cell, buckets)];
            cells.entries[*place as usize] = entry;
            *place += 1;
        }
        Some(cells)
    }

    /// Puts the numbers of all points that may be within reach of `at` into `found`, in order, and nothing else.
    pub fn near(&self, at: Vec2, found: &mut Vec<usize>) {
        found.clear();
        let (x, y) = cell(at, self.cell_m);
        let apart = |a: f32, b: f32| f64::from(a) - f64::from(b);
        let within = |entry: &&Entry| {
            apart(entry.at.x, at.x).powi(2) + apart(entry.at.y, at.y).powi(2) <= self.cell_m * self.cell_m
        };
        for row in y.saturating_sub(1)..=y.saturating_add(1) {
            for column in x.saturating_sub(1)..=x.saturating_add(1) {
                let cell = (column, row);
                let bucket = bucket(cell, self.starts.len() - 1);
                let entries = &self.entries[self.starts[bucket] as usize..self.starts[bucket + 1] as usize];
                let here = entries.iter().filter(|entry| entry.cell == cell).filter(within);
                found.extend(here.map(|entry| entry.number as usize));
            }
        }
        found.sort_unstable();
    }
}

fn cell(at: Vec2, cell_m: f64) -> (i32, i32) {
    let along = |axis: f32| (f64::from(axis) / cell_m).floor() as i32;
    (along(at.x), along(at.y))
}

/// The bucket of a cell, of a number that is a power of two. Cells side by side have buckets side by side, and so has a
/// robot's neighbourhood its entries; rows begin an odd number apart, so that they meet again only after all buckets.
fn bucket((x, y): (i32, i32), buckets: usize) -> usize {
    let row = (buckets.isqrt() | 1) as u32;
    (x as u32).wrapping_add((y as u32).wrapping_mul(row)) as usize & (buckets - 1)
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use crate::random::Seed;

    #[test]
    fn nobody_within_reach_is_missed_and_few_beyond_are_named() {
        let mut stream = Seed::of_run(5).stream("cells");
        for (spread, reach) in [(20.0, 3.0), (20.0, 0.5), (1e5, 4.0), (3.0, 10.0), (5.0, 0.0)] {
            let mut point = || Vec2::new(stream.random_range(-spread..=spread), stream.random_range(-spread..=spread));
            let points: Vec<Vec2> = (0..500).map(|_| point()).collect();
            let cells = Cells::new(reach, points.iter().copied()).unwrap();
            let (mut found, mut named) = (Vec::new(), 0);
            for at in &points {
                cells.near(*at, &mut found);
                named += found.len();
                assert!(found.is_sorted_by(|a, b| a < b), "in order, each once");
                let within = (0..500).filter(|&other| (points[other] - at).norm() <= reach);
                assert!(within.into_iter().all(|other| found.binary_search(&other).is_ok()), "{spread} m, {reach} m");
            }
            let within: usize =
                points.iter().map(|at| points.iter().filter(|to| (**to - *at).norm() <= reach).count()).sum();
            assert!(named as f64 <= 1.01 * within as f64, "{named} for {within} at {spread} m, {reach} m");
        }
    }

    #[test]
    fn outliers_and_what_is_no_point_do_no_harm() {
        let points = [Vec2::repeat(f32::NAN), Vec2::repeat(f32::INFINITY), Vec2::repeat(f32::MAX), Vec2::zeros()];
        let cells = Cells::new(1.0, points.into_iter()).unwrap();
        let mut found = Vec::new();
        cells.near(Vec2::repeat(f32::MAX), &mut found);
        assert_eq!(found, [2]);
        cells.near(Vec2::zeros(), &mut found);
        assert!(found.contains(&3));
        assert!(
            Cells::new(f32::INFINITY, points.into_iter()).is_none()
                && Cells::new(f32::NAN, points.into_iter()).is_none()
        );
        Cells::new(1.0, std::iter::empty()).unwrap().near(Vec2::zeros(), &mut found);
        assert!(found.is_empty());
    }
}
