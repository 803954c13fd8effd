//! Voronoi cells on the grid: which cells are nearest to which robot, and their masses and centroids.
//!
//! In a row of the grid the squared distances to two robots differ by a linear function of y. So the cells of a row
//! that are nearest to a robot are one range of columns, the robots' ranges are the lower envelope of lines, and each
//! is found without a look at the cells. A cell as near to two robots belongs to the one with the larger y.

use std::ops::Range;

use super::{
    Point,
    field::{Field, Sums},
    grid::{Grid, Window},
    seen::Seen,
};

/// Mass below which a Voronoi cell counts as empty. A mass of 1e-8 still counts in CoverageControl, and one of 1e-12
/// does not (by experiment, docs/coverage.md).
pub const EMPTY_MASS: f64 = 1e-10;

/// Mass and first moment of a Voronoi cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// Sum of the density.
    pub mass: f64,
    /// Sum of density times place \[m\].
    pub first: Point,
}

impl Moments {
    /// Adds cells of one row, whose x is `x_m`.
    pub(super) fn add(&mut self, x_m: f64, sums: Sums) {
        self.mass += sums.mass;
        self.first[0] += sums.mass * x_m;
        self.first[1] += sums.first;
    }

    /// Adds one cell with its centre `at` \[m\].
    pub(super) fn add_cell(&mut self, at: Point, density: f64) {
        self.mass += density;
        self.first[0] += density * at[0];
        self.first[1] += density * at[1];
    }

    /// Returns the centroid \[m\]; `None` if the cell is empty.
    pub fn centroid(&self) -> Option<Point> {
        (self.mass >= EMPTY_MASS).then(|| self.first.map(|first| first / self.mass))
    }
}

/// Line of the lower envelope: a robot, and the y \[m\] from which on it is nearest in the row.
struct Stretch {
    robot: usize,
    from_m: f64,
}

/// Calls `visit` with the index of each robot, a row and the range of its columns that are nearest to the robot, for
/// all cells of `grid`, row after row and by ascending columns.
pub fn partition(grid: Grid, robots: &[Point], mut visit: impl FnMut(usize, usize, Range<usize>)) {
    let mut order: Vec<usize> = (0..robots.len()).collect();
    order.sort_by(|&one, &other| robots[one][1].total_cmp(&robots[other][1]).then(one.cmp(&other)));
    let mut envelope: Vec<Stretch> = Vec::with_capacity(robots.len());
    for row in 0..grid.cells {
        let x_m = grid.centre_m(row);
        envelope.clear();
        for &robot in &order {
            extend(&mut envelope, robots, x_m, robot);
        }
        let mut from = 0;
        for (at, stretch) in envelope.iter().enumerate() {
            let to = envelope.get(at + 1).map_or(grid.cells, |next| grid.below(next.from_m)).max(from);
            if from < to {
                visit(stretch.robot, row, from..to);
            }
            from = to;
        }
    }
}

/// Adds the line of `robot`, whose y is at least that of all robots before, to the lower envelope of the row at `x_m`.
fn extend(envelope: &mut Vec<Stretch>, robots: &[Point], x_m: f64, robot: usize) {
    while let Some(last) = envelope.last() {
        match crossing(robots[last.robot], robots[robot], x_m) {
            Crossing::At(y_m) if y_m > last.from_m => {
                envelope.push(Stretch { robot, from_m: y_m });
                return;
            }
            Crossing::Never => return,
            Crossing::At(_) | Crossing::Always => drop(envelope.pop()),
        }
    }
    envelope.push(Stretch { robot, from_m: f64::NEG_INFINITY });
}

/// Part of a line of equal x on which the second of two robots is nearer than the first.
enum Crossing {
    /// From this y \[m\] on.
    At(f64),
    /// Nowhere.
    Never,
    /// Everywhere.
    Always,
}

