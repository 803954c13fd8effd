//! Warnings of drivers, sources and senses, collected for the findings about devices.
//!
//! A worker logs what keeps it from its robot or its tracker, and what to do; a Localizer and a Body log what they
//! refuse. `doctor` shows this in its finding about the robot or the source, and not in the log. The most frequent
//! warning comes first, and of equally frequent ones the earlier: a cause is logged before what follows from it.

use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use murmurate::messages::ids::RobotId;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::{Context, Filter};
use tracing_subscriber::registry::LookupSpan;

/// Largest number of different warnings that are collected. A faulty tracker may change its mistake all the time.
const MOST: usize = 1000;
/// Largest number of warnings that one finding shows.
const SHOWN: usize = 3;
/// Thread and span of the source of readings.
const SOURCE: [&str; 2] = ["source", "localizer"];

/// Collected warning or error: its text, and its origin, the name of an actor or of a worker's thread.
#[derive(Debug)]
struct Note {
    from: String,
    text: String,
    /// Number of times that it came; for what is counted where it is logged, the count at the last log line.
    count: u64,
}

/// Warnings in the order in which they first came.
#[derive(Debug, Default)]
struct Collected(Vec<Note>);

impl Collected {
    const EMPTY: Collected = Collected(Vec::new());

    /// Adds a warning; `counted` is the number of times that it came, if who logs it counts.
    fn add(&mut self, from: String, text: String, counted: Option<u64>) {
        if let Some(note) = self.0.iter_mut().find(|note| note.from == from && note.text == text) {
            note.count = counted.unwrap_or(note.count + 1).max(note.count);
        } else if self.0.len() < MOST {
            self.0.push(Note { from, text, count: counted.unwrap_or(1) });
        }
    }

    /// Returns the texts of the warnings that `of` makes of those that it takes, the most frequent first, with their
    /// numbers.
    fn ranked(&self, of: impl Fn(&Note) -> Option<&str>) -> Vec<String> {
        let mut found: Vec<(u64, &str)> = self.0.iter().filter_map(|note| Some((note.count, of(note)?))).collect();
        found.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
        let shown = found.iter().take(SHOWN).map(|(count, text)| match count {
            1 => (*text).to_owned(),
            count => format!("{text} ({count} times or more)"),
        });
        shown.collect()
    }

    fn of_source(&self, robot: RobotId) -> Vec<String> {
        let name = format!("{robot}: ");
        self.ranked(|note| note.text.strip_prefix(&name).filter(|_| note.is_of_source()))
    }

    fn of_whole_source(&self) -> Vec<String> {
        self.ranked(|note| (note.is_of_source() && !note.names_robot()).then_some(note.text.as_str()))
    }

    fn of_driver(&self, robot: RobotId) -> Vec<String> {
        let (name, thread) = (format!("{robot}: "), format!("driver {}", robot.0));
        self.ranked(|note| match note.text.strip_prefix(&name) {
            Some(rest) => Some(rest).filter(|_| !note.is_of_source()),
            None => (note.from == thread).then_some(note.text.as_str()),
        })
    }
}

impl Note {
    fn is_of_source(&self) -> bool {
        SOURCE.contains(&self.from.as_str())
    }

    /// Whether the text begins with the name of a robot, as in `robot 7: `.
    fn names_robot(&self) -> bool {
        let name = self.text.strip_prefix("robot ").and_then(|rest| rest.split_once(": "));
        name.is_some_and(|(number, _)| number.parse::<u16>().is_ok())
    }
}

static NOTES: Mutex<Collected> = Mutex::new(Collected::EMPTY);
/// True while warnings are not collected.
static CLOSED: AtomicBool = AtomicBool::new(false);

/// Log layer that collects the warnings and errors of drivers and sources, for the findings of `doctor`.
pub struct Notes;

/// Filter of the layer [`Notes`]: warnings and errors, and spans of every level, since they name the actor that warns.
pub struct Warnings;

impl<S> Filter<S> for Warnings {
    fn enabled(&self, metadata: &Metadata<'_>, _: &Context<'_, S>) -> bool {
        metadata.is_span() || *metadata.level() <= Level::WARN
    }
}

