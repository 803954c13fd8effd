//! Listener: follows messages between robots from publication to arrival and to their use, for the Recorder.

use std::collections::{BTreeMap, VecDeque};

use crate::messages::ids::{HostId, RobotId};
use crate::results::listening::Listening;
use crate::time::{Span, Time};

/// Number of messages that are kept in each queue.
const KEPT: usize = 64;

/// Identity of a datagram: its sender, the sender's incarnation, its sequence number, and whether it is unicast.
pub(crate) type Datagram = (HostId, u32, u32, bool);

/// Observer that follows messages between robots from publication to arrival, and to the control steps that use them.
/// It needs one clock for all hosts, as a simulation has.
#[derive(Clone, Debug)]
pub(crate) struct Listener {
    listening: Listening,
    /// Number of other hosts at which each message is expected.
    hosts: u64,
    /// For each sending host: its last datagrams, with robot and time of publication.
    sent: BTreeMap<HostId, VecDeque<(Datagram, RobotId, Time)>>,
    /// For each receiving host and sending robot: arrival and publication times of the last messages.
    had: BTreeMap<(HostId, RobotId), VecDeque<(Time, Time)>>,
}

impl Listener {
    /// Returns an observer of a team in which each message is expected at `hosts` other hosts.
    pub(crate) fn new(hosts: u64) -> Listener {
        Listener { listening: Listening::default(), hosts, sent: BTreeMap::new(), had: BTreeMap::new() }
    }

    /// Returns the statistics of all messages so far.
    pub(crate) fn listening(&self) -> Listening {
        self.listening
    }

    /// Records that `robot` has published a message at `now`, in the datagram `datagram`.
    pub(crate) fn published(&mut self, now: Time, datagram: Datagram, robot: RobotId) {
        self.listening.due += self.hosts;
        keep(self.sent.entry(datagram.0).or_default(), (datagram, robot, now));
    }

    /// Records that a datagram has arrived at the host `to` at `now`. Duplicates do not count, nor does a datagram that
    /// is not among the last 64 of its sender that the method `published` has recorded.
    pub(crate) fn arrived(&mut self, now: Time, to: HostId, datagram: Datagram) {
        let sent = self.sent.get(&datagram.0).into_iter().flatten();
        let Some((_, robot, published)) = sent.rev().find(|(other, ..)| *other == datagram) else { return };
        let had = self.had.entry((to, *robot)).or_default();
        // A robot publishes at most one message at a time, so an equal publication time marks a duplicate.
        if had.iter().any(|(_, other)| other == published) {
            return;
        }
        keep(had, (now, *published));
        self.listening.arrived += 1;
        self.listening.delay.add(now.since(*published));
    }

    /// Records a control step of a robot at the host `at`. `heard` has the robots whose messages it used, with the
    /// messages' ages since arrival. Returns these robots with ages since publication; for a message that crossed no
    /// link the age stays as it is.
    pub(crate) fn stepped(&mut self, now: Time, at: HostId, heard: &[(RobotId, Span)]) -> Vec<(RobotId, Span)> {
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
