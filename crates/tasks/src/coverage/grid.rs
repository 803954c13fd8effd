//! Square grid of cells on the ground, and windows of it around robots.

use std::ops::Range;

use super::Point;

/// Square grid of square cells. Its lower corner is the origin; cell (row, column) has the centre
/// ((row + 0.5) * side, (column + 0.5) * side), so that a row has one x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Number of cells along each axis.
    pub cells: usize,
    /// Side of a cell \[m\].
    pub cell_m: f64,
}

/// Rectangle of cells: the cells with a row in `rows` and a column in `columns`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Window {
    /// Rows of the rectangle.
    pub rows: Range<usize>,
    /// Columns of the rectangle.
    pub columns: Range<usize>,
}

impl Grid {
    /// Returns the side of the ground \[m\].
    pub fn side_m(&self) -> f64 {
        self.cells as f64 * self.cell_m
    }

    /// Returns the coordinate \[m\] of the centres of the cells with the index `index` along an axis.
    pub fn centre_m(&self, index: usize) -> f64 {
        (index as f64 + 0.5) * self.cell_m
    }

    /// Returns the window of all cells.
    pub fn all(&self) -> Window {
        Window { rows: 0..self.cells, columns: 0..self.cells }
    }

    /// Returns the square window of side `side_m` around `at`, without its part outside the ground. Its middle is the
    /// corner of a cell that is nearest to `at`, as in CoverageControl (by experiment, docs/coverage.md).
    pub fn window(&self, at: Point, side_m: f64) -> Window {
        let half = self.half(side_m);
        // A cast saturates: below the ground it gives 0.
        let end = |end: f64| (end as usize).min(self.cells);
        let [rows, columns] = at.map(|middle_m| {
            let middle = (middle_m / self.cell_m).round();
            end(middle - half)..end(middle + half)
        });
        Window { rows, columns }
    }

    /// Returns how many cells of the square window of side `side_m` around `at` are below the ground, along each axis.
    pub fn outside(&self, at: Point, side_m: f64) -> [usize; 2] {
        at.map(|middle_m| (self.half(side_m) - (middle_m / self.cell_m).round()) as usize)
    }

    /// Returns the number of cells along an axis of a square window of side `side_m`.
    pub fn across(&self, side_m: f64) -> usize {
        2 * self.half(side_m) as usize
    }

    /// Returns half the number of cells along an axis of a square window of side `side_m`.
    fn half(&self, side_m: f64) -> f64 {
        (side_m / self.cell_m / 2.0).round()
    }

    /// Returns the number of cells along an axis whose centres are below `bound_m` \[m\]: the cells from 0 up to it.
    pub(super) fn below(&self, bound_m: f64) -> usize {
        // A cast saturates, and takes what is no number for 0.
        ((bound_m / self.cell_m - 0.5).ceil() as usize).min(self.cells)
    }

    /// Returns `at`, or the place of the ground next to it, at least `margin_m` from its rim.
    pub fn inside(&self, at: Point, margin_m: f64) -> Point {
        at.map(|along| along.clamp(margin_m, self.side_m() - margin_m))
    }
}

impl Window {
    /// Returns whether the window has no cell.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty() || self.columns.is_empty()
    }

    /// Returns the cells that both windows have.
    pub fn within(&self, other: &Window) -> Window {
        let both = |one: &Range<usize>, other: &Range<usize>| {
            let start = one.start.max(other.start);
            start..one.end.min(other.end).max(start)
        };
        Window { rows: both(&self.rows, &other.rows), columns: both(&self.columns, &other.columns) }
    }

    /// Returns the lower and the upper corner of the window \[m\], on the grid `grid`.
    pub fn corners_m(&self, grid: &Grid) -> [Point; 2] {
        let corner = |row: usize, column: usize| [row as f64 * grid.cell_m, column as f64 * grid.cell_m];
        [corner(self.rows.start, self.columns.start), corner(self.rows.end, self.columns.end)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { cells: 1024, cell_m: 1.0 };

    #[test]
    fn a_window_is_around_the_nearest_corner_and_ends_at_the_rim() {
        let window = GRID.window([500.3, 400.9], 64.0);
        assert_eq!((window.rows, window.columns), (468..532, 369..433));
        let window = GRID.window([10.2, 1020.7], 64.0);
        assert_eq!((window.rows, window.columns), (0..42, 989..1024));
    }

    #[test]
    fn a_window_at_the_rim_says_what_it_lacks() {
        assert_eq!((GRID.outside([10.2, 1020.7], 64.0), GRID.across(64.0)), ([22, 0], 64));
        assert_eq!(GRID.outside([500.0, 0.0], 64.0), [0, 32]);
    }

    #[test]
    fn a_window_of_a_robot_far_outside_is_empty() {
        assert!(GRID.window([-200.0, 5.0], 64.0).is_empty());
        assert!(GRID.window([5.0, 1e9], 64.0).is_empty());
    }

    #[test]
    fn cells_are_below_a_bound_by_their_centres() {
        assert_eq!([0.4, 0.5, 0.6, 1.5, 1.6].map(|bound| GRID.below(bound)), [0, 0, 1, 1, 2]);
        assert_eq!([-7.0, f64::NEG_INFINITY, 2e9, f64::INFINITY].map(|bound| GRID.below(bound)), [0, 0, 1024, 1024]);
    }
}
