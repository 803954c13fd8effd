//! Log of a command: its level, and its start.

use tracing_subscriber::Layer;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::{checks, doctor, output};

/// Level and way of a command's log on stderr; `MURMURATE_LOG` overrides the level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Logging {
    /// Errors alone; the command waits until they are written.
    Errors,
    /// Errors, by a command that must not wait for a terminal, such as an emergency stop.
    Urgent,
    /// Warnings, too: the operator of a robot has to see what its guard does. Nothing waits for a terminal.
    RealTime,
    /// Errors; warnings are collected for the findings of `doctor`.
    Findings,
}

impl Logging {
    /// Whether a thread of its own writes the lines of the log.
    pub fn is_asynchronous(self) -> bool {
        matches!(self, Logging::Urgent | Logging::RealTime)
    }

    /// Starts the log, with the levels of `MURMURATE_LOG` if it is set. The error says what is wrong with it.
    pub fn start(self) -> Result<(), String> {
        let level = match self {
            // Zenoh's library warns of every attempt to reach a router; the transport says it once.
            Logging::RealTime => "warn,zenoh=error",
            Logging::Findings => doctor::LEVEL,
            Logging::Errors | Logging::Urgent => "error",
        };
        log(std::env::var("MURMURATE_LOG").as_deref().unwrap_or(level), self == Logging::Findings)
    }
}

/// Starts logging to stderr. `wanted` is a level, or levels of modules as in `warn,murmurate::net=debug`. With `notes`,
/// warnings are also collected for the findings of `doctor`.
fn log(wanted: &str, notes: bool) -> Result<(), String> {
    // Without this check, the parser would take a misspelt level for a module's name.
    let odd = wanted.split(',').find(|part| !part.contains('=') && part.trim().parse::<LevelFilter>().is_err());
    if let Some(odd) = odd {
        return Err(format!("'{odd}' is no level; there are off, error, warn, info, debug and trace"));
    }
    let targets: Targets = wanted.parse().map_err(|error| format!("'{wanted}': {error}"))?;
    let (registry, coloured) = (tracing_subscriber::registry(), output::colour());
    if notes {
        let lines = tracing_subscriber::fmt::layer()
            .with_timer(output::Stamp)
            .with_writer(|| output::LogLines)
            .with_ansi(coloured);
        let notes = checks::Notes.with_filter(checks::Warnings);
        registry.with(lines.with_filter(targets)).with(notes).init();
    } else {
        // A single filter for all is the cheapest.
        let lines = tracing_subscriber::fmt::layer()
            .with_timer(output::Stamp)
            .with_writer(|| output::LogLines)
            .with_ansi(coloured);
        #[cfg(feature = "record")]
        let registry = registry.with(crate::recording::log::Lines);
        registry.with(targets).with(lines).init();
    }
    Ok(())
}
