//! Counters of a laboratory, as JSON and as a table.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::file::Laboratory;
use super::lateness::{Lateness, LatenessSummary};
use super::medium::Medium;
use murmurate::config::shown::{self, counted};
use murmurate::net::media::radio::RadioCounts;
use murmurate::net::media::radio::counts::StationCounts;
use murmurate::time::Time;

/// Counters of one station.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StationReport {
    /// Number of the station.
    pub station: u16,
    /// Its IPv4 address.
    pub address: String,
    /// Name of its network namespace.
    pub namespace: String,
    /// Counters of the radio channel.
    pub radio: StationCounts,
    /// Share of time that the station's frames and their acknowledgements took on the air.
    pub airtime: f64,
    /// Number of frames dropped because no station has their destination address.
    pub unknown: u64,
    /// Number of frames dropped because they are too short or too long.
    pub malformed: u64,
    /// Number of frames that were written late to the station's interface.
    pub late: u64,
    /// Number of frames that the station's interface did not accept.
    pub unwritten: u64,
    /// Whether the station's interface is gone.
    pub gone: bool,
}

/// Counters of a laboratory: of each station, of the channel, and how late frames were.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LabReport {
    /// Name of the laboratory.
    pub name: String,
    /// Name of the network interface in each station's namespace.
    pub interface: String,
    /// Process that runs the laboratory.
    pub pid: u32,
    /// Time since the start \[s\].
    pub seconds: f64,
    /// Counters of each station.
    pub stations: Vec<StationReport>,
    /// Counters of the access point; `None` without one.
    pub access_point: Option<StationCounts>,
    /// Counters of the radio channel.
    pub radio: RadioCounts,
    /// Lateness of the frames written to interfaces.
    pub lateness: LatenessSummary,
    /// Longest turn of the event loop \[us\]: for so long a frame may have waited for being read.
    pub longest_turn_us: u64,
    /// Number of transmissions that are missing in the capture, because the disk did not take them in time.
    pub uncaptured: u64,
}

impl LabReport {
    /// Returns the environment variables of a command in a station: names and addresses of its laboratory.
    pub fn variables(&self, station: u16) -> Vec<(&'static str, String)> {
        let addresses: Vec<&str> = self.stations.iter().map(|station| station.address.as_str()).collect();
        vec![
            ("LAB_NAME", self.name.clone()),
            ("LAB_STATION", station.to_string()),
            ("LAB_STATIONS", addresses.len().to_string()),
            ("LAB_ADDRESS", addresses[usize::from(station)].to_owned()),
            ("LAB_ADDRESSES", addresses.join(",")),
            ("LAB_INTERFACE", self.interface.clone()),
        ]
    }

    /// Returns the counters of a laboratory at time `now`, as far as its medium knows them.
    pub fn of(lab: &Laboratory, medium: &Medium, lateness: &Lateness, now: Time) -> LabReport {
        let ns = now.as_nanos().max(1) as f64;
        let stations = (0..lab.stations).map(|station| {
            let (radio, refused) = medium.station_counts(station);
            StationReport {
                station,
                address: lab.address(station).to_string(),
                namespace: lab.namespace(station),
                radio,
                airtime: radio.airtime_ns as f64 / ns,
                unknown: refused.unknown,
                malformed: refused.malformed,
                ..StationReport::default()
            }
        });
        LabReport {
            name: lab.name.clone(),
            interface: lab.interface.clone(),
            seconds: now.as_secs(),
            stations: stations.collect(),
            access_point: medium.access_point_counts(),
            radio: medium.counts(now),
            lateness: lateness.summary(),
            ..LabReport::default()
        }
    }
}

/// Returns the datagrams that a station lost or missed, for the column of drops.
fn drops(counts: &StationCounts) -> u64 {
    counts.lost_queue + counts.lost_retries + counts.lost_collision
}

impl fmt::Display for LabReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "lab '{}': {}, {:.1} s, {:.1} % of the airtime used, {:.1} % by other networks",
            shown::value(&self.name),
            counted(self.stations.len(), "station"),
            self.seconds,
            100.0 * self.radio.airtime(),
            100.0 * self.radio.foreign_ns as f64 / self.radio.channel_ns.max(1) as f64
        )?;
        writeln!(
            f,
            "  {:<8} {:<15} {:>8} {:>8} {:>9} {:>8} {:>8} {:>8} {:>8} {:>6}",
            "station", "address", "sent", "received", "airtime", "collided", "retries", "dropped", "missed", "late"
        )?;
        let mut row = |name: &str, address: &str, counts: &StationCounts, airtime: f64, more: (u64, u64, bool)| {
            let (refused, late, gone) = more;
            let airtime = format!("{:.2} %", 100.0 * airtime);
            let missed = counts.missed_noise + counts.missed_range;
            let gone = if gone { "  its interface is gone" } else { "" };
            writeln!(
                f,
                "  {name:<8} {address:<15} {:>8} {:>8} {airtime:>9} {:>8} {:>8} {:>8} {missed:>8} {late:>6}{gone}",
                counts.offered,
                counts.received,
                counts.collided,
                counts.retries,
                drops(counts) + refused,
            )
        };
        for station in &self.stations {
            let more = (station.unknown + station.malformed + station.unwritten, station.late, station.gone);
            row(&station.station.to_string(), &station.address, &station.radio, station.airtime, more)?;
        }
        if let Some(counts) = &self.access_point {
            let airtime = counts.airtime_ns as f64 / self.radio.channel_ns.max(1) as f64;
            row("relay", "access point", counts, airtime, (0, 0, false))?;
        }
        let lateness = &self.lateness;
        write!(
            f,
            "  late     {} of {} deliveries came more than {} us late; median {} us, 99 % {} us, largest {} us",
            lateness.late, lateness.deliveries, lateness.limit_us, lateness.p50_us, lateness.p99_us, lateness.max_us
        )?;
        if self.longest_turn_us > lateness.limit_us {
            write!(f, "\n  late     frames may have waited {} us for being read", self.longest_turn_us)?;
        }
        if self.uncaptured > 0 {
            write!(f, "\n  capture  {} transmissions are missing: the disk was too slow", self.uncaptured)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ethernet;
    use murmurate::time::Span;

    #[test]
    fn a_table_has_every_station_and_says_what_was_late() {
        let lab = Laboratory::from_toml("stations = 2\n").unwrap();
        let mut medium = Medium::new(&lab);
        let bytes = [&ethernet::station(1)[..], &[0; 108]].concat();
        medium.take(Time::ZERO, 0, &bytes);
        let now = Time::ZERO + Span::from_millis(100);
        medium.wake(now);
        let mut lateness = Lateness::new(Span::from_millis(1));
        for delivery in medium.deliveries() {
            lateness.count(delivery.at, now);
        }
        let report = LabReport::of(&lab, &medium, &lateness, now);
        let text = report.to_string();
        assert_eq!(report.radio.arrived, 1);
        assert!(text.contains("10.77.0.2") && text.contains("access point"), "{text}");
        assert!(text.contains("1 of 1 deliveries came more than 1000 us late"), "{text}");
        let variables = report.variables(1);
        assert!(variables.contains(&("LAB_ADDRESS", "10.77.0.2".to_owned())), "{variables:?}");
        assert!(variables.contains(&("LAB_ADDRESSES", "10.77.0.1,10.77.0.2".to_owned())), "{variables:?}");
        let json = serde_json::to_string(&report).unwrap();
        assert_eq!(serde_json::from_str::<LabReport>(&json).unwrap(), report);
    }
}
