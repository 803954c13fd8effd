//! Progress bars of long commands, on stderr if it is a terminal.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use murmurate::results::episode::Episode;
use murmurate::simulate::Proceed;

/// Returns a callback for a trial, which is called with the episodes finished so far. It advances the progress bar by
/// the new ones, and stops the trial once `stop` is set.
pub fn watched(bar: &ProgressBar, stop: &AtomicBool) -> impl FnMut(&[Episode]) -> Proceed {
    let mut shown = 0;
    move |episodes| {
        if episodes.len() > shown {
            bar.inc((episodes.len() - shown) as u64);
            shown = episodes.len();
        }
        if stop.load(Ordering::Relaxed) { Proceed::Stop } else { Proceed::Continue }
    }
}

/// Returns a progress bar on stderr over this many episodes, with the estimated remaining time. If `quiet` is true, the
/// bar is hidden.
pub fn progress(episodes: u64, quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(episodes);
    let style =
        ProgressStyle::with_template("{bar:30} {pos}/{len} episodes, {eta} left").expect("the template is sound");
    bar.set_style(style);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
