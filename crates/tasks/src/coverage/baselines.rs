//! Scripted controllers: each robot goes to the centroid of its Voronoi cell (Lloyd's method, as a control law by
//! Cortes et al. 2004). The three differ in what is known, as those of arXiv 2401.04855 do:
//!
//! - The clairvoyant one knows the whole density and all positions.
//! - The centralised one knows what the team has seen so far, and all positions.
//! - The decentralised one knows, for each robot, what this robot has seen so far within its local map, and the
//!   positions of the robots within communication range.
//!
//! The density of unseen cells counts as zero. A robot whose cell has no density goes to the mean of the vertices of
//! the cell, as in CoverageControl (by experiment, docs/coverage.md).

use super::{Point, field::Field, seen::Seen, voronoi};

/// Returns the goal \[m\] of each robot of `robots` if the whole density is known.
pub fn clairvoyant(field: &Field, robots: &[Point]) -> Vec<Point> {
    of_team(field, robots, None)
}

/// Returns the goal \[m\] of each robot of `robots` if `seen` is what the team has seen so far.
pub fn centralised(field: &Field, robots: &[Point], seen: &Seen) -> Vec<Point> {
    of_team(field, robots, Some(seen))
}

/// Returns the goal \[m\] of the robot at `own` if `seen` is what it has seen so far, `neighbours` are the places of
/// the robots that it hears, and its local map is a square of side `local_map_m`.
pub fn decentralised(field: &Field, own: Point, neighbours: &[Point], seen: &Seen, local_map_m: f64) -> Point {
    let window = field.grid().window(own, local_map_m);
    let cell = voronoi::own_moments(field, own, neighbours, seen, &window);
    cell.centroid().unwrap_or_else(|| middle(own, neighbours, window.corners_m(&field.grid())))
}

fn of_team(field: &Field, robots: &[Point], seen: Option<&Seen>) -> Vec<Point> {
    let cells = voronoi::moments(field, robots, seen);
    let goal = |(at, cell): (usize, &voronoi::Moments)| {
        cell.centroid().unwrap_or_else(|| {
            let others: Vec<Point> = robots[..at].iter().chain(&robots[at + 1..]).copied().collect();
            middle(robots[at], &others, field.grid().all().corners_m(&field.grid()))
        })
    };
    cells.iter().enumerate().map(goal).collect()
}

/// Returns the mean of the vertices of the Voronoi cell of a robot at `own` within a rectangle, by its corners; `own`
/// if the cell is outside.
pub(super) fn middle(own: Point, others: &[Point], corners: [Point; 2]) -> Point {
    let polygon = voronoi::vertices(own, others, corners[0], corners[1]);
    if polygon.is_empty() {
        return own;
    }
    [0, 1].map(|axis| polygon.iter().map(|vertex| vertex[axis]).sum::<f64>() / polygon.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coverage::grid::Grid;

    const GRID: Grid = Grid { cells: 100, cell_m: 1.0 };

    fn point_at(row: usize, column: usize) -> Field {
        let mut density = vec![0.0; 10_000];
        density[row * 100 + column] = 1.0;
        Field::of_cells(GRID, density).expect("a density")
    }

    #[test]
    fn the_clairvoyant_controller_goes_to_unseen_cells() {
        let field = point_at(70, 20);
        let robots = [[10.0, 50.0], [90.0, 50.0]];
        let goals = clairvoyant(&field, &robots);
        assert_eq!(goals, [[25.0, 50.0], [70.5, 20.5]], "the first robot has an empty cell, the lower half");
        assert_eq!(centralised(&field, &robots, &Seen::nothing(GRID)), [[25.0, 50.0], [75.0, 50.0]]);
        assert_eq!(centralised(&field, &robots, &Seen::everything(GRID)), goals);
    }

    #[test]
    fn the_decentralised_controller_keeps_to_its_local_map() {
        let field = point_at(70, 20);
        let everything = Seen::everything(GRID);
        assert_eq!(decentralised(&field, [60.0, 20.0], &[], &everything, 40.0), [70.5, 20.5]);
        assert_eq!(decentralised(&field, [40.0, 20.0], &[], &everything, 40.0), [40.0, 20.0]);
        let goal = decentralised(&field, [60.0, 20.0], &[[76.0, 20.0]], &everything, 40.0);
        assert_eq!(goal, [54.0, 20.0], "its neighbour is nearer");
        assert_eq!(decentralised(&field, [60.0, 20.0], &[], &Seen::nothing(GRID), 40.0), [60.0, 20.0]);
    }

    #[test]
    fn a_robot_outside_the_ground_comes_back() {
        let everything = Seen::everything(GRID);
        assert_eq!(decentralised(&point_at(70, 20), [-300.0, 20.0], &[], &everything, 40.0), [0.0, 20.0]);
    }
}
