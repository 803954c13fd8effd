//! Messages in parts that a host sends: when each part leaves, and which it sends again.

use std::collections::{BTreeMap, VecDeque};

use super::{Lacking, Settings, numbers};
use crate::messages::ids::RobotId;
use crate::messages::wire::{Latent, Part};
use crate::time::{Span, Time};

/// Largest number of times that a part is sent again, so that a host that asks for ever does not fill the channel.
const AGAIN: u8 = 8;

/// The newest message in parts of each robot of a host.
#[derive(Clone, Debug, Default)]
pub struct Outbox {
    streams: BTreeMap<RobotId, Stream>,
    /// Time at which the next part leaves.
    due: Option<Time>,
}

/// Newest message of one robot.
#[derive(Clone, Debug)]
struct Stream {
    message: u16,
    parts: Vec<Sent>,
    /// Numbers of the parts that wait, in their order.
    waiting: VecDeque<u8>,
    /// Earliest time for the next part.
    due: Time,
    spacing: Span,
    /// Shortest time between two transmissions of a part.
    rest: Span,
}

/// Part of a message, and how often it has left.
#[derive(Clone, Debug)]
struct Sent {
    part: Latent,
    last: Option<Time>,
    times: u8,
}

impl Outbox {
    /// Returns the number of the next message of `robot`.
    pub fn number(&self, robot: RobotId) -> u16 {
        self.streams.get(&robot).map_or(0, |stream| stream.message.wrapping_add(1))
    }

    /// Takes the parts of a message at `now`; the first of them is due at once. It replaces the robot's last message,
    /// of which nothing more leaves.
    pub fn put(&mut self, now: Time, parts: Vec<Latent>, settings: &Settings) {
        let Some(Latent { robot, part: Some(Part { message, of, .. }), .. }) = parts.first() else { return };
        let (robot, message, of) = (*robot, *message, *of);
        let (spacing, rest) = (settings.spacing(of), Span::from_nanos(settings.retry().as_nanos() / 2));
        let parts = parts.into_iter().map(|part| Sent { part, last: None, times: 0 }).collect();
        self.streams.insert(robot, Stream { message, parts, waiting: (0..of).collect(), due: now, spacing, rest });
        self.plan();
    }

    /// Returns the next part that is due at `now`, and whether it has left before; `None` if none is.
    pub fn next(&mut self, now: Time) -> Option<(Latent, bool)> {
        if self.due.is_none_or(|due| due > now) {
            return None;
        }
        let is_due = |stream: &&mut Stream| !stream.waiting.is_empty() && stream.due <= now;
        let stream = self.streams.values_mut().filter(is_due).min_by_key(|stream| stream.due)?;
        let sent = &mut stream.parts[usize::from(stream.waiting.pop_front()?)];
        stream.due += stream.spacing;
        let again = sent.last.replace(now).is_some();
        sent.times += 1;
        let part = sent.part.clone();
        self.plan();
        Some((part, again))
    }

    /// Takes the requests of another host for parts that it has not received.
    pub fn asked(&mut self, now: Time, all: &[Lacking]) {
        all.iter().for_each(|lacking| self.asked_for(now, lacking));
        self.plan();
    }

    fn asked_for(&mut self, now: Time, lacking: &Lacking) {
        let Some(stream) = self.streams.get_mut(&lacking.robot) else { return };
        if stream.message != lacking.message {
            return;
        }
        if stream.waiting.is_empty() {
            stream.due = stream.due.max(now);
        }
        for index in numbers(lacking.parts) {
            let Some(sent) = stream.parts.get(usize::from(index)) else { break };
            // What has just left has crossed the request, or answers that of another host.
            let rests = sent.last.is_none_or(|last| now.since(last) < stream.rest);
            if !rests && sent.times <= AGAIN && !stream.waiting.contains(&index) {
                stream.waiting.push_back(index);
            }
        }
    }

    /// Returns the time at which to call [`Outbox::next`]; `None` if no part waits.
    pub fn due(&self) -> Option<Time> {
        self.due
    }

    fn plan(&mut self) {
        let waiting = self.streams.values().filter(|stream| !stream.waiting.is_empty());
        self.due = waiting.map(|stream| stream.due).min();
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{at_ms, parts, settings};
    use super::*;
    use crate::messages::wire::Missing;

    /// Numbers of the parts that leave at `now`, and whether each has left before.
    fn leaving(outbox: &mut Outbox, now: Time) -> Vec<(u8, bool)> {
        let next = || outbox.next(now).map(|(part, again)| (part.part.expect("it is a part").index, again));
        std::iter::from_fn(next).collect()
    }

    #[test]
    fn parts_leave_one_after_the_other_within_the_pace() {
        let mut outbox = Outbox::default();
        outbox.put(at_ms(0), parts(0, 1.0), &settings(Missing::Whole));
        let left: Vec<_> = (0..50).map(|ms| (ms, leaving(&mut outbox, at_ms(ms)).len())).collect();
        assert!(left[0].1 == 1 && left.iter().all(|(_, parts)| *parts <= 1), "{left:?}");
        let last = left.iter().filter(|(_, parts)| *parts > 0).map(|(ms, _)| *ms).max();
        assert_eq!((left.iter().map(|(_, parts)| parts).sum::<usize>(), last), (12, Some(37)));
        assert_eq!(outbox.due(), None);
    }

    #[test]
    fn a_newer_message_replaces_what_has_not_left() {
        let mut outbox = Outbox::default();
        outbox.put(at_ms(0), parts(0, 1.0), &settings(Missing::Whole));
        assert_eq!(leaving(&mut outbox, at_ms(4)), [(0, false), (1, false)]);
        assert_eq!(outbox.number(RobotId(1)), 1);
        outbox.put(at_ms(5), parts(1, 2.0), &settings(Missing::Whole));
        assert_eq!(leaving(&mut outbox, at_ms(5)), [(0, false)]);
        outbox.asked(at_ms(30), &[Lacking { robot: RobotId(1), message: 0, parts: 1 }]);
        assert!(leaving(&mut outbox, at_ms(300)).iter().all(|(_, again)| !again), "message 0 is replaced");
    }

    #[test]
    fn what_is_asked_for_leaves_again_but_not_for_ever() {
        let mut outbox = Outbox::default();
        outbox.put(at_ms(0), parts(0, 1.0), &settings(Missing::Whole));
        assert_eq!(leaving(&mut outbox, at_ms(40)).len(), 12);
        let lacking = [Lacking { robot: RobotId(1), message: 0, parts: (1 << 3) | (1 << 9) | (1 << 100) }];
        outbox.asked(at_ms(43), &lacking);
        assert_eq!(leaving(&mut outbox, at_ms(60)), [], "they have just left");
        outbox.asked(at_ms(60), &lacking);
        outbox.asked(at_ms(60), &lacking);
        assert_eq!(leaving(&mut outbox, at_ms(60)), [(3, true)]);
        assert_eq!(leaving(&mut outbox, at_ms(80)), [(9, true)]);
        let mut again = 0;
        for ms in 81..2000 {
            outbox.asked(at_ms(ms), &lacking);
            again += leaving(&mut outbox, at_ms(ms)).len();
        }
        assert_eq!(again, 2 * usize::from(AGAIN) - 2);
        outbox.asked(at_ms(90), &[Lacking { robot: RobotId(2), message: 0, parts: 1 }]);
    }
}
