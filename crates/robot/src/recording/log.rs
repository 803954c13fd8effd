//! Collects the lines that the program logs while it records, for the topic `/log/program` of its record.

use std::fmt::{self, Write};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use tracing::field::{Field, Visit};
use tracing::{Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

use murmurate::config::redacted;
use murmurate_record::{Logged, Severity};

/// Largest number of log lines that are collected between two turns of the event loop. Further lines are only counted,
/// and one line gives their number.
const MOST: usize = 64;
/// Largest length of a collected log line \[characters\]; the rest is cut off.
const LINE: usize = 400;

/// Log lines collected since the last turn of the event loop, and the number of lines beyond `MOST`, which were not
/// kept.
static LINES: Mutex<(Vec<Logged>, u64)> = Mutex::new((Vec::new(), 0));
/// Whether log lines are collected: only while a record is written.
static OPEN: AtomicBool = AtomicBool::new(false);
/// Whether `LINES` has log lines to take. Lets `take` return without the lock if it has none.
static FILLED: AtomicBool = AtomicBool::new(false);

/// Layer of `tracing` that collects the lines logged to stderr, for the record of the run.
pub struct Lines;

/// Visitor that writes the message of a log event, and its other fields as `name=value`.
#[derive(Default)]
struct Text {
    message: String,
    fields: String,
}

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        let written = match field.name() {
            "message" => write!(self.message, "{value:?}"),
            name => write!(self.fields, " {name}={value:?}"),
        };
        written.expect("a string takes all");
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Lines {
    fn on_event(&self, event: &tracing::Event<'_>, context: Context<'_, S>) {
        if !OPEN.load(Ordering::Relaxed) {
            return;
        }
        let mut text = Text::default();
        event.record(&mut text);
        let actor = context.event_span(event).map(|span| span.name().to_owned());
        let thread = || std::thread::current().name().unwrap_or_default().to_owned();
        let mut line = redacted(&(text.message + &text.fields)).into_owned();
        if let Some((end, _)) = line.char_indices().nth(LINE) {
            line.truncate(end);
        }
        let severity = match *event.metadata().level() {
            Level::ERROR => Severity::Error,
            Level::WARN => Severity::Warning,
            Level::INFO => Severity::Info,
            Level::DEBUG | Level::TRACE => Severity::Debug,
        };
        let (lines, beyond) = &mut *LINES.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if lines.len() < MOST {
            lines.push(Logged { severity, from: actor.unwrap_or_else(thread), text: line });
        } else {
            *beyond += 1;
        }
        FILLED.store(true, Ordering::Relaxed);
    }
}

/// Starts the collection of log lines for the record if `open` is true, and ends it otherwise.
pub fn collect(open: bool) {
    OPEN.store(open, Ordering::Relaxed);
}

/// Calls `each` with every log line that was collected since the last call of this function. If more lines were logged
/// than are kept, one more line gives their number.
pub fn take(mut each: impl FnMut(Logged)) {
    if !FILLED.swap(false, Ordering::Relaxed) {
        return;
    }
    let (lines, beyond) = std::mem::take(&mut *LINES.lock().unwrap_or_else(|poisoned| poisoned.into_inner()));
    lines.into_iter().for_each(&mut each);
    if beyond > 0 {
        let text = format!("{beyond} lines were logged here for which there was no room");
        each(Logged { severity: Severity::Warning, from: "record".to_owned(), text });
    }
}
