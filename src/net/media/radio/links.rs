//! Links of a radio channel with space: which stations a transmission reaches, and with which power.

use serde::{Deserialize, Serialize};

use super::Radio;
use super::powers::{Powers, milliwatts};
use crate::cells::{Cells, LINEAR_SEARCH_MAX};
use crate::messages::geometry::Vec2;
use crate::random::Stream;

/// Power of frames at all receivers on a channel without powers \[mW\].
pub(super) const EQUAL_POWER: f64 = 1.0;

/// Station that a transmission reaches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Hearer {
    /// Index of the station.
    pub station: u16,
    /// Power of the frame at the station \[mW\]; 0 if it is sensed alone. On a channel without powers all are equal.
    pub power: f64,
    /// Whether the station senses the frame, and so waits for its end.
    pub sensed: bool,
}

/// Path to a station that a transmission may reach.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Link {
    /// The station, with what reaches it if the powers of all frames are the same.
    hearer: Hearer,
    /// Power of the path \[dBm\].
    path_dbm: f64,
    /// Probability that shadowing makes a frame matter.
    chance: f64,
}

/// Links between the stations of a channel, by their positions.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Links {
    /// Stations that each station reaches, in the order of their indices; `None` where they are to be found out anew.
    of: Vec<Option<Vec<Link>>>,
    /// Corners of the outline of each wall \[m\].
    walls: Vec<Vec<[f32; 2]>>,
    /// Located stations in a grid, as far as a transmission reaches; `None` if it is to be made anew.
    #[serde(skip)]
    grid: Option<Grid>,
}

/// Located stations in a grid, and those without a position.
#[derive(Clone, Debug)]
struct Grid {
    cells: Option<Cells>,
    located: Vec<u16>,
    unlocated: Vec<u16>,
}

impl Links {
    /// Returns the links of `stations` stations.
    pub fn new(stations: usize) -> Links {
        Links { of: vec![None; stations], ..Links::default() }
    }

    /// Forgets all links, since stations have moved.
    pub fn moved(&mut self) {
        self.of.iter_mut().for_each(|links| *links = None);
        self.grid = None;
    }

    /// Sets the walls, as the corners of their outlines \[m\].
    pub fn wall_in(&mut self, walls: Vec<Vec<[f32; 2]>>) {
        self.walls = walls;
        self.moved();
    }

    /// Appends the stations that a transmission of the station `from` reaches, itself among them, in the order of their
    /// indices, with the power of this one frame at each. `positions` has an entry for each station.
    pub fn hearers(
        &mut self,
        radio: &Radio,
        positions: &[Option<Vec2>],
        from: u16,
        stream: &mut Stream,
        to: &mut Vec<Hearer>,
    ) {
        if self.of[usize::from(from)].is_none() {
            let mut grid = self.grid.take();
            self.of[usize::from(from)] = Some(self.found(radio, positions, from, &mut grid));
            self.grid = grid;
        }
        let links = self.of[usize::from(from)].as_deref().unwrap_or_default();
        match radio.powers.as_ref().filter(|powers| powers.varies()) {
            None => to.extend(links.iter().map(|link| link.hearer)),
            Some(powers) => to.extend(links.iter().filter_map(|link| {
                if link.hearer.station == from {
                    return Some(link.hearer);
                }
                let dbm = powers.of_frame(link.path_dbm, link.chance, stream)?;
                of_power(powers, link.hearer.station, dbm)
            })),
        }
    }

    /// Returns the stations that a transmission of the station `from` reaches, itself among them, without shadowing and
    /// fading.
    pub fn paths(&self, radio: &Radio, positions: &[Option<Vec2>], from: u16) -> Vec<Hearer> {
        let found = self.found(radio, positions, from, &mut None);
        let hearer = |link: Link| match &radio.powers {
            Some(powers) if link.hearer.station != from => of_power(powers, link.hearer.station, link.path_dbm),
            _ => Some(link.hearer),
        };
        found.into_iter().filter_map(hearer).collect()
    }

    /// Returns the stations that the station `from` reaches, by the grid, which is made if it is missing.
    fn found(&self, radio: &Radio, positions: &[Option<Vec2>], from: u16, grid: &mut Option<Grid>) -> Vec<Link> {
        let place = |station: u16| positions[usize::from(station)];
        let link = |station: u16| {
            let same = |hearer: Hearer| Link { hearer, path_dbm: 0.0, chance: 1.0 };
            if station == from {
                return Some(same(Hearer { station, power: 0.0, sensed: true }));
            }
            let ends = place(from).zip(place(station));
            match &radio.powers {
                None => disc(radio, station, ends).map(same),
                Some(powers) => {
                    let path_dbm = ends.map_or(powers.of_path(0.0, 0), |(from, to)| {
                        powers.of_path(f64::from((to - from).norm()), self.crossed(powers, from, to))
                    });
                    let hearer = if powers.varies() {
                        Some(Hearer { station, power: 0.0, sensed: false })
                            .filter(|_| path_dbm >= powers.least_path_dbm())
                    } else {
                        of_power(powers, station, path_dbm)
                    };
                    let chance = powers.chance(path_dbm);
                    hearer.map(|hearer| Link { hearer, path_dbm, chance })
                }
            }
        };
        let all = 0..positions.len() as u16;
        let reach_m = reach_m(radio);
        let (Some(at), true) = (place(from), positions.len() > LINEAR_SEARCH_MAX && reach_m.is_finite()) else {
            return all.filter_map(link).collect();
        };
        let grid = grid.get_or_insert_with(|| Grid::new(reach_m, positions));
        let mut near = Vec::new();
        if let Some(cells) = &grid.cells {
            cells.near(at, &mut near);
        }
        let mut stations: Vec<u16> = near.into_iter().map(|index| grid.located[index]).collect();
        stations.extend_from_slice(&grid.unlocated);
        stations.sort_unstable();
        stations.into_iter().filter_map(link).collect()
    }