/// Returns where on the line at `x_m` the robot `second`, whose y is at least that of `first`, is nearer.
fn crossing(first: Point, second: Point, x_m: f64) -> Crossing {
    let height = |robot: Point| robot[1] * robot[1] + (x_m - robot[0]) * (x_m - robot[0]);
    let apart_m = second[1] - first[1];
    if apart_m > 0.0 {
        Crossing::At((height(second) - height(first)) / (2.0 * apart_m))
    } else if height(second) < height(first) {
        Crossing::Always
    } else {
        Crossing::Never
    }
}

/// Returns the columns among `columns` of the row `row` that are nearer to `own` than to every one of `others`.
pub fn own_columns(grid: Grid, row: usize, own: Point, others: &[Point], columns: Range<usize>) -> Range<usize> {
    let x_m = grid.centre_m(row);
    let Range { mut start, mut end } = columns;
    for &other in others {
        if other[1] >= own[1] {
            match crossing(own, other, x_m) {
                Crossing::At(y_m) => end = end.min(grid.below(y_m)),
                Crossing::Never => {}
                Crossing::Always => end = start,
            }
        } else if let Crossing::At(y_m) = crossing(other, own, x_m) {
            start = start.max(grid.below(y_m));
        }
    }
    start..end.max(start)
}

/// Returns mass and first moment of each robot's Voronoi cell, in the order of `robots`; only of what is in `seen`, if
/// it is given.
pub fn moments(field: &Field, robots: &[Point], seen: Option<&Seen>) -> Vec<Moments> {
    let grid = field.grid();
    let mut all = vec![Moments::default(); robots.len()];
    partition(grid, robots, |robot, row, columns| {
        let x_m = grid.centre_m(row);
        let mut add = |columns| all[robot].add(x_m, field.sums(row, columns));
        match seen {
            None => add(columns),
            Some(seen) => seen.within(row, columns, add),
        }
    });
    all
}

/// Returns mass and first moment of what is in `seen` and in `window`, and nearer to `own` than to every one of
/// `others`.
pub fn own_moments(field: &Field, own: Point, others: &[Point], seen: &Seen, window: &Window) -> Moments {
    let grid = field.grid();
    let mut own_cell = Moments::default();
    for row in window.rows.clone() {
        let columns = own_columns(grid, row, own, others, window.columns.clone());
        let x_m = grid.centre_m(row);
        seen.within(row, columns, |columns| own_cell.add(x_m, field.sums(row, columns)));
    }
    own_cell
}

/// Returns the vertices of the polygon of all places of the rectangle with the corners `low` and `high` that are nearer
/// to `own` than to every one of `others` \[m\]. It is empty if there are none.
pub fn vertices(own: Point, others: &[Point], low: Point, high: Point) -> Vec<Point> {
    let mut polygon = vec![low, [high[0], low[1]], high, [low[0], high[1]]];
    for other in others {
        let normal = [other[0] - own[0], other[1] - own[1]];
        let middle = [0, 1].map(|axis| 0.5 * (other[axis] + own[axis]));
        let beyond = |at: Point| (at[0] - middle[0]) * normal[0] + (at[1] - middle[1]) * normal[1];
        let mut clipped = Vec::with_capacity(polygon.len() + 1);
        for (at, &from) in polygon.iter().enumerate() {
            let to = polygon[(at + 1) % polygon.len()];
            let (before, after) = (beyond(from), beyond(to));
            if before <= 0.0 {
                clipped.push(from);
            }
            if (before < 0.0 && after > 0.0) || (before > 0.0 && after < 0.0) {
                let share = before / (before - after);
                clipped.push([0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * share));
            }
        }
        polygon = clipped;
    }
    polygon
}

#[cfg(test)]
mod tests {
    use murmurate::random::Seed;

    use super::*;
    use crate::coverage::field::place;

    const GRID: Grid = Grid { cells: 40, cell_m: 0.5 };

