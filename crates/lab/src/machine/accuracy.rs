//! Accuracy of a laboratory on this machine: compares a load in real time with the same load in virtual time, and at
//! saturation with Bianchi's model.

use std::fmt;
use std::thread;

use serde::Serialize;

use super::carrier::Warn;
use super::error::Result;
use super::running::Running;
use super::traffic::Sockets;
use crate::file::Laboratory;
use crate::load::{Load, Outcome};
use crate::report::LabReport;

/// Priority of the thread that sends and receives; the lab's own is higher.
const TRAFFIC_PRIORITY: u8 = 10;

/// Measurement of one load, with the same in virtual time.
#[derive(Serialize)]
pub struct Accuracy {
    /// Number of stations.
    pub stations: u16,
    /// Whether datagrams go to one station or to all, in a word.
    pub cast: &'static str,
    /// Load in percent of the throughput of the saturated channel; above 100 the channel is saturated.
    pub load_percent: u32,
    /// Number of datagrams that were sent per second.
    pub offered_per_s: f64,
    /// Share of the wanted deliveries that were made.
    pub delivered: f64,
    /// The same in virtual time.
    pub delivered_virtual: f64,
    /// Median of the delays \[ms\].
    pub p50_ms: f64,
    /// The same in virtual time.
    pub p50_virtual_ms: f64,
    /// Delay that one delivery in ten exceeds \[ms\].
    pub p90_ms: f64,
    /// The same in virtual time.
    pub p90_virtual_ms: f64,
    /// Number of deliveries per second.
    pub deliveries_per_s: f64,
    /// Number of deliveries per second that Bianchi's model has for the saturated channel.
    pub model_per_s: f64,
    /// Share of frames that were late.
    pub late: f64,
    /// Lateness that one frame in a hundred exceeds \[us\].
    pub late_p99_us: u64,
    /// Largest lateness \[us\].
    pub late_max_us: u64,
    /// Whether the measurement is within all tolerances.
    pub met: bool,
}

/// Makes a laboratory, and measures a load on it in real and in virtual time. `warn` is called with warnings.
pub fn measure(lab: &Laboratory, load: &Load, warn: Warn) -> Result<Accuracy> {
    let running = Running::start(lab, None, warn)?;
    let sockets = Sockets::open(lab)?;
    // On a thread of its own, which alone has the priority.
    let (offers, real) = thread::scope(|scope| {
        let traffic = scope.spawn(|| sockets.run(lab, load, TRAFFIC_PRIORITY));
        traffic.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })?;
    let after = running.end()?;
    if real.delivered == 0.0 {
        warn("warning: no datagram has arrived at all");
    }
    Ok(Accuracy::of(lab, load, &real, &load.in_virtual_time(lab, &offers), &after))
}

/// Returns whether two delays are within 10 % or half a millisecond.
fn alike(real_ms: f64, virtual_ms: f64) -> bool {
    (real_ms - virtual_ms).abs() <= (0.1 * virtual_ms).max(0.5)
}

impl Accuracy {
    fn of(lab: &Laboratory, load: &Load, real: &Outcome, ideal: &Outcome, after: &LabReport) -> Accuracy {
        let late = after.lateness.late as f64 / after.lateness.deliveries.max(1) as f64;
        let percent = (100.0 * load.share).round() as u32;
        let model = load.capacity(lab) * load.receivers(lab) as f64;
        let met = if percent > 100 {
            (real.deliveries_per_s / model - 1.0).abs() <= 0.05
        } else {
            (real.delivered - ideal.delivered).abs() <= 0.02
                && alike(real.p50_ms, ideal.p50_ms)
                && alike(real.p90_ms, ideal.p90_ms)
        };
        Accuracy {
            stations: lab.stations,
            cast: load.cast.name(),
            load_percent: percent,
            offered_per_s: real.sent as f64 / load.lasts.as_secs(),
            delivered: real.delivered,
            delivered_virtual: ideal.delivered,
            p50_ms: real.p50_ms,
            p50_virtual_ms: ideal.p50_ms,
            p90_ms: real.p90_ms,
            p90_virtual_ms: ideal.p90_ms,
            deliveries_per_s: real.deliveries_per_s,
            model_per_s: model,
            late,
            late_p99_us: after.lateness.p99_us,
            late_max_us: after.lateness.max_us,
            met: met && late <= 0.01,
        }
    }
}

impl fmt::Display for Accuracy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:>8} {:<9} {:>6} {:>9.0} {:>7.2} {:>7.2} {:>8.3} {:>8.3} {:>8.3} {:>8.3} {:>9.0} {:>9.0} {:>7.3}  {}",
            self.stations,
            self.cast,
            self.load_percent,
            self.offered_per_s,
            100.0 * self.delivered,
            100.0 * self.delivered_virtual,
            self.p50_ms,
            self.p50_virtual_ms,
            self.p90_ms,
            self.p90_virtual_ms,
            self.deliveries_per_s,
            self.model_per_s,
            100.0 * self.late,
            if self.met { "yes" } else { "NO" }
        )
    }
}

/// Heading of the table, for the columns of a row.
pub const HEADING: &str = "stations cast       load offered/s  deliv %    virt   p50 ms     virt   p90 ms     virt  \
    arrive/s   model/s  late %  met";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load::Cast;
    use murmurate::time::Span;

    #[test]
    fn delays_are_alike_within_a_tenth_or_half_a_millisecond() {
        assert!(alike(1.4, 1.0) && !alike(1.6, 1.0));
        assert!(alike(11.0, 10.0) && !alike(8.9, 10.0));
    }

    #[test]
    fn below_saturation_the_bars_are_those_of_virtual_time_and_above_it_the_model_s() {
        let lab = Laboratory::from_toml("stations = 5\n").unwrap();
        let load = |share| Load { cast: Cast::Unicast, share, bytes: 200, lasts: Span::from_secs(5.0) };
        let ideal = Outcome { sent: 100, delivered: 0.99, deliveries_per_s: 20.0, p50_ms: 1.0, p90_ms: 2.0 };
        let met =
            |share, real: &Outcome, report: &LabReport| Accuracy::of(&lab, &load(share), real, &ideal, report).met;
        let report = LabReport::default();
        assert!(met(0.5, &ideal, &report), "it need not be what the model has for saturation");
        assert!(!met(0.5, &Outcome { delivered: 0.96, ..ideal }, &report));
        assert!(!met(0.5, &Outcome { p90_ms: 2.6, ..ideal }, &report));
        let model = load(2.5).capacity(&lab) * load(2.5).receivers(&lab) as f64;
        assert!(met(2.5, &Outcome { deliveries_per_s: 0.96 * model, delivered: 0.4, ..ideal }, &report));
        assert!(!met(2.5, &Outcome { deliveries_per_s: 0.94 * model, ..ideal }, &report));
        let mut late = LabReport::default();
        (late.lateness.late, late.lateness.deliveries) = (2, 100);
        assert!(!met(0.5, &ideal, &late));
    }
}