/// Visitor that extracts the message and the count of a log event.
#[derive(Default)]
struct Message {
    text: String,
    /// Field `refused`: number of times that the same was refused.
    refused: Option<u64>,
}

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            self.text = format!("{value:?}");
        }
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        if field.name() == "refused" {
            self.refused = Some(value);
        }
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Notes {
    fn on_event(&self, event: &Event<'_>, context: Context<'_, S>) {
        let mut message = Message::default();
        event.record(&mut message);
        let actor = context.event_span(event).map(|span| span.name().to_owned());
        let from = actor.or_else(|| std::thread::current().name().map(str::to_owned)).unwrap_or_default();
        if !CLOSED.load(Ordering::Relaxed) {
            with(|notes| notes.add(from, message.text, message.refused));
        }
    }
}

fn with<T>(of: impl FnOnce(&mut Collected) -> T) -> T {
    of(&mut NOTES.lock().unwrap_or_else(|poisoned| poisoned.into_inner()))
}

/// Starts the collection of drivers' and sources' warnings if `open` is true, without those of an earlier host, and
/// ends it otherwise. It has to be ended before the threads of drivers and sources shut down, as their last messages
/// are no findings.
pub fn take(open: bool) {
    CLOSED.store(!open, Ordering::Relaxed);
    if open {
        with(|notes| notes.0.clear());
    }
}

/// Returns the collected warnings of the source about one robot, without its name.
pub fn of_source(robot: RobotId) -> Vec<String> {
    with(|notes| notes.of_source(robot))
}

/// Returns the collected warnings of the source that name no robot.
pub fn of_whole_source() -> Vec<String> {
    with(|notes| notes.of_whole_source())
}

/// Returns the collected warnings about the driver of a robot, without the robot's name. Drivers warn on the thread of
/// all actors, where the robot's name alone distinguishes them, and on threads of their workers.
pub fn of_driver(robot: RobotId) -> Vec<String> {
    with(|notes| notes.of_driver(robot))
}

/// Returns the collected warnings about a sense of a robot, without the robot's name: those of its worker, whose thread
/// has the name `thread`, and those about the robot.
pub fn of_sense(robot: RobotId, thread: &str) -> Vec<String> {
    let name = format!("{robot}: ");
    with(|notes| {
        notes.ranked(|note| match note.text.strip_prefix(&name) {
            Some(rest) => Some(rest),
            None => (note.from == thread).then_some(note.text.as_str()),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing_subscriber::layer::SubscriberExt;

    #[test]
    fn warnings_are_found_by_their_robot_and_the_most_frequent_comes_first() {
        let mut notes = Collected::default();
        let mut add = |from: &str, text: &str, counted| notes.add(from.to_owned(), text.to_owned(), counted);
        add("source", "sends by unicast", None);
        add("source", "no frames for a second", None);
        add("localizer", "robot 1: rare", Some(1));
        [1, 2, 4, 256].iter().for_each(|count| add("localizer", "robot 1: frequent", Some(*count)));
        add("localizer", "robot 11: another's", Some(512));
        add("driver 1", "refuses the port", None);
        add("main", "robot 1: its odometry is silent", None);
        assert_eq!(notes.of_source(RobotId(1)), ["frequent (256 times or more)", "rare"]);
        assert_eq!(notes.of_whole_source(), ["sends by unicast", "no frames for a second"], "the cause comes first");
        assert_eq!(notes.of_driver(RobotId(1)), ["refuses the port", "its odometry is silent"]);
        assert!(notes.of_driver(RobotId(11)).is_empty());
    }

    #[test]
    fn a_warning_within_an_actor_is_that_of_the_actor() {
        let layer = Notes.with_filter(Warnings);
        let subscriber = tracing_subscriber::registry().with(layer);
        tracing::subscriber::with_default(subscriber, || {
            let _inside = tracing::info_span!("localizer").entered();
            tracing::warn!(refused = 7u64, "robot 4321: refused for this test");
            tracing::info!("robot 4321: no warning");
        });
        assert_eq!(of_source(RobotId(4321)), ["refused for this test (7 times or more)"]);
    }
}
