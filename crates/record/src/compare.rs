//! Compares a replay with its record, message by message, up to the first difference.

use std::fmt;

use super::Event;
use super::reader::{Message, Messages, ReadError};
use super::tape;
use super::topics::{PROGRAM, Topic, Topics, WIFI};
use murmurate::messages::wire::Wire;
use murmurate::net::protocol::codec;

/// First difference between a record and its replay.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Time since the start of the run at which record and replay differ \[s\].
    pub at_s: f64,
    /// Topic of the message in the replay; of the recorded message if the replay has ended.
    pub topic: String,
    /// Recorded message, decoded as text, or a text that says that the record has ended.
    pub recorded: String,
    /// Message of the replay, decoded as text, or a text that says that the replay has ended.
    pub replayed: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Difference { at_s, topic, recorded, replayed } = self;
        write!(f, "first difference at {at_s:.6} s, {topic}\n  recorded  {recorded}\n  replayed  {replayed}")
    }
}

/// Comparison of a running replay with its record, message by message.
pub struct Comparison {
    recorded: Messages,
    topics: Topics,
    anchor_ns: u64,
    /// Whether the digests of sent datagrams are not compared: the replay has no key, so its tags are zeros and the
    /// digests differ.
    tagless: bool,
    instant: Vec<Event>,
    messages: u64,
    /// Whether the replay has reached the end of a record that a crash has cut.
    cut: bool,
    /// Time since the start of the run at which the record lacks events \[s\]; `None` if no event was dropped.
    gap_s: Option<f64>,
    /// Time since the start of the run behind which messages of the record are lost to damage \[s\]; `None` if none
    /// are.
    damaged_s: Option<f64>,
    difference: Option<Difference>,
    error: Option<ReadError>,
}

/// Result of the comparison of a replay with its record.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Number of messages that were compared and are equal in record and replay.
    pub messages: u64,
    /// The first difference between record and replay; `None` if there is none.
    pub difference: Option<Difference>,
    /// Whether the record was cut by a crash. If so, only the messages before the cut were compared.
    pub cut: bool,
    /// Time since the start of the run \[s\] from which on the record lacks events, because they were dropped when it
    /// was made; nothing after it was compared. `None` if no event was dropped.
    pub gap_s: Option<f64>,
    /// Time since the start of the run \[s\] behind which messages of the record are lost, because its file is damaged;
    /// nothing after it was compared. `None` if none are.
    pub damaged_s: Option<f64>,
}

impl Comparison {
    /// Returns a comparison that begins at the first of the messages `recorded`. `topics` converts the replay's events
    /// to messages. `anchor_ns` is the wall clock at the start of the recorded run \[ns\] since 1970; 0 if it was a
    /// simulation.
    pub fn new(recorded: Messages, topics: Topics, anchor_ns: u64) -> Comparison {
        Comparison {
            recorded,
            topics,
            anchor_ns,
            tagless: false,
            instant: Vec::new(),
            messages: 0,
            cut: false,
            gap_s: None,
            damaged_s: None,
            difference: None,
            error: None,
        }
    }

    /// Returns this comparison without the digests of sent datagrams. It is for a replay without the team's key, which
    /// cannot compute the authentication tags of datagrams.
    pub fn without_tags(mut self) -> Comparison {
        self.tagless = true;
        self
    }

