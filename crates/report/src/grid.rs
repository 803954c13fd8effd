//! Two-dimensional histogram.

use serde::{Deserialize, Serialize};

/// Axis of a histogram, divided into equal bins.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Lower end of the axis.
    pub(crate) low: f32,
    /// Upper end of the axis.
    pub high: f32,
    /// Number of bins.
    pub bins: usize,
}

impl Axis {
    /// Returns an axis from `low` to `high` with bins of about the width `width`, but at most `most` bins.
    pub fn new(low: f32, high: f32, width: f32, most: usize) -> Axis {
        let bins = ((high - low) / width).round() as usize;
        Axis { low, high, bins: bins.clamp(1, most) }
    }

    /// Returns the width of a bin.
    pub fn width(&self) -> f32 {
        (self.high - self.low) / self.bins as f32
    }

    /// Returns the lower edge of the bin with the index `bin`.
    pub fn at(&self, bin: usize) -> f32 {
        self.low + self.width() * bin as f32
    }

    /// Returns the index of a value's bin. Values beyond an end belong to the bin at that end.
    fn bin(&self, value: f32) -> usize {
        (((value - self.low) / self.width()).max(0.0) as usize).min(self.bins - 1)
    }
}

/// Two-dimensional histogram: number of counted pairs (x, y) in each bin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Sparse", into = "Sparse")]
pub struct Grid {
    /// Axis of the first number, x.
    pub x: Axis,
    /// Axis of the second number, y.
    pub y: Axis,
    counts: Vec<u64>,
}

/// Serialized form of a histogram, without empty bins.
#[derive(Clone, Serialize, Deserialize)]
struct Sparse {
    x: Axis,
    y: Axis,
    counts: Vec<(usize, u64)>,
}

impl From<Grid> for Sparse {
    fn from(grid: Grid) -> Sparse {
        let counts = grid.counts.into_iter().enumerate().filter(|(_, count)| *count > 0).collect();
        Sparse { x: grid.x, y: grid.y, counts }
    }
}

impl From<Sparse> for Grid {
    fn from(sparse: Sparse) -> Grid {
        let mut grid = Grid::new(sparse.x, sparse.y);
        for (at, count) in sparse.counts {
            if let Some(place) = grid.counts.get_mut(at) {
                *place = count;
            }
        }
        grid
    }
}

impl Grid {
    /// Returns an empty histogram with these axes.
    pub fn new(x: Axis, y: Axis) -> Grid {
        Grid { x, y, counts: vec![0; x.bins.saturating_mul(y.bins).min(1 << 20)] }
    }

    /// Counts the pair (`x`, `y`). A number beyond an end of its axis belongs to the bin at that end.
    pub fn add(&mut self, x: f32, y: f32) {
        let at = self.y.bin(y) * self.x.bins + self.x.bin(x);
        self.counts[at] += 1;
    }

    /// Adds the counts of another histogram. Panics unless both have the same axes.
    pub fn merge(&mut self, other: &Grid) {
        assert_eq!((self.x, self.y), (other.x, other.y), "grids of one study have the same axes");
        self.counts.iter_mut().zip(&other.counts).for_each(|(mine, theirs)| *mine += theirs);
    }

    /// Returns the largest count of all bins.
    pub fn most(&self) -> u64 {
        self.counts.iter().copied().max().unwrap_or(0)
    }

    /// Returns the number of all counted pairs.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Returns the number of pairs in the bin with the indices `x` and `y`.
    pub fn count(&self, x: usize, y: usize) -> u64 {
        self.counts[y * self.x.bins + x]
    }

    /// Returns the quantile `q` (0 to 1) of y among the pairs whose x is in the bin `x`, interpolated within bins of y;
    /// `None` if these are fewer than `least`.
    pub fn quantile(&self, x: usize, q: f64, least: u64) -> Option<f32> {
        let total: u64 = (0..self.y.bins).map(|y| self.count(x, y)).sum();
        if total < least.max(1) {
            return None;
        }
        let (wanted, mut before) = (q * total as f64, 0.0);
        for y in 0..self.y.bins {
            let here = self.count(x, y) as f64;
            if here > 0.0 && before + here >= wanted {
                return Some(self.y.at(y) + self.y.width() * ((wanted - before) / here).clamp(0.0, 1.0) as f32);
            }
            before += here;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_is_read_from_its_text_unchanged_and_has_quantiles() {
        let mut grid = Grid::new(Axis::new(0.0, 1.0, 0.5, 10), Axis::new(0.0, 4.0, 1.0, 10));
        for y in [0.5, 1.5, 2.5, 3.5, 9.0] {
            grid.add(0.1, y);
        }
        assert_eq!((grid.total(), grid.count(0, 3)), (5, 2), "what is beyond the end counts in the last bin");
        assert_eq!(grid.quantile(0, 0.4, 1), Some(2.0));
        assert_eq!(grid.quantile(1, 0.4, 1), None);
        let text = serde_json::to_string(&grid).unwrap();
        assert_eq!(serde_json::from_str::<Grid>(&text).unwrap(), grid);
    }
}
