//! Uniform grid for radius queries: points in the plane in square cells.
//!
//! A query returns candidates in the order of their indices: all points within the radius and a few just beyond. The
//! caller computes distances itself, in its own arithmetic, so no result depends on the grid. Few candidates matter,
//! because each one's state is a separate access to memory.

use crate::messages::geometry::Vec2;

/// Largest number of points for which a search through all of them is faster than a query of the grid [`Cells`].
pub(crate) const LINEAR_SEARCH_MAX: usize = 32;

/// Smallest side of a cell \[m\].
const MIN_CELL_M: f64 = 1e-3;
/// Ratio of a cell's side to the query radius: above 1 by more than rounding errors.
const SLACK: f64 = 1.001;

/// Point of the grid: its cell (column, row), its position \[m\], and its index in the order given.
#[derive(Clone, Copy, Debug)]
struct Entry {
    cell: (i32, i32),
    at: Vec2,
    index: u32,
}

/// Uniform grid over points in the plane, for queries of all points within a radius. The square cells are hashed to
/// about as many buckets as there are points, so distant points cost no memory.
#[derive(Clone, Debug, Default)]
pub struct Cells {
    cell_m: f64,
    /// Bucket b holds the entries from `starts[b]` to `starts[b + 1]`, in the order of their indices.
    starts: Vec<u32>,
    entries: Vec<Entry>,
}

impl Cells {
    /// Makes the grid for queries of radius `radius_m` \[m\]. `points` are positions \[m\], indexed from zero in their
    /// order. Returns `None` if the radius is infinite, negative or NaN.
    pub fn new(radius_m: f32, points: impl Iterator<Item = Vec2>) -> Option<Cells> {
        if !(0.0..f32::INFINITY).contains(&radius_m) {
            return None;
        }
        let cell_m = (f64::from(radius_m) * SLACK).max(MIN_CELL_M);
        let unsorted: Vec<Entry> =
            (0..).zip(points).map(|(index, at)| Entry { cell: cell(at, cell_m), at, index }).collect();
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

    /// Replaces the content of `found` by the indices, ascending, of the points around the position `at` \[m\]. The
    /// search radius is that given to `new`, and indices count the points given to `new`, from zero. Points up to 0.1 %
    /// (1 mm for a tiny radius) beyond the radius may be included.
    pub fn near(&self, at: Vec2, found: &mut Vec<usize>) {
        found.clear();
        let (x, y) = cell(at, self.cell_m);
        let difference = |a: f32, b: f32| f64::from(a) - f64::from(b);
        let within = |entry: &&Entry| {
            difference(entry.at.x, at.x).powi(2) + difference(entry.at.y, at.y).powi(2) <= self.cell_m * self.cell_m
        };
        for row in y.saturating_sub(1)..=y.saturating_add(1) {
            for column in x.saturating_sub(1)..=x.saturating_add(1) {
                let cell = (column, row);
                let bucket = bucket(cell, self.starts.len() - 1);
                let entries = &self.entries[self.starts[bucket] as usize..self.starts[bucket + 1] as usize];
                let here = entries.iter().filter(|entry| entry.cell == cell).filter(within);
                found.extend(here.map(|entry| entry.index as usize));
            }
        }
        found.sort_unstable();
    }
}

/// Returns the column and row of the cell that contains the point `at` \[m\], for cells of side `cell_m` \[m\].
fn cell(at: Vec2, cell_m: f64) -> (i32, i32) {
    let along = |axis: f32| (f64::from(axis) / cell_m).floor() as i32;
    (along(at.x), along(at.y))
}

/// Returns the index of the hash bucket of a cell (column, row); `buckets` is a power of two. Adjacent cells of a row
/// have adjacent buckets, so nearby points lie together in memory. Rows begin an odd number of buckets apart, so no two
/// rows begin at the same bucket until all have been used.
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
    fn a_query_returns_all_points_within_the_radius_and_few_beyond() {
        let mut stream = Seed::of_run(5).stream("cells");
        for (spread, reach) in [(20.0, 3.0), (20.0, 0.5), (1e5, 4.0), (3.0, 10.0), (5.0, 0.0)] {
            let mut point = || Vec2::new(stream.random_range(-spread..=spread), stream.random_range(-spread..=spread));
            let points: Vec<Vec2> = (0..500).map(|_| point()).collect();
            let cells = Cells::new(reach, points.iter().copied()).unwrap();
            let (mut found, mut returned) = (Vec::new(), 0);
            for at in &points {
                cells.near(*at, &mut found);
                returned += found.len();
                assert!(found.is_sorted_by(|a, b| a < b), "in order, each once");
                let within = (0..500).filter(|&other| (points[other] - at).norm() <= reach);
                assert!(within.into_iter().all(|other| found.binary_search(&other).is_ok()), "{spread} m, {reach} m");
            }
            let within: usize =
                points.iter().map(|at| points.iter().filter(|to| (**to - *at).norm() <= reach).count()).sum();
            assert!(returned as f64 <= 1.01 * within as f64, "{returned} for {within} at {spread} m, {reach} m");
        }
    }

    #[test]
    fn outliers_and_non_finite_points_do_no_harm() {
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
