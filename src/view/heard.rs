//! Table of robots' messages by receiving host: age of the newest, and share of the last 64 that did not arrive.

use std::collections::BTreeMap;

use crate::messages::ids::{HostId, RobotId};
use crate::time::{Span, Time};

/// Messages of one robot as they arrive at one host.
#[derive(Clone, Copy, Debug)]
struct Arrivals {
    /// Time of the last arrival.
    last: Time,
    /// Number of the sender's messages up to the last arrival.
    number: u64,
    /// The sender's newest 64 messages up to `number`: a bit is set for each arrival.
    bits: u64,
    /// Number of messages that `bits` covers.
    covered: u32,
}

/// Arrivals of all robots' messages at all hosts.
#[derive(Clone, Debug)]
pub(super) struct Heard {
    /// Number of messages that each robot has published.
    published: Vec<u64>,
    /// By host and sending robot.
    arrivals: Vec<BTreeMap<RobotId, Arrivals>>,
}

impl Heard {
    /// Makes an empty table.
    pub fn new(robots: usize, hosts: usize) -> Heard {
        Heard { published: vec![0; robots], arrivals: vec![BTreeMap::new(); hosts] }
    }

    /// Notes that a robot has published a message.
    pub fn published(&mut self, robot: RobotId) {
        self.published[robot.index()] += 1;
    }

    /// Notes that a message of a robot has arrived at a host.
    pub fn arrived(&mut self, now: Time, at: HostId, robot: RobotId) {
        let number = self.published[robot.index()];
        let Some(table) = self.arrivals.get_mut(usize::from(at.0)) else { return };
        let first = Arrivals { last: now, number: number.saturating_sub(1), bits: 0, covered: 0 };
        let entry = table.entry(robot).or_insert(first);
        let passed = (number - entry.number) as u32;
        entry.bits = shifted(entry.bits, passed) | 1;
        entry.covered = (entry.covered + passed).clamp(1, u64::BITS);
        (entry.last, entry.number) = (now, number);
    }

    /// Returns the age of a robot's newest message at a host, and the share of messages lost \[%\]; `None` if none has
    /// arrived.
    pub fn link(&self, now: Time, at: HostId, robot: RobotId) -> Option<(Span, u8)> {
        let entry = self.arrivals.get(usize::from(at.0))?.get(&robot)?;
        // The newest message may still be on its way.
        let passed = (self.published[robot.index()] - entry.number).saturating_sub(1).min(64) as u32;
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
        let (mut heard, host, robot) = (Heard::new(1, 2), HostId(1), RobotId(0));
        let at = |ms| Time::ZERO + Span::from_millis(ms);
        assert_eq!(heard.link(at(0), host, robot), None);
        for number in 0..200 {
            heard.published(robot);
            if number % 4 != 3 {
                heard.arrived(at(50 * number), host, robot);
            }
        }
        let (age, loss) = heard.link(at(50 * 199), host, robot).unwrap();
        assert_eq!((age, loss), (Span::from_millis(50), 25), "one in four, and the newest may be on its way");
        (0..500).for_each(|_| heard.published(robot));
        assert_eq!(heard.link(at(50 * 199), host, robot).unwrap().1, 100, "all of the last 64");
    }
}
