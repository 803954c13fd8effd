//! Cost of a team: how far what is important is from the nearest robot.

use super::{Point, field::Field, voronoi::partition};

/// Returns the sum over all cells of density times squared distance \[m²\] from the cell's centre to the nearest robot:
/// the coverage cost of Cortes et al. 2004 and of arXiv 2401.04855, on a grid. Without any robot it is zero.
pub fn cost(field: &Field, robots: &[Point]) -> f64 {
    let grid = field.grid();
    let mut of_robots = vec![0.0; robots.len()];
    partition(grid, robots, |robot, row, columns| {
        let sums = field.sums(row, columns);
        let [x_m, y_m] = robots[robot];
        let dx_m = grid.centre_m(row) - x_m;
        // The sum of (y - y_m)^2, term by term.
        let along = sums.second - 2.0 * y_m * sums.first + y_m * y_m * sums.mass;
        of_robots[robot] += dx_m * dx_m * sums.mass + along;
    });
    of_robots.iter().sum()
}

/// Returns `cost` relative to `first`, the cost at the start of an episode. Where there was no cost, there is nothing
/// to gain: it is 1.
pub fn normalised(cost: f64, first: f64) -> f64 {
    if first > 0.0 { cost / first } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coverage::grid::Grid;

    const GRID: Grid = Grid { cells: 10, cell_m: 2.0 };

    #[test]
    fn one_cell_costs_its_squared_distance_to_the_nearest_robot() {
        let mut density = vec![0.0; 100];
        density[23] = 0.5;
        let field = Field::of_cells(GRID, density).expect("a density");
        // Row 2, column 3: the centre is (5, 7).
        assert_eq!(cost(&field, &[[5.0, 7.0]]), 0.0);
        assert_eq!(cost(&field, &[[2.0, 3.0], [19.0, 19.0]]), 0.5 * 25.0);
        assert_eq!(cost(&field, &[[-2.0, 7.0], [5.0, 60.0]]), 0.5 * 49.0);
    }

    #[test]
    fn two_robots_share_two_cells() {
        let mut density = vec![0.0; 100];
        (density[0], density[99]) = (1.0, 2.0);
        let field = Field::of_cells(GRID, density).expect("a density");
        assert_eq!(cost(&field, &[[1.0, 4.0], [19.0, 18.0]]), 9.0 + 2.0);
    }

    #[test]
    fn an_empty_field_costs_nothing_and_stays_at_its_start() {
        let field = Field::of_cells(GRID, vec![0.0; 100]).expect("a density");
        assert_eq!(cost(&field, &[[1.0, 4.0], [19.0, 18.0]]), 0.0);
        assert_eq!((normalised(0.0, 0.0), normalised(3.0, 12.0)), (1.0, 0.25));
    }
}
