//! Channels of coverage: what a robot's sensor covers, local maps of what the robot has seen so far, and for baselines
//! the whole density.

use murmurate::messages::geometry::{Task, Vec2};
use murmurate::observation::{Channel, Known, Quantity, Unit};

use super::{
    field::integrals,
    size::{Size, TRUNCATION},
};

/// Name of the channel that has what a robot's sensor covers.
pub const DENSITY: &str = "density";
/// Name of the channel that has a robot's local map.
pub const MAP: &str = "map";
/// Name of the channel that has a robot's local map in coarse cells.
pub const COARSE_MAP: &str = "coarse-map";
/// Name of the channel that has the means of the Gaussians of the density.
pub const MEANS: &str = "means";
/// Planes of a local map: importance of the cells that the robot has seen, whether it has seen them, and whether they
/// are on the ground.
const PLANES: usize = 3;

/// Returns the channel `density`: the importance of each cell that the sensor covers, along x and then along y.
pub(super) fn density(size: &'static Size) -> Channel {
    let across = size.grid.across(size.sensor_m);
    let about = "importance of each cell around the robot that its sensor covers, along x and then along y";
    let form = (vec![across, across], Unit::One, Quantity::Number);
    Channel::new(DENSITY, about, form, move |known, values| sense(size, known, values))
}

/// Returns the channel `map`: the cells of the local map around the robot, along x and then along y, in planes.
pub(super) fn map(size: &'static Size) -> Channel {
    let across = size.grid.across(size.local_map_m);
    let about = "what the robot has seen around it: importance, seen (1) or not, ground (1) or not, along x, then y";
    let form = (vec![PLANES, across, across], Unit::One, Quantity::Number);
    let cells = size.grid.cells * size.grid.cells;
    Channel::remembering(MAP, about, form, cells, move |seen, known, values| {
        values.fill(0.0);
        look(size, seen, known, |[row, column], planes| {
            for (plane, value) in planes.into_iter().enumerate() {
                values[(plane * across + row) * across + column] = value;
            }
        })
        .unwrap_or_else(|Untold| values.fill(f32::NAN));
    })
}

/// Returns the channel `coarse-map`: the local map with several cells as one, so that a small network can take it.
pub(super) fn coarse_map(size: &'static Size) -> Channel {
    let (cells, joined) = (size.grid.cells * size.grid.cells, size.coarse_cells);
    let across = size.grid.across(size.local_map_m) / joined;
    let about = "the map in coarse cells: mean importance (1: middle of a usual Gaussian), shares seen and of ground";
    let form = (vec![PLANES, across, across], Unit::One, Quantity::Number);
    let share = 1.0 / (joined * joined) as f32;
    let factors = [share / size.usual_importance() as f32, share, share];
    Channel::remembering(COARSE_MAP, about, form, cells, move |seen, known, values| {
        values.fill(0.0);
        look(size, seen, known, |[row, column], planes| {
            for (plane, (value, factor)) in planes.into_iter().zip(factors).enumerate() {
                values[(plane * across + row / joined) * across + column / joined] += value * factor;
            }
        })
        .unwrap_or_else(|Untold| values.fill(f32::NAN));
    })
}

/// Returns the channel `means`: the means of the Gaussians, of which the whole density follows, in a team of `robots`.
/// No robot knows them by its sensor; it is for baselines that know more than a robot can.
pub(super) fn means(robots: usize) -> Channel {
    let about = "means of the density's Gaussians, which robots do not know: for baselines only";
    Channel::new(MEANS, about, (vec![robots, 2], Unit::Metre, Quantity::Point), |known, values| {
        let goal = |task: &Option<Task>| task.map_or(Vec2::repeat(f32::NAN), |task| known.own.frame.turn(task.goal));
        values.fill(f32::NAN);
        for (value, task) in values.chunks_exact_mut(2).zip(known.team) {
            value.copy_from_slice(goal(task).as_slice());
        }
    })
}

