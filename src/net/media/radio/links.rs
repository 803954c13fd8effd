//! Links of a radio channel with space: which stations a transmission reaches, and with which power.

use serde::{Deserialize, Serialize};

use super::Radio;
use super::powers::{Powers, Scale};
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
    /// Power of the path \[mW\].
    path: f64,
    /// Probability that shadowing makes a frame matter.
    chance: f64,
}

/// Links between the stations of a channel, by their positions.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Links {
    /// Stations that each station reaches, in the order of their indices.
    of: Vec<Vec<Link>>,
    /// Whether they are those of now, by station.
    known: Vec<bool>,
    /// Powers of the channel; `None` if all are equal.
    scale: Option<Scale>,
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
    /// Returns the links of `stations` stations on a channel with these parameters.
    pub fn new(radio: &Radio, stations: usize) -> Links {
        let scale = radio.powers.as_ref().map(Scale::of);
        Links { of: vec![Vec::new(); stations], known: vec![false; stations], scale, ..Links::default() }
    }

    /// Forgets all links, since stations have moved.
    pub fn moved(&mut self) {
        self.known.fill(false);
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
        if self.scale.is_none() && positions.len() <= LINEAR_SEARCH_MAX {
            // Distances are compared as fast as what was found before is read.
            let at = positions[usize::from(from)];
            let all = (0..).zip(positions);
            return to.extend(all.filter_map(|(station, other)| of_distance(radio, (from, station), at.zip(*other))));
        }
        let at = usize::from(from);
        if !std::mem::replace(&mut self.known[at], true) {
            let (mut grid, mut links) = (self.grid.take(), std::mem::take(&mut self.of[at]));
            links.clear();
            self.find(radio, positions, from, &mut grid, &mut links);
            (self.grid, self.of[at]) = (grid, links);
        }
        let links = &self.of[at];
        let varies = radio.powers.as_ref().is_some_and(Powers::varies);
        match self.scale.filter(|_| varies) {
            None => to.extend(links.iter().map(|link| link.hearer)),
            Some(scale) => to.extend(links.iter().filter_map(|link| {
                if link.hearer.station == from {
                    return Some(link.hearer);
                }
                let power = scale.of_frame(link.path, link.chance, stream)?;
                of_power(scale, link.hearer.station, power)
            })),
        }
    }

    /// Returns the least power \[mW\] of the frames between stations that are at most so far apart; `None` if some of
    /// them may not be sensed, or if each frame has a power of its own.
    pub fn least_power(&self, radio: &Radio, squared_m2: f32) -> Option<f64> {
        let (Some(powers), Some(scale)) = (&radio.powers, self.scale) else {
            let mut limits = [radio.range_m, radio.sense_m].into_iter().flatten();
            return limits.all(|limit| squared_m2 <= limit * limit).then_some(EQUAL_POWER);
        };
        let fixed = !powers.varies() && (powers.wall_db == 0.0 || self.walls.is_empty());
        let power = scale.of_path(f64::from(squared_m2), 0);
        (fixed && scale.is_sensed(power) && scale.matters(power)).then_some(power)
    }

    /// Returns the stations that a transmission of the station `from` reaches, itself among them, without shadowing and
    /// fading.
    pub fn paths(&self, radio: &Radio, positions: &[Option<Vec2>], from: u16) -> Vec<Hearer> {
        let mut found = Vec::new();
        // What was found for others may be of earlier positions.
        let known = vec![false; positions.len()];
        let fresh = Links { known, scale: self.scale, walls: self.walls.clone(), ..Links::default() };
        fresh.find(radio, positions, from, &mut None, &mut found);
        let hearer = |link: Link| match self.scale {
            Some(scale) if link.hearer.station != from => of_power(scale, link.hearer.station, link.path),
            _ => Some(link.hearer),
        };
        found.into_iter().filter_map(hearer).collect()
    }

    /// Appends the stations that the station `from` reaches to `found`, by the grid, which is made if it is missing.
    fn find(
        &self,
        radio: &Radio,
        positions: &[Option<Vec2>],
        from: u16,
        grid: &mut Option<Grid>,
        found: &mut Vec<Link>,
    ) {
        let all = 0..positions.len() as u16;
        if positions.len() <= LINEAR_SEARCH_MAX {
            return all.for_each(|station| self.add(radio, positions, (from, station), found));
        }
        let reach_m = reach_m(radio);
        let Some(at) = positions[usize::from(from)].filter(|_| reach_m.is_finite()) else {
            return all.for_each(|station| self.add(radio, positions, (from, station), found));
        };
        let grid = grid.get_or_insert_with(|| Grid::new(reach_m, positions));
        let mut near = Vec::new();
        if let Some(cells) = &grid.cells {
            cells.near(at, &mut near);
        }
        let mut stations: Vec<u16> = near.into_iter().map(|index| grid.located[index]).collect();
        stations.extend_from_slice(&grid.unlocated);
        stations.sort_unstable();
        stations.into_iter().for_each(|station| self.add(radio, positions, (from, station), found));
    }

    /// Appends the link between two stations to `found`, if there is one.
    fn add(&self, radio: &Radio, positions: &[Option<Vec2>], (from, station): (u16, u16), found: &mut Vec<Link>) {
        if station == from {
            let hearer = Hearer { station, power: 0.0, sensed: true };
            return found.push(Link { hearer, path: 0.0, chance: 1.0 });
        }
        let ends = positions[usize::from(from)].zip(positions[usize::from(station)]);
        let (Some(powers), Some(scale)) = (&radio.powers, self.scale) else {
            let hearer = of_distance(radio, (from, station), ends);
            return found.extend(hearer.map(|hearer| Link { hearer, path: 0.0, chance: 1.0 }));
        };
        if self.known[usize::from(station)] {
            // A path is the same both ways.
            let back = &self.of[usize::from(station)];
            let link = back.binary_search_by_key(&from, |link| link.hearer.station).ok().map(|at| back[at]);
            let turned = |link: Link| Link { hearer: Hearer { station, ..link.hearer }, ..link };
            return found.extend(link.map(turned));
        }
        let path = ends.map_or(scale.of_path(0.0, 0), |(one, other)| {
            // In one order, so that both ways round alike.
            let (one, other) = if from < station { (one, other) } else { (other, one) };
            scale.of_path(f64::from((other - one).norm_squared()), self.crossed(powers, one, other))
        });
        let hearer = if powers.varies() {
            Some(Hearer { station, power: 0.0, sensed: false }).filter(|_| path >= scale.least_path)
        } else {
            of_power(scale, station, path)
        };
        found.extend(hearer.map(|hearer| Link { hearer, path, chance: scale.chance(path) }));
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

/// Returns a station as a hearer of a frame of the station `from`, if it senses the frame, on a channel without powers.
/// `ends` are the positions of both, if both have one.
fn of_distance(radio: &Radio, (from, station): (u16, u16), ends: Option<(Vec2, Vec2)>) -> Option<Hearer> {
    if station == from {
        return Some(Hearer { station, power: 0.0, sensed: true });
    }
    let squared = ends.map_or(0.0, |(from, to)| (to - from).norm_squared());
    let within = |limit: Option<f32>| limit.is_none_or(|limit| squared <= limit * limit);
    let power = if within(radio.range_m) { EQUAL_POWER } else { 0.0 };
    within(radio.sense_m).then_some(Hearer { station, power, sensed: true })
}

/// Returns the station `station` as a hearer of a frame with this power \[mW\], if it matters.
fn of_power(scale: Scale, station: u16, power: f64) -> Option<Hearer> {
    let hearer = Hearer { station, power, sensed: scale.is_sensed(power) };
    Some(hearer).filter(|_| scale.matters(power))
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
        let mut links = Links::new(radio, positions.len());
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