    /// Adds an event of the replay. With the event `Turn`, which ends a turn of the event loop, all events of that turn
    /// are compared with the record.
    pub fn push(&mut self, event: Event) {
        let Event::Turn(now) = event else {
            self.instant.push(event);
            return;
        };
        let Comparison { recorded, topics, instant, messages, cut, gap_s, damaged_s, difference, error, .. } = self;
        let stage = topics.stage().clone();
        let (anchor_ns, tagless) = (self.anchor_ns, self.tagless);
        topics.instant(now, instant, &mut |topic, at, data| {
            if difference.is_some() || error.is_some() || *cut || gap_s.is_some() || damaged_s.is_some() {
                return;
            }
            let at_s = (at - anchor_ns) as f64 / 1e9;
            let found = next(recorded);
            if recorded.gaps() > 0 {
                *damaged_s = Some(at_s);
                return;
            }
            match found {
                Ok(Some(mut message)) => {
                    if tagless && topic == Topic::Turn && message.data.len() >= 16 && data.len() >= 16 {
                        message.data[8..16].copy_from_slice(&data[8..16]);
                    }
                    if (message.at, &*message.data) == (at, data) && message.channel.topic == topic.name(&stage) {
                        *messages += 1;
                        return;
                    }
                    let when_s = message.at.saturating_sub(anchor_ns) as f64 / 1e9;
                    if is_gap(&message) {
                        *gap_s = Some(when_s);
                        return;
                    }
                    *difference = Some(Difference {
                        at_s: at_s.min(when_s),
                        topic: topic.name(&stage),
                        recorded: words(&message.channel.topic, when_s, &message.data),
                        replayed: words(&topic.name(&stage), at_s, data),
                    });
                }
                // A record that a crash has cut ends before its run does.
                Ok(None) if !recorded.is_complete() => *cut = true,
                Ok(None) => {
                    *difference = Some(Difference {
                        at_s,
                        topic: topic.name(&stage),
                        recorded: "nothing: the record ends here".to_owned(),
                        replayed: words(&topic.name(&stage), at_s, data),
                    });
                }
                Err(wrong) => *error = Some(wrong),
            }
        });
        self.instant.clear();
    }

    /// Returns whether the comparison has ended before the end of the record: at a difference, at dropped events, at
    /// damage, at a cut by a crash, or at a read error.
    pub fn is_over(&self) -> bool {
        self.cut
            || self.gap_s.is_some()
            || self.damaged_s.is_some()
            || self.difference.is_some()
            || self.error.is_some()
    }

    /// Ends the comparison and returns its result. Recorded messages after the end of the replay count as a difference.
    /// An error says that the record cannot be read.
    pub fn finish(mut self) -> Result<Compared, ReadError> {
        if let Some(error) = self.error {
            return Err(error);
        }
        if !self.is_over()
            && let Some(message) = next(&mut self.recorded)?
            && self.recorded.gaps() == 0
        {
            let at_s = message.at.saturating_sub(self.anchor_ns) as f64 / 1e9;
            self.difference = Some(Difference {
                at_s,
                topic: message.channel.topic.clone(),
                recorded: words(&message.channel.topic, at_s, &message.data),
                replayed: "nothing: the replay ends here".to_owned(),
            });
        }
        self.cut |= self.difference.is_none() && !self.recorded.is_complete();
        let Comparison { messages, difference, cut, gap_s, damaged_s, .. } = self;
        Ok(Compared { messages, difference, cut, gap_s, damaged_s })
    }
}

/// Returns the next recorded message that a replay repeats, that is, every one but log lines and samples of Wi-Fi;
/// `None` at the end of the record.
fn next(recorded: &mut Messages) -> Result<Option<Message>, ReadError> {
    loop {
        match recorded.next_message()? {
            Some(message) if [PROGRAM, WIFI].contains(&&*message.channel.topic) => {}
            other => return Ok(other),
        }
    }
}

/// Whether a message reports that the recording dropped events before it.
fn is_gap(message: &Message) -> bool {
    message.channel.topic == "/counts"
        && serde_json::from_slice::<serde_json::Value>(&message.data)
            .is_ok_and(|said| said["recording_dropped"].is_u64())
}

/// Returns a line of text about a message: its time, topic and decoded content.
fn words(topic: &str, at_s: f64, data: &[u8]) -> String {
    let what = if topic.starts_with("/wire/") {
        match codec::decode(data) {
            Ok((header, message)) => format!("datagram {} of it: {}", header.sequence, short(&message)),
            Err(error) => format!("{} bytes that are no datagram ({error})", data.len()),
        }
    } else if topic == "/tape/turn" {
        match tape::read(data) {
            Some(turn) => format!("turn with {} inputs, sent {:016x}", turn.inputs.len(), turn.sent),
            None => format!("{} bytes that are no turn", data.len()),
        }
    } else {
        match std::str::from_utf8(data) {
            Ok(text) if text.starts_with('{') => text.to_owned(),
            _ => format!("{} bytes, {:08x}", data.len(), xxhash_rust::xxh3::xxh3_64(data) as u32),
        }
    };
    format!("{at_s:.6} s {topic}: {what}")
}

fn short(message: &Wire) -> String {
    let text = format!("{message:?}");
    match text.char_indices().nth(300) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text,
    }
}