    fn square(from: Point, to: Point) -> f64 {
        (from[0] - to[0]) * (from[0] - to[0]) + (from[1] - to[1]) * (from[1] - to[1])
    }

    fn uniform() -> Field {
        Field::of_cells(GRID, vec![1.0; 1600]).expect("a density of 1")
    }

    #[test]
    fn each_cell_belongs_to_its_nearest_robot() {
        let mut stream = Seed::of_run(1).stream("voronoi");
        for robots in [1, 2, 3, 9, 40] {
            let robots: Vec<Point> = (0..robots).map(|_| place(GRID, &mut stream)).collect();
            let mut owners = vec![usize::MAX; 1600];
            partition(GRID, &robots, |robot, row, columns| {
                columns.for_each(|column| owners[row * 40 + column] = robot);
            });
            for (cell, &owner) in owners.iter().enumerate() {
                let centre = [GRID.centre_m(cell / 40), GRID.centre_m(cell % 40)];
                let nearest = (0..robots.len())
                    .min_by(|&one, &other| square(robots[one], centre).total_cmp(&square(robots[other], centre)));
                assert_eq!(Some(owner), nearest);
            }
        }
    }

    #[test]
    fn a_robots_own_columns_are_those_of_the_partition() {
        let mut stream = Seed::of_run(2).stream("voronoi");
        let robots: Vec<Point> = (0..12).map(|_| place(GRID, &mut stream)).collect();
        let everything = Seen::everything(GRID);
        let all = moments(&uniform(), &robots, None);
        for (own, of_partition) in all.iter().enumerate() {
            let others: Vec<Point> = (0..12).filter(|&other| other != own).map(|other| robots[other]).collect();
            let found = own_moments(&uniform(), robots[own], &others, &everything, &GRID.all());
            assert_eq!(found, *of_partition);
        }
    }

    #[test]
    fn halves_of_a_uniform_ground_have_their_middles_as_centroids() {
        for (robots, middles) in [
            ([[5.0, 4.0], [15.0, 4.0]], [[5.0, 10.0], [15.0, 10.0]]),
            ([[3.0, 17.0], [3.0, 3.0]], [[10.0, 15.0], [10.0, 5.0]]),
        ] {
            let found = moments(&uniform(), &robots, None);
            assert_eq!([found[0].mass, found[1].mass], [800.0, 800.0]);
            assert_eq!(found.iter().map(Moments::centroid).collect::<Vec<_>>(), middles.map(Some));
        }
    }

    #[test]
    fn only_what_was_seen_counts() {
        let mut seen = Seen::nothing(GRID);
        seen.look(&GRID.window([5.0, 10.0], 2.0));
        let found = moments(&uniform(), &[[1.0, 1.0], [19.0, 19.0]], Some(&seen));
        assert_eq!((found[0].mass, found[0].centroid()), (16.0, Some([5.0, 10.0])));
        assert_eq!((found[1].mass, found[1].centroid()), (0.0, None));
    }

    #[test]
    fn robots_outside_the_ground_and_in_one_place_share_it() {
        let far = moments(&uniform(), &[[-50.0, 10.0], [10.0, 1000.0]], None);
        assert_eq!((far[0].mass, far[1].mass), (1600.0, 0.0));
        let same = moments(&uniform(), &[[7.0, 7.0]; 3], None);
        assert_eq!(same.iter().map(|cell| cell.mass).sum::<f64>(), 1600.0);
        assert!(moments(&uniform(), &[], None).is_empty());
    }

    #[test]
    fn the_polygon_of_a_cell_ends_half_way_to_the_others() {
        let polygon = vertices([4.0, 5.0], &[[12.0, 5.0], [4.0, 11.0]], [0.0, 0.0], [20.0, 20.0]);
        assert_eq!(polygon, [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]]);
        assert!(vertices([90.0, 5.0], &[[10.0, 5.0]], [0.0, 0.0], [20.0, 20.0]).is_empty());
    }
}
