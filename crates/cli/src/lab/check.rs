//! `murmurate lab check`: how true a laboratory is on this machine. The same datagrams go over the channel in real time
//! and in virtual time, and at saturation the throughput is held against Bianchi's model.

use std::fmt;
use std::thread;

use anyhow::Result;
use serde::Serialize;

use super::needs;
use super::running::Running;
use super::traffic::Sockets;
use murmurate::net::media::radio::{PRESETS, Radio, Topology};
use murmurate::time::Span;
use murmurate_lab::file::Laboratory;
use murmurate_lab::load::{Cast, Load, Outcome};
use murmurate_lab::report::LabReport;
use murmurate_robot::output::{print, talk};
use murmurate_robot::{BadInput, Ended};

/// Flags of `murmurate lab check`.
#[derive(clap::Args)]
#[command(after_help = "Bars: the share delivered within 2 points, p50 and p90 of the delays within 10 % or 0.5 ms, \
    throughput at saturation within 5 % of the model, at most 1 % of the frames late. Exit codes: 0 all are met; 1 one \
    is not, or the machine lacks what a lab needs; 2 a flag is wrong.")]
pub struct Args {
    /// Numbers of stations
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "5,10")]
    stations: Vec<u16>,
    /// Loads in percent of what the saturated channel delivers; above 100 %, of what it takes from the queues, which
    /// are then full, and throughput is compared with the model
    #[arg(long, value_name = "PERCENT", value_delimiter = ',', default_value = "30,50,70,90,250")]
    loads: Vec<u32>,
    /// Length of each measurement [s]
    #[arg(long, value_name = "S", default_value = "5", value_parser = clap::value_parser!(u16).range(1..=600))]
    seconds: u16,
    /// Channel, ad hoc, with unicast and multicast at the rates of the preset
    #[arg(long, value_name = "NAME", default_value = "wifi")]
    preset: String,
    /// Multicast at the rate of unicast, so that the machine has more to carry
    #[arg(long)]
    fast_multicast: bool,
    /// Length of a datagram [bytes]
    #[arg(long, value_name = "BYTES", default_value = "200", value_parser = clap::value_parser!(u16).range(8..=1472))]
    bytes: u16,
    /// Casts to measure: unicast, multicast or both
    #[arg(long, value_name = "CAST", value_delimiter = ',', default_value = "unicast,multicast")]
    casts: Vec<String>,
    /// Prints JSON, one object a line, instead of the table
    #[arg(long)]
    json: bool,
}

/// Priority of the thread that sends and receives; the lab's own is higher.
const TRAFFIC_PRIORITY: u8 = 10;

/// One measurement beside the same in virtual time.
#[derive(Serialize)]
struct Row {
    stations: u16,
    cast: &'static str,
    load_percent: u32,
    offered_per_s: f64,
    delivered: f64,
    delivered_virtual: f64,
    p50_ms: f64,
    p50_virtual_ms: f64,
    p90_ms: f64,
    p90_virtual_ms: f64,
    deliveries_per_s: f64,
    model_per_s: f64,
    late: f64,
    late_p99_us: u64,
    late_max_us: u64,
    met: bool,
}

/// Returns whether two delays are within 10 % or half a millisecond.
fn alike(real_ms: f64, virtual_ms: f64) -> bool {
    (real_ms - virtual_ms).abs() <= (0.1 * virtual_ms).max(0.5)
}

impl Row {
    fn of(lab: &Laboratory, load: &Load, real: &Outcome, ideal: &Outcome, after: &LabReport) -> Row {
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
        Row {
            stations: lab.stations,
            cast: name(load.cast),
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

impl fmt::Display for Row {
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
const HEADING: &str = "stations cast       load offered/s  deliv %    virt   p50 ms     virt   p90 ms     virt  \
    arrive/s   model/s  late %  met";

fn name(cast: Cast) -> &'static str {
    match cast {
        Cast::Unicast => "unicast",
        Cast::Multicast => "multicast",
    }
}

/// Runs `lab check`.
pub fn run(args: &Args) -> Result<Ended> {
    let mut radio =
        Radio::preset(&args.preset).ok_or_else(|| BadInput(format!("--preset: there are {}", PRESETS.join(", "))))?;
    radio.channel = Topology::AdHoc;
    if args.fast_multicast {
        radio.basic_rate = radio.rate;
    }
    let casts: Vec<Cast> = [Cast::Unicast, Cast::Multicast]
        .into_iter()
        .filter(|cast| args.casts.iter().any(|asked| asked == name(*cast)))
        .collect();
    if casts.len() != args.casts.len() {
        return Err(BadInput("--casts: there are unicast and multicast, each once".to_owned()).into());
    }
    if let Some(wrong) = args.loads.iter().find(|load| !(1..=1000).contains(*load)) {
        return Err(BadInput(format!("--loads: {wrong} is not 1 to 1000")).into());
    }
    needs::check()?;
    if !args.json {
        print(HEADING)?;
    }
    let mut all_met = true;
    for &stations in &args.stations {
        for &cast in &casts {
            for &percent in &args.loads {
                let row = measure(args, stations, &radio, cast, percent)?;
                print(&if args.json { serde_json::to_string(&row)? } else { row.to_string() })?;
                all_met &= row.met;
            }
        }
    }
    Ok(if all_met { Ended::Done } else { Ended::Unfit })
}

/// Makes a laboratory, and compares one load on it with virtual time.
fn measure(args: &Args, stations: u16, radio: &Radio, cast: Cast, percent: u32) -> Result<Row> {
    let text = format!("name = \"labcheck-{}-\"\nstations = {stations}\nstatic_arp = true\n", std::process::id());
    let mut lab = Laboratory::from_toml(&text).map_err(|error| BadInput(format!("--stations: {error}")))?;
    lab.radio = radio.clone();
    let lasts = Span::from_secs(f64::from(args.seconds));
    let load = Load { cast, share: f64::from(percent) / 100.0, bytes: usize::from(args.bytes), lasts };
    let running = Running::start(&lab, None)?;
    let sockets = Sockets::open(&lab)?;
    // On a thread of its own, which alone has the priority.
    let (offers, real) = thread::scope(|scope| {
        let traffic = scope.spawn(|| sockets.run(&lab, &load, TRAFFIC_PRIORITY));
        traffic.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })?;
    let after = running.end()?;
    if real.delivered == 0.0 {
        talk("warning: no datagram has arrived at all");
    }
    Ok(Row::of(&lab, &load, &real, &load.in_virtual_time(&lab, &offers), &after))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_are_alike_within_a_tenth_or_half_a_millisecond() {
        assert!(alike(1.4, 1.0) && !alike(1.6, 1.0));
        assert!(alike(11.0, 10.0) && !alike(8.9, 10.0));
    }
}
