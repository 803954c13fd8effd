//! Warnings of drivers and sources, collected for the findings of `doctor`.
//!
//! A worker logs what keeps it from its robot or its tracker, and what to do. `doctor` shows this in its finding about
//! the robot or the source, and not in the log.

use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::messages::ids::RobotId;
use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

/// Largest number of collected warnings. A faulty tracker may warn without end.
const MOST: usize = 1000;

/// Collected warning or error: its text, and its origin, the name of a worker's thread or of an actor.
struct Note {
    from: String,
    text: String,
}

static NOTES: Mutex<Vec<Note>> = Mutex::new(Vec::new());
/// True while warnings are not collected.
static CLOSED: AtomicBool = AtomicBool::new(false);

/// Log layer that collects the warnings and errors of drivers and sources, for the findings of `doctor`.
pub struct Notes;

/// Visitor that extracts the message of a log event.
#[derive(Default)]
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Notes {
    fn on_event(&self, event: &Event<'_>, context: Context<'_, S>) {
        let mut message = Message::default();
        event.record(&mut message);
        let actor = context.event_span(event).map(|span| span.name().to_owned());
        let from = actor.or_else(|| std::thread::current().name().map(str::to_owned)).unwrap_or_default();
        let mut notes = NOTES.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if notes.len() < MOST && !CLOSED.load(Ordering::Relaxed) {
            notes.push(Note { from, text: message.0 });
        }
    }
}

/// Starts the collection of drivers' and sources' warnings if `open` is true, and ends it otherwise. It has to be ended
/// before the threads of drivers and sources shut down, as their last messages are no findings.
pub fn take(open: bool) {
    CLOSED.store(!open, Ordering::Relaxed);
}

/// Returns the text of the newest collected warning of any thread or actor named in `from`; `None` if there is none.
pub fn newest(from: &[&str]) -> Option<String> {
    let notes = NOTES.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    notes.iter().rev().find(|note| from.contains(&note.from.as_str())).map(|note| note.text.clone())
}

/// Returns the text of the newest collected warning that begins with the name of `robot`, without this name; `None` if
/// there is none. Drivers warn on the thread of all actors, where the robot's name alone distinguishes them.
pub fn about(robot: RobotId) -> Option<String> {
    let name = format!("{robot}: ");
    let notes = NOTES.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    notes.iter().rev().find_map(|note| note.text.strip_prefix(&name).map(str::to_owned))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_is_found_by_the_robot_that_it_names() {
        let note = |text: &str| Note { from: "body".to_owned(), text: text.to_owned() };
        NOTES.lock().unwrap().extend(["robot 91: old", "robot 91: new", "robot 9: other"].map(note));
        assert_eq!(about(RobotId(91)).as_deref(), Some("new"));
        assert_eq!((about(RobotId(9)).as_deref(), about(RobotId(1))), (Some("other"), None));
    }
}