    /// Returns how many walls a straight path crosses, if they weaken it.
    fn crossed(&self, powers: &Powers, from: Vec2, to: Vec2) -> usize {
        if powers.wall_db == 0.0 {
            return 0;
        }
        let side = |wall: &[[f32; 2]], at: usize| [wall[at], wall[(at + 1) % wall.len()]].map(Vec2::from);
        let meets = |wall: &[[f32; 2]]| (0..wall.len()).any(|at| crosses([from, to], side(wall, at)));
        self.walls.iter().filter(|wall| meets(wall)).count()
    }
}

impl Grid {
    fn new(reach_m: f32, positions: &[Option<Vec2>]) -> Grid {
        let indexed = || (0..).zip(positions);
        Grid {
            cells: Cells::new(reach_m, positions.iter().flatten().copied()),
            located: indexed().filter(|(_, at)| at.is_some()).map(|(station, _)| station).collect(),
            unlocated: indexed().filter(|(_, at)| at.is_none()).map(|(station, _)| station).collect(),
        }
    }
}

/// Returns the distance beyond which a transmission does nothing \[m\].
fn reach_m(radio: &Radio) -> f32 {
    match &radio.powers {
        Some(powers) => powers.reach_m() as f32,
        None => radio.sense_m.unwrap_or(f32::INFINITY),
    }
}

/// Returns the station `station` as a hearer between the ends of a path, by the distances up to which frames are read
/// and sensed. Without ends, it reads all.
fn disc(radio: &Radio, station: u16, ends: Option<(Vec2, Vec2)>) -> Option<Hearer> {
    let within = |limit: Option<f32>| match (limit, ends) {
        (Some(limit), Some((from, to))) => (to - from).norm_squared() <= limit * limit,
        _ => true,
    };
    let sensed = within(radio.sense_m);
    let read = sensed && within(radio.range_m);
    sensed.then_some(Hearer { station, power: if read { EQUAL_POWER } else { 0.0 }, sensed })
}

/// Returns the station `station` as a hearer of a frame with this power, if it matters.
fn of_power(powers: &Powers, station: u16, dbm: f64) -> Option<Hearer> {
    let hearer = Hearer { station, power: milliwatts(dbm), sensed: dbm >= powers.sense_dbm };
    Some(hearer).filter(|_| dbm >= powers.floor_dbm())
}

/// Returns whether two segments, each given by its ends, cross each other.
fn crosses([a, b]: [Vec2; 2], [c, d]: [Vec2; 2]) -> bool {
    let side = |p: Vec2, q: Vec2, r: Vec2| (q - p).perp(&(r - p));
    side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::media::radio::Topology;
    use crate::random::Seed;

    fn reached(radio: &Radio, positions: &[Option<Vec2>], from: u16, walls: &[[[f32; 2]; 2]]) -> Vec<Hearer> {
        let mut links = Links::new(positions.len());
        links.wall_in(walls.iter().map(|ends| ends.to_vec()).collect());
        let mut all = Vec::new();
        links.hearers(radio, positions, from, &mut Seed::of_run(1).stream("fading"), &mut all);
        all
    }

    fn line(stations: u16, gap_m: f32) -> Vec<Option<Vec2>> {
        (0..stations).map(|station| Some(Vec2::new(f32::from(station) * gap_m, 0.0))).collect()
    }

    #[test]
    fn a_station_senses_farther_than_it_reads() {
        let radio = Radio { channel: Topology::AdHoc, range_m: Some(30.0), sense_m: Some(55.0), ..Radio::default() };
        let mut positions = line(4, 25.0);
        positions.push(None);
        let all = reached(&radio, &positions, 0, &[]);
        let told: Vec<(u16, bool)> = all.iter().map(|hearer| (hearer.station, hearer.power > 0.0)).collect();
        assert_eq!(told, [(0, false), (1, true), (2, false), (4, true)], "who has no place reads all");
    }

    #[test]
    fn a_grid_finds_those_whom_a_search_through_all_finds() {
        let radio = Radio { channel: Topology::AdHoc, powers: Some(Powers::default()), ..Radio::default() };
        let positions = line(200, 9.0);
        let near = reached(&radio, &positions, 100, &[]);
        let reach_m = radio.powers.as_ref().map_or(0.0, Powers::reach_m);
        let expected: Vec<u16> =
            (0..200).filter(|&station| f64::from(station).mul_add(9.0, -900.0).abs() <= reach_m).collect();
        assert_eq!(near.iter().map(|hearer| hearer.station).collect::<Vec<_>>(), expected);
        assert!(expected.len() > 20 && expected.len() < 100, "{}", expected.len());
    }

    #[test]
    fn a_wall_weakens_what_crosses_it() {
        let powers = Powers { wall_db: 20.0, ..Powers::default() };
        let radio = Radio { channel: Topology::AdHoc, powers: Some(powers), ..Radio::default() };
        let positions = line(3, 10.0);
        let wall = [[15.0, -1.0], [15.0, 1.0]];
        let (free, walled) = (reached(&radio, &positions, 0, &[]), reached(&radio, &positions, 0, &[wall]));
        assert!((free[1].power - walled[1].power).abs() < 1e-15);
        assert!((free[2].power / walled[2].power - 100.0).abs() < 1e-6);
    }
}