/// Writes what the sensor of a robot covers: for each cell, the integral of the density over it, row after row; 0
/// outside the ground. All are unknown while the task of a robot of the team is.
fn sense(size: &Size, known: &Known, values: &mut [f32]) {
    let Some(goals) = known.team.iter().map(|task| Some(task.as_ref()?.goal)).collect::<Option<Vec<Vec2>>>() else {
        return values.fill(f32::NAN);
    };
    values.fill(0.0);
    let at = size.on_ground(known.own.motion.position);
    let window = size.grid.window(at, size.sensor_m);
    let [below, left] = size.grid.outside(at, size.sensor_m);
    let sums = integrals(size.grid, &size.features(goals.into_iter()), TRUNCATION, &window);
    let across = size.grid.across(size.sensor_m);
    for (row, sums) in sums.chunks_exact(window.columns.len().max(1)).enumerate() {
        let written = &mut values[(below + row) * across + left..];
        written.iter_mut().zip(sums).for_each(|(value, sum)| *value = *sum as f32);
    }
}

/// The density is not known yet, as the task of a robot of the team is not.
struct Untold;

/// Adds what the sensor covers to the cells that the robot has `seen`, and calls `write` with each cell of its local
/// map that is on the ground: row and column in the map, and the values of the planes. A cell that was seen holds its
/// importance, or the smallest positive number if it has none; all others hold 0.
fn look(
    size: &Size,
    seen: &mut [f32],
    known: &Known,
    mut write: impl FnMut([usize; 2], [f32; PLANES]),
) -> Result<(), Untold> {
    let grid = size.grid;
    let covered = grid.across(size.sensor_m);
    let mut sensed = vec![0.0; covered * covered];
    sense(size, known, &mut sensed);
    if sensed.iter().any(|value| value.is_nan()) {
        return Err(Untold);
    }
    let at = size.on_ground(known.own.motion.position);
    let window = grid.window(at, size.sensor_m);
    let [below, left] = grid.outside(at, size.sensor_m);
    for (row, of_ground) in window.rows.clone().enumerate() {
        let new = &sensed[(below + row) * covered + left..][..window.columns.len()];
        let cells = &mut seen[of_ground * grid.cells..][window.columns.clone()];
        cells.iter_mut().zip(new).for_each(|(cell, value)| *cell = value.max(f32::MIN_POSITIVE));
    }
    let window = grid.window(at, size.local_map_m);
    let [below, left] = grid.outside(at, size.local_map_m);
    for (row, of_ground) in window.rows.clone().enumerate() {
        for (column, cell) in seen[of_ground * grid.cells..][window.columns.clone()].iter().enumerate() {
            let importance = if *cell > f32::MIN_POSITIVE { *cell } else { 0.0 };
            write([below + row, left + column], [importance, if *cell > 0.0 { 1.0 } else { 0.0 }, 1.0]);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use murmurate::messages::geometry::Motion;
    use murmurate::observation::{Bound, Observation};

    use super::*;
    use crate::coverage::size::TABLE;

    /// Tasks of a team with goals at these places.
    fn team(goals: &[Vec2]) -> Vec<Option<Task>> {
        goals.iter().map(|goal| Some(Task { start: Vec2::zeros(), goal: *goal })).collect()
    }

    #[test]
    fn a_sensor_covers_the_cells_around_the_robot_and_none_outside_the_ground() {
        let goal = Vec2::new(0.3, -0.2);
        let sensed = |at: Vec2, team: &[Option<Task>]| {
            let (own, task) = (Observation::new(Motion::at_rest(at), goal), Task { start: at, goal });
            let mut values = vec![f32::NAN; 100];
            sense(&TABLE, &Known { task: &task, team, own: &own, sensed: &[] }, &mut values);
            values
        };
        let there = sensed(goal, &team(&[goal]));
        assert!(there[55] > 0.0 && there.iter().all(|value| value.is_finite()));
        assert!(sensed(Vec2::new(-1.0, -1.0), &team(&[goal]))[..50].iter().all(|&value| value == 0.0));
        assert!(sensed(Vec2::new(90.0, -1.0), &team(&[goal])).iter().all(|&value| value == 0.0));
        let untold = [team(&[goal])[0], None];
        assert!(sensed(goal, &untold).iter().all(|value| value.is_nan()));
    }

    #[test]
    fn a_map_has_what_the_robot_has_seen_on_its_way_and_nothing_else() {
        let goal = Vec2::new(0.1, 0.0);
        let (channels, across) = ([density(&TABLE), map(&TABLE)], 30);
        let requests = channels.each_ref().map(Channel::request);
        let bound = Bound::new(&requests, &channels).expect("they are there");
        let mut seen = vec![0.0; bound.memory()];
        let mut map_at = |at: Vec2| {
            let (own, task) = (Observation::new(Motion::at_rest(at), goal), Task { start: at, goal });
            let mut values = vec![f32::NAN; bound.floats()];
            let team = team(&[goal]);
            bound.write(&mut seen, &Known { task: &task, team: &team, own: &own, sensed: &[] }, &mut values);
            let map = values.split_off(100);
            let planes: Vec<Vec<f32>> = map.chunks_exact(across * across).map(<[f32]>::to_vec).collect();
            (values, planes)
        };
        let (sensed, planes) = map_at(goal);
        // The sensor covers the middle 10 x 10 of the 30 x 30 cells.
        for (at, value) in planes[0].iter().enumerate() {
            let [row, column] = [at / across, at % across];
            let inside = (10..20).contains(&row) && (10..20).contains(&column);
            assert_eq!(planes[1][at], if inside { 1.0 } else { 0.0 });
            assert_eq!(*value, if inside { sensed[(row - 10) * 10 + column - 10] } else { 0.0 });
        }
        assert!(planes[2].iter().all(|ground| *ground == 1.0));
        // Four cells along x: what it saw before is four rows lower now, and it sees as much as before.
        let (_, moved) = map_at(goal + Vec2::new(0.2, 0.0));
        assert_eq!(moved[1].iter().sum::<f32>(), 140.0);
        for at in 0..planes[0].len() - 4 * across {
            if planes[1][at + 4 * across] == 1.0 {
                assert_eq!(moved[0][at], planes[0][at + 4 * across], "cell {at}");
            }
        }
        let (_, rim) = map_at(Vec2::new(-1.0, 0.0));
        assert!(rim[2][..15 * across].iter().all(|ground| *ground == 0.0), "half of it is outside the ground");
        assert!(rim[2][15 * across..].iter().all(|ground| *ground == 1.0));
    }

    #[test]
    fn coarse_cells_are_means_of_the_cells_of_the_map() {
        let goal = Vec2::new(0.1, 0.0);
        let channels = [map(&TABLE), coarse_map(&TABLE)];
        let bound = Bound::new(&channels.each_ref().map(Channel::request), &channels).expect("they are there");
        let (own, task) = (Observation::new(Motion::at_rest(goal), goal), Task { start: goal, goal });
        let mut values = vec![f32::NAN; bound.floats()];
        let team = team(&[goal]);
        let known = Known { task: &task, team: &team, own: &own, sensed: &[] };
        bound.write(&mut vec![0.0; bound.memory()], &known, &mut values);
        let coarse = values.split_off(3 * 30 * 30);
        assert_eq!(coarse.len(), 3 * 6 * 6);
        for plane in 0..3 {
            for cell in 0..36 {
                let first = plane * 900 + cell / 6 * 5 * 30 + cell % 6 * 5;
                let sum: f32 = (0..25).map(|at| values[first + at / 5 * 30 + at % 5]).sum();
                let usual = if plane == 0 { TABLE.usual_importance() as f32 } else { 1.0 };
                let difference = (coarse[plane * 36 + cell] - sum / 25.0 / usual).abs();
                assert!(difference < 1e-4, "plane {plane}, cell {cell}: {difference}");
            }
        }
        assert!(coarse[..36].iter().any(|importance| *importance > 0.3), "{coarse:?}");
    }
}
