//! Sets of the cells of the ground that a robot or a team has seen so far.

use std::ops::Range;

use super::grid::{Grid, Window};

/// Set of cells that have been seen. Each row is a list of separate ranges of columns, in ascending order; a robot's
/// track leaves few of them.
#[derive(Clone, Debug)]
pub struct Seen {
    rows: Vec<Vec<Range<usize>>>,
}

impl Seen {
    /// Makes the empty set of cells of `grid`.
    pub fn nothing(grid: Grid) -> Seen {
        Seen { rows: vec![Vec::new(); grid.cells] }
    }

    /// Makes the set of all cells of `grid`.
    pub fn everything(grid: Grid) -> Seen {
        let mut seen = Seen::nothing(grid);
        seen.look(&grid.all());
        seen
    }

    /// Adds the cells of `window`, such as what a robot's sensor covers.
    pub fn look(&mut self, window: &Window) {
        if window.is_empty() {
            return;
        }
        for row in &mut self.rows[window.rows.clone()] {
            insert(row, window.columns.clone());
        }
    }

    /// Calls `visit` for each range of seen cells among the columns `columns` of the row `row`.
    pub fn within(&self, row: usize, columns: Range<usize>, mut visit: impl FnMut(Range<usize>)) {
        for seen in &self.rows[row] {
            let both = seen.start.max(columns.start)..seen.end.min(columns.end);
            if !both.is_empty() {
                visit(both);
            }
        }
    }

    /// Returns the number of cells in the set.
    pub fn cells(&self) -> usize {
        self.rows.iter().flatten().map(Range::len).sum()
    }
}

/// Adds the columns `new` to the separate, ascending ranges `ranges`; ranges that touch become one.
fn insert(ranges: &mut Vec<Range<usize>>, new: Range<usize>) {
    let first = ranges.partition_point(|range| range.end < new.start);
    let after = ranges.partition_point(|range| range.start <= new.end);
    if first == after {
        ranges.insert(first, new);
    } else {
        ranges[first] = ranges[first].start.min(new.start)..ranges[after - 1].end.max(new.end);
        ranges.drain(first + 1..after);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { cells: 12, cell_m: 1.0 };

    fn look(seen: &mut Seen, columns: Range<usize>) {
        seen.look(&Window { rows: 3..4, columns });
    }

    #[test]
    fn ranges_that_touch_become_one() {
        let mut seen = Seen::nothing(GRID);
        look(&mut seen, 2..4);
        look(&mut seen, 6..8);
        look(&mut seen, 10..11);
        assert_eq!(seen.rows[3], [2..4, 6..8, 10..11]);
        look(&mut seen, 4..5);
        assert_eq!(seen.rows[3], [2..5, 6..8, 10..11]);
        look(&mut seen, 0..7);
        assert_eq!(seen.rows[3], [0..8, 10..11]);
        look(&mut seen, 1..12);
        assert_eq!(&seen.rows[3][..], std::slice::from_ref(&(0..12)));
        assert_eq!(seen.cells(), 12);
    }

    #[test]
    fn only_what_was_seen_among_the_columns_is_visited() {
        let mut seen = Seen::nothing(GRID);
        look(&mut seen, 2..4);
        look(&mut seen, 6..8);
        let mut visited = Vec::new();
        seen.within(3, 3..7, |range| visited.push(range));
        assert_eq!(visited, [3..4, 6..7]);
        seen.within(2, 0..12, |range| visited.push(range));
        assert_eq!(visited.len(), 2);
    }

    #[test]
    fn a_window_without_cells_adds_none() {
        let mut seen = Seen::nothing(GRID);
        seen.look(&Window { rows: 0..0, columns: 2..5 });
        seen.look(&GRID.window([-99.0, 5.0], 4.0));
        assert_eq!(seen.cells(), 0);
        assert_eq!(Seen::everything(GRID).cells(), 144);
    }
}
