//! Moving obstacles: blocks that move along a path at a constant speed while an episode runs.
//!
//! Where a mover is follows from its path and from the time since the episode runs, and from nothing else. So all who
//! know the task and that time know its place and its velocity, and no message has them.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::block::{KeepOut, Solid};
use crate::messages::geometry::{Motion, Planar, Vec2};
use crate::time::Span;

/// Obstacle that moves along a path, around and around, at a constant speed. It does not turn.
#[derive(Clone, Debug, PartialEq)]
pub struct Mover {
    track: Arc<Track>,
    speed_m_s: f32,
    /// Share of a round after which it begins, 0 to 1.
    phase: f32,
}

/// Body of a mover and its round.
#[derive(Debug, PartialEq)]
struct Track {
    /// Body, where the point that follows the path is the origin \[m\].
    block: KeepOut,
    /// Points of a whole round \[m\], world frame; the last one is the first.
    round: Vec<Vec2>,
    /// Length of a round \[m\].
    length_m: f64,
    /// Ground that the body covers on each leg of the path.
    ways: Vec<KeepOut>,
}

impl Mover {
    /// Returns the mover whose point at the origin of `block` goes along the points of `path` \[m\], world frame, at
    /// `speed_m_s` \[m/s\]: from the last point straight to the first if the path is `closed`, otherwise back the way
    /// that it came. `phase` is the share of a round after which it begins, 0 to 1.
    ///
    /// # Panics
    /// If the path has fewer than two points, or no length.
    pub fn new(block: KeepOut, path: &[Vec2], closed: bool, speed_m_s: f32, phase: f32) -> Mover {
        let back: Vec<Vec2> = if closed { path[..1].to_vec() } else { path.iter().rev().skip(1).copied().collect() };
        let round = [path, &back].concat();
        let length_m = length_m(&round);
        assert!(length_m > 0.0, "a path has a length");
        let legs = if closed { round.len() } else { path.len() };
        let ways = round[..legs].windows(2).map(|leg| block.moved(leg[0]).swept(leg[1] - leg[0])).collect();
        Mover { track: Arc::new(Track { block, round, length_m, ways }), speed_m_s, phase }
    }

    /// Returns the mover that begins after this share of a round, 0 to 1.
    pub fn at_phase(&self, phase: f32) -> Mover {
        Mover { phase, ..self.clone() }
    }

    /// Returns position \[m\] and velocity \[m/s\], world frame, of the point that follows the path, at the time
    /// `elapsed` since the episode runs.
    pub fn motion(&self, elapsed: Span) -> Motion {
        let Track { round, length_m, .. } = &*self.track;
        along((round, *length_m), self.speed_m_s, self.phase, elapsed)
    }

    /// Returns the block that the mover is at the time `elapsed` since the episode runs, world frame.
    pub fn block(&self, elapsed: Span) -> KeepOut {
        self.track.block.moved(self.motion(elapsed).position)
    }

    /// Returns the motion of the middle of the mover, and the radius of a disc about it in which the mover is \[m\], at
    /// the time `elapsed` since the episode runs.
    pub fn disc(&self, elapsed: Span) -> (Motion, f32) {
        let (block, motion) = (&self.track.block, self.motion(elapsed));
        let middle = (block.min + block.max) / 2.0;
        let farthest_m = block.corners().map(|corner| (corner - middle).norm()).fold(0.0, f32::max);
        (Motion { position: motion.position + middle, ..motion }, farthest_m + block.radius_m())
    }

    /// Returns the ground that the mover covers on each leg of its path, world frame.
    pub fn ways(&self) -> &[KeepOut] {
        &self.track.ways
    }

    /// Returns the points of a whole round \[m\], world frame; the last one is the first.
    pub fn round(&self) -> &[Vec2] {
        &self.track.round
    }
}

/// Returns the length of a round \[m\].
fn length_m(round: &[Vec2]) -> f64 {
    round.windows(2).map(|leg| f64::from((leg[1] - leg[0]).norm())).sum()
}

/// Returns position \[m\] and velocity \[m/s\] at the time `elapsed` of a point that goes around a round with its
/// length \[m\] at `speed_m_s` \[m/s\], and began after the share `phase` of it.
fn along((round, length_m): (&[Vec2], f64), speed_m_s: f32, phase: f32, elapsed: Span) -> Motion {
    let gone_m = f64::from(phase) * length_m + f64::from(speed_m_s) * elapsed.as_secs();
    let mut left_m = gone_m.rem_euclid(length_m) as f32;
    for leg in round.windows(2) {
        let (way, leg_m) = (leg[1] - leg[0], (leg[1] - leg[0]).norm());
        if left_m < leg_m {
            return Motion { position: leg[0] + way * (left_m / leg_m), velocity: way * (speed_m_s / leg_m) };
        }
        left_m -= leg_m;
    }
    // Only rounding leads here: the round is over, and the next one begins.
    let way = round[1] - round[0];
    Motion { position: round[0], velocity: way * (speed_m_s / way.norm()) }
}

/// Mover of a run as plain data, for pages and records that show the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DrawnMover {
    /// Body, where the point that follows the path is the origin \[m\].
    pub body: Solid,
    /// Points of a whole round \[m\], world frame; the last one is the first.
    pub round: Vec<[f32; 2]>,
    /// Speed along the path \[m/s\].
    pub speed_m_s: f32,
    /// Share of a round after which it begins, 0 to 1, in each episode; a single one is that of all episodes.
    pub phases: Vec<f32>,
}

