//! Warnings of drivers and sources, kept for the findings of `doctor`.
//!
//! A worker logs what keeps it from its robot or its tracker, with what to do. `doctor` says that in the line of the
//! robot or the source, instead of the log.

use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

/// Most notes that are kept: a broken tracker may warn without end.
const MOST: usize = 1000;

/// A warning, with the thread of a worker or the name of an actor that it came from.
struct Note {
    from: String,
    text: String,
}

static NOTES: Mutex<Vec<Note>> = Mutex::new(Vec::new());
/// Whether notes are taken no more.
static CLOSED: AtomicBool = AtomicBool::new(false);

/// Layer that keeps warnings and errors.
pub struct Notes;

/// Message of an event.
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

/// Takes notes, or no more: what workers say when they end is no finding.
pub fn take(open: bool) {
    CLOSED.store(!open, Ordering::Relaxed);
}

/// Newest note from one of these threads or actors.
pub fn newest(from: &[&str]) -> Option<String> {
    let notes = NOTES.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    notes.iter().rev().find(|note| from.contains(&note.from.as_str())).map(|note| note.text.clone())
}
