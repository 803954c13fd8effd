//! Soft state that a host says itself: the newest message of each stream, and the entry that was made of it.

use std::collections::BTreeMap;

use super::entry::Content;
use super::lead::Lead;
use crate::messages::ids::RobotId;
use crate::messages::wire::{Kind, Wire};
use crate::net::protocol::codec::Frame;
use crate::time::{Span, Time};

/// Time after which a message that is repeated unchanged is said anew: that of the state server, on which all robots
/// wait, and all others.
const PERIODS: [Span; 2] = [Span::from_millis(250), Span::from_millis(300)];
/// Least time between two entries of a stream.
const LEAST: Span = Span::from_millis(50);
/// Number of times that an entry is said.
pub(super) const TIMES: u8 = 2;

/// Messages of this host that are said across hops.
#[derive(Clone, Debug, Default)]
pub(super) struct Own(BTreeMap<(Kind, RobotId), Mine>);

#[derive(Clone, Debug)]
struct Mine {
    message: Wire,
    /// Whether the message was published after the entry was made, and whether it is another one.
    published: bool,
    changed: bool,
    made: Option<Time>,
    entry: Option<Frame>,
    said: u8,
}

impl Own {
    /// Takes a message in place of the last one of its stream.
    pub fn put(&mut self, message: &Wire) {
        let stream = (message.kind(), message.robot());
        let new =
            || Mine { message: message.clone(), published: true, changed: true, made: None, entry: None, said: TIMES };
        let mine = self.0.entry(stream).or_insert_with(new);
        mine.changed |= mine.message != *message;
        mine.message = message.clone();
        mine.published = true;
    }

    /// Returns the streams of which a new entry is due at `now`.
    pub fn due(&self, now: Time) -> Vec<(Kind, RobotId)> {
        let is_due = |(kind, _): &(Kind, RobotId), mine: &Mine| {
            let period = if mine.changed { LEAST } else { PERIODS[usize::from(*kind != Kind::Mode)] };
            mine.published && mine.made.is_none_or(|made| now.since(made) >= period)
        };
        self.0.iter().filter(|(stream, mine)| is_due(stream, mine)).map(|(stream, _)| *stream).collect()
    }

    /// Makes the entry of a stream: `seal` gets its content and its body.
    pub fn make(&mut self, now: Time, stream: (Kind, RobotId), seal: impl FnOnce(Content, &[u8]) -> Frame) {
        let Some(mine) = self.0.get_mut(&stream) else { return };
        let (content, body) = match &mine.message {
            Wire::Mode(mode) => (Content::Lead, Lead::body(mode)),
            message => {
                let body = rmp_serde::encode::to_vec(message).expect("plain data is always MessagePack");
                (Content::Message(stream.0), body)
            }
        };
        mine.entry = Some(seal(content, &body));
        (mine.published, mine.changed, mine.made, mine.said) = (false, false, Some(now), 0);
    }

    /// Returns the entries that are still to be said.
    pub fn unsaid(&self) -> impl Iterator<Item = &Frame> {
        self.0.values().filter(|mine| mine.said < TIMES).filter_map(|mine| mine.entry.as_ref())
    }

    /// Takes note that an entry has left. Returns whether it was one of this host.
    pub fn said(&mut self, entry: &Frame) -> bool {
        let mine = self.0.values_mut().find(|mine| mine.entry.as_ref() == Some(entry));
        mine.map(|mine| mine.said += 1).is_some()
    }
}