impl DrawnMover {
    /// Returns the movers of a run. `episodes` has those of each episode; it is empty if all episodes have `movers`.
    pub fn of_run<'a>(movers: &[Mover], episodes: impl Iterator<Item = &'a [Mover]> + Clone) -> Vec<DrawnMover> {
        let drawn = |(at, mover): (usize, &Mover)| {
            let phases: Vec<f32> = episodes.clone().map(|movers| movers[at].phase).collect();
            DrawnMover {
                body: mover.track.block.solid(),
                round: mover.round().iter().map(Planar::to_array).collect(),
                speed_m_s: mover.speed_m_s,
                phases: if phases.is_empty() { vec![mover.phase] } else { phases },
            }
        };
        movers.iter().enumerate().map(drawn).collect()
    }

    /// Returns where the point that follows the path is \[m\], world frame, in the episode with this index, at the time
    /// `elapsed` since it runs; `None` if the data are not those of a mover, as in a foreign record.
    pub fn place(&self, episode: u32, elapsed: Span) -> Option<Vec2> {
        let round: Vec<Vec2> = self.round.iter().copied().map(Vec2::from).collect();
        let phase = self.phases.get(episode as usize).or(self.phases.last())?;
        let length_m = length_m(&round);
        (length_m > 0.0).then(|| along((&round, length_m), self.speed_m_s, *phase, elapsed).position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cart(path: &[[f32; 2]], closed: bool) -> Mover {
        let block = KeepOut::rect(Vec2::new(-0.2, -0.1), Vec2::new(0.2, 0.1));
        let path: Vec<Vec2> = path.iter().map(|point| Vec2::from(*point)).collect();
        Mover::new(block, &path, closed, 0.5, 0.0)
    }

    #[test]
    fn it_goes_back_and_forth_or_around_and_comes_back_after_each_round() {
        let corner = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]];
        let (there, around) = (cart(&corner, false), cart(&corner, true));
        let at = |mover: &Mover, s: f64| mover.motion(Span::from_secs(s));
        assert_eq!(at(&there, 1.0), Motion { position: Vec2::new(0.5, 0.0), velocity: Vec2::new(0.5, 0.0) });
        assert_eq!(at(&there, 5.0), Motion { position: Vec2::new(2.0, 0.5), velocity: Vec2::new(0.0, 0.5) });
        assert_eq!(at(&there, 7.0).velocity, Vec2::new(0.0, -0.5), "it comes back the same way");
        assert!((at(&there, 3612.0 + 1.0).position - at(&there, 1.0).position).norm() < 1e-3, "301 rounds of 12 s");
        let round_s = 2.0 * (3.0 + 5.0_f64.sqrt());
        assert!((at(&around, round_s + 1.0).position - Vec2::new(0.5, 0.0)).norm() < 1e-5);
        assert!(at(&around, round_s - 1.0).velocity.x < 0.0, "from the last point straight to the first");
        assert_eq!(at(&there.at_phase(0.25), 0.0).position, Vec2::new(1.5, 0.0));
    }

    #[test]
    fn it_is_always_on_its_ways_and_within_its_disc() {
        let triangle = [[0.0, 0.0], [0.4, 0.1], [0.0, 0.5]].map(Vec2::from).to_vec();
        let blocks = [KeepOut::disc(Vec2::zeros(), 0.3), KeepOut::polygon(triangle)];
        for (block, closed) in blocks.into_iter().flat_map(|block| [(block.clone(), false), (block, true)]) {
            let path = [[-1.0, 0.0], [1.0, 0.5], [0.0, 2.0]].map(Vec2::from);
            let mover = Mover::new(block, &path, closed, 0.7, 0.4);
            for step in 0..400 {
                let elapsed = Span::from_millis(50) * step;
                let (body, (middle, radius_m)) = (mover.block(elapsed), mover.disc(elapsed));
                for corner in body.corners() {
                    let off_m = mover.ways().iter().map(|way| way.distance(corner)).fold(f32::INFINITY, f32::min);
                    assert!(off_m < 1e-5, "{off_m} m beside its ways");
                    assert!((corner - middle.position).norm() + body.radius_m() < radius_m + 1e-5);
                }
            }
        }
    }

    #[test]
    fn as_plain_data_it_is_where_the_mover_of_the_episode_is() {
        let first = cart(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]], true);
        let episodes = [vec![first.at_phase(0.25)], vec![first.at_phase(0.7)]];
        let drawn = DrawnMover::of_run(&episodes[0], episodes.iter().map(Vec::as_slice));
        let text = serde_json::to_string(&drawn).expect("it is JSON");
        let drawn: Vec<DrawnMover> = serde_json::from_str(&text).expect("it is what was written");
        for (episode, s) in [(0, 0.0), (0, 3.3), (1, 3.3), (1, 40.0)] {
            let elapsed = Span::from_secs(s);
            let place = drawn[0].place(episode, elapsed).expect("it has a path");
            assert_eq!(place, episodes[episode as usize][0].motion(elapsed).position, "episode {episode}, {s} s");
        }
        let fixed = DrawnMover::of_run(&episodes[0], std::iter::empty());
        assert_eq!(fixed[0].place(7, Span::ZERO), drawn[0].place(0, Span::ZERO), "all episodes have the same");
        assert_eq!(DrawnMover { round: Vec::new(), ..drawn[0].clone() }.place(0, Span::ZERO), None);
    }
}
