//! What robots have heard of each other in a run, as far as one who sees all of them can tell.

use std::collections::{BTreeMap, VecDeque};

use serde::{Deserialize, Serialize};

use super::ages::Ages;
use crate::messages::ids::{HostId, RobotId};
use crate::time::{Span, Time};

/// Messages between robots on their links, and what the Caches made of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listening {
    /// Arrivals that there would be if nothing was lost: every message at every other host with an agent.
    pub due: u64,
    /// Those that there were; a copy of what is there already is none.
    pub arrived: u64,
    /// From publication to arrival, over the arrivals.
    pub delay: Ages,
    /// Control steps of robots that hear others over a link.
    pub steps: u64,
    /// Messages of others that those steps had: within range, and not yet dropped or too old.
    pub heard: u64,
    /// From publication to the control step that had it, over the messages heard.
    pub age: Ages,
}

impl Listening {
    /// Adds what was heard in another run.
    pub fn merge(&mut self, other: &Listening) {
        self.due += other.due;
        self.arrived += other.arrived;
        self.steps += other.steps;
        self.heard += other.heard;
        self.delay.merge(&other.delay);
        self.age.merge(&other.age);
    }

    /// The share of messages that arrived; `None` if none had to cross a link.
    pub fn delivered(&self) -> Option<f64> {
        (self.due > 0).then(|| self.arrived as f64 / self.due as f64)
    }

    /// How many neighbours a control step had a message of, on average.
    pub fn neighbours(&self) -> Option<f64> {
        (self.steps > 0).then(|| self.heard as f64 / self.steps as f64)
    }
}

/// Robots publish far more often than this; what is older than the last so many messages of one robot is forgotten.
const KEPT: usize = 64;

/// Which datagram a message left in: its sender, incarnation and number, and whether it was for one host.
pub type Datagram = (HostId, u32, u32, bool);

/// Follows messages between robots from publication to arrival and on to the control steps that have them. It sees
/// what no host can: clocks of two hosts are one clock here.
#[derive(Clone, Debug)]
pub struct Listener {
    listening: Listening,
    /// At how many hosts a message of a robot is due.
    hosts: u64,
    /// By sending host: the last datagrams, whose they were, and when they were published.
    sent: BTreeMap<HostId, VecDeque<(Datagram, RobotId, Time)>>,
    /// By receiving host and sending robot: when the last messages arrived, and when they were published.
    had: BTreeMap<(HostId, RobotId), VecDeque<(Time, Time)>>,
}

impl Listener {
    /// A listener to a team whose messages are due at so many other hosts.
    pub fn new(hosts: u64) -> Listener {
        Listener { listening: Listening::default(), hosts, sent: BTreeMap::new(), had: BTreeMap::new() }
    }

    /// What it has found.
    pub fn listening(&self) -> Listening {
        self.listening
    }

    /// A robot has published a message.
    pub fn published(&mut self, now: Time, datagram: Datagram, robot: RobotId) {
        self.listening.due += self.hosts;
        keep(self.sent.entry(datagram.0).or_default(), (datagram, robot, now));
    }

    /// A datagram has arrived at a host.
    pub fn arrived(&mut self, now: Time, to: HostId, datagram: Datagram) {
        let sent = self.sent.get(&datagram.0).into_iter().flatten();
        let Some((_, robot, published)) = sent.rev().find(|(other, ..)| *other == datagram) else { return };
        let had = self.had.entry((to, *robot)).or_default();
        // A robot says one thing at a time: what was published at the same instant is a copy.
        if had.iter().any(|(_, other)| other == published) {
            return;
        }
        keep(had, (now, *published));
        self.listening.arrived += 1;
        self.listening.delay.add(now.since(*published));
    }

    /// A robot at a host has taken a control step on messages of these ages since their arrival; their ages since
    /// publication, which are the same for those that crossed no link.
    pub fn stepped(&mut self, now: Time, at: HostId, heard: &[(RobotId, Span)]) -> Vec<(RobotId, Span)> {
        let mut ages = heard.to_vec();
        if self.hosts == 0 {
            return ages;
        }
        self.listening.steps += 1;
        for (robot, age) in &mut ages {
            let had = self.had.get(&(at, *robot)).into_iter().flatten().rev();
            if let Some((_, published)) = had.clone().find(|(arrived, _)| now.since(*arrived) == *age) {
                *age = now.since(*published);
                self.listening.heard += 1;
                self.listening.age.add(*age);
            }
        }
        ages
    }
}

fn keep<T>(last: &mut VecDeque<T>, next: T) {
    if last.len() == KEPT {
        last.pop_front();
    }
    last.push_back(next);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_followed_from_its_sender_to_the_step_that_uses_it() {
        let at = |ms| Time::ZERO + Span::from_millis(ms);
        let mut listener = Listener::new(2);
        let datagram = (HostId(0), 1, 7, false);
        listener.published(at(100), datagram, RobotId(0));
        listener.arrived(at(120), HostId(1), datagram);
        listener.arrived(at(130), HostId(1), datagram);
        listener.arrived(at(130), HostId(1), (HostId(0), 1, 8, false));
        let heard = [(RobotId(0), Span::from_millis(30)), (RobotId(3), Span::from_millis(10))];
        let ages = listener.stepped(at(150), HostId(1), &heard);
        assert_eq!(ages, [(RobotId(0), Span::from_millis(50)), (RobotId(3), Span::from_millis(10))]);
        listener.stepped(at(200), HostId(2), &[]);
        let found = listener.listening();
        assert_eq!((found.due, found.arrived, found.delivered()), (2, 1, Some(0.5)));
        assert_eq!((found.steps, found.heard, found.neighbours()), (2, 1, Some(0.5)));
        assert_eq!(found.delay.share_within(Span::from_millis(20)), Some(1.0));
        assert_eq!(found.age.quantile_s(1.0), Some(0.05));
    }
}
