//! Reception statistics by receiving host and sending robot: time since the newest message arrived, and loss of the
//! last 64; and the links between robots within range, which have them.

use std::collections::BTreeMap;

use super::snapshot::{LinkState, MAX_LINKS};
use murmurate::cells::Cells;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::time::{Span, Time};

/// Reception of one robot's messages at one host: last arrival, and which of the last 64 messages arrived.
#[derive(Clone, Copy, Debug)]
struct Arrivals {
    /// Time of the last arrival.
    last: Time,
    /// Number of messages of the robot that were due at the last arrival.
    number: u64,
    /// Bit mask of the last 64 messages up to `number`, newest in bit 0; a set bit is an arrival.
    bits: u64,
    /// Number of messages that `bits` covers, at most 64.
    covered: u32,
}

/// Reception of all robots' latents at all hosts: time since the newest arrived, and loss.
#[derive(Clone, Debug)]
pub(super) struct Receptions {
    /// Number of messages published by each robot.
    published: Vec<u64>,
    /// For each receiving host: number of messages that each robot has sent to it alone.
    sent: Vec<BTreeMap<RobotId, u64>>,
    /// For each receiving host: the arrivals by sending robot.
    arrivals: Vec<BTreeMap<RobotId, Arrivals>>,
}

impl Receptions {
    /// Returns statistics without any message, for this number of robots and of hosts.
    pub fn new(robots: usize, hosts: usize) -> Receptions {
        let (sent, arrivals) = (vec![BTreeMap::new(); hosts], vec![BTreeMap::new(); hosts]);
        Receptions { published: vec![0; robots], sent, arrivals }
    }

    /// Counts a latent that a robot has published.
    pub fn published(&mut self, robot: RobotId) {
        self.published[robot.index()] += 1;
    }

    /// Counts a message that a robot has sent to the host `to` alone.
    pub fn sent(&mut self, to: HostId, robot: RobotId) {
        if let Some(table) = self.sent.get_mut(usize::from(to.0)) {
            *table.entry(robot).or_default() += 1;
        }
    }

    /// Returns the number of messages of a robot that should have arrived at the host `at`.
    fn due(&self, at: HostId, robot: RobotId) -> u64 {
        let alone = self.sent.get(usize::from(at.0)).and_then(|table| table.get(&robot)).copied().unwrap_or(0);
        self.published[robot.index()] + alone
    }

    /// Counts the arrival of a robot's newest latent at the host `at`.
    pub fn arrived(&mut self, now: Time, at: HostId, robot: RobotId) {
        let number = self.due(at, robot);
        let Some(table) = self.arrivals.get_mut(usize::from(at.0)) else { return };
        let first = Arrivals { last: now, number: number.saturating_sub(1), bits: 0, covered: 0 };
        let entry = table.entry(robot).or_insert(first);
        let passed = (number - entry.number) as u32;
        entry.bits = shifted(entry.bits, passed) | 1;
        entry.covered = (entry.covered + passed).clamp(1, u64::BITS);
        (entry.last, entry.number) = (now, number);
    }

    /// Returns the links between robots within `range_m` \[m\], the shortest [`MAX_LINKS`] of them, and the number of
    /// omitted ones. `known` has the robots whose positions \[m\] are known, and `homes` the host of each robot's
    /// agent.
    pub fn links(&self, now: Time, homes: &[HostId], range_m: f32, known: &[(usize, Vec2)]) -> (Vec<LinkState>, usize) {
        let grid = Cells::new(range_m, known.iter().map(|(_, at)| *at));
        let (mut pairs, mut near) = (Vec::new(), Vec::new());
        for (place, (_, at)) in known.iter().enumerate() {
            match &grid {
                Some(grid) => grid.near(*at, &mut near),
                None => near = (0..known.len()).collect(),
            }
            for &other in near.iter().filter(|other| **other > place) {
                let apart_m = (known[other].1 - *at).norm();
                if apart_m <= range_m {
                    pairs.push((apart_m, place, other));
                }
            }
        }
        let left_out = pairs.len().saturating_sub(MAX_LINKS);
        if left_out > 0 {
            pairs.select_nth_unstable_by(MAX_LINKS, |a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
            pairs.truncate(MAX_LINKS);
        }
        let link = |&(_, one, other): &(f32, usize, usize)| {
            let (one, other) = (known[one].0, known[other].0);
            let way = |from: usize, to: usize| self.link(now, homes[to], RobotId(from as u16));
            let both = [way(one, other), way(other, one)];
            LinkState {
                one: one as u16,
                other: other as u16,
                age: both[0].zip(both[1]).map(|(a, b)| a.0.max(b.0)),
                loss: both.iter().flatten().map(|(_, loss)| *loss).max(),
            }
        };
        (pairs.iter().map(link).collect(), left_out)
    }

    /// Returns the time since a robot's latent last arrived at the host `at`, and the share \[%\] of the robot's last
    /// 64 latents (since the first arrival) that have not arrived there; `None` before the first arrival.
    pub fn link(&self, now: Time, at: HostId, robot: RobotId) -> Option<(Span, u8)> {
        let entry = self.arrivals.get(usize::from(at.0))?.get(&robot)?;
        // The newest message may still be in flight, so it does not count as lost.
        let passed = (self.due(at, robot) - entry.number).saturating_sub(1).min(64) as u32;
        let covered = (entry.covered + passed).min(u64::BITS);
        let got = shifted(entry.bits, passed).count_ones();
        Some((now.since(entry.last), (100 * covered.saturating_sub(got) / covered.max(1)) as u8))
    }
}

fn shifted(bits: u64, by: u32) -> u64 {
    bits.checked_shl(by).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn age_and_loss_follow_from_what_was_published_and_what_arrived() {
        let (mut receptions, host, robot) = (Receptions::new(1, 2), HostId(1), RobotId(0));
        let at = |ms| Time::ZERO + Span::from_millis(ms);
        assert_eq!(receptions.link(at(0), host, robot), None);
        for number in 0..200 {
            receptions.published(robot);
            if number % 4 != 3 {
                receptions.arrived(at(50 * number), host, robot);
            }
        }
        let (age, loss) = receptions.link(at(50 * 199), host, robot).unwrap();
        assert_eq!((age, loss), (Span::from_millis(50), 25), "one in four, and the newest may be on its way");
        (0..500).for_each(|_| receptions.published(robot));
        assert_eq!(receptions.link(at(50 * 199), host, robot).unwrap().1, 100, "all of the last 64");
    }

    #[test]
    fn messages_to_one_host_are_lost_there_alone() {
        let (mut receptions, robot) = (Receptions::new(1, 2), RobotId(0));
        for number in 0..200u64 {
            let now = Time::ZERO + Span::from_millis(50 * number);
            receptions.sent(HostId(1), robot);
            if number % 4 != 3 {
                receptions.arrived(now, HostId(1), robot);
            }
            receptions.sent(HostId(0), robot);
            receptions.arrived(now, HostId(0), robot);
        }
        let now = Time::ZERO + Span::from_millis(50 * 199);
        let loss = [0, 1].map(|host| receptions.link(now, HostId(host), robot).expect("some arrived").1);
        assert_eq!(loss, [0, 25]);
    }
}
