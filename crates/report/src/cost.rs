//! Cost of a team per robot and simulated second: messages, bytes, deliveries and airtime.

use serde::{Deserialize, Serialize};

use murmurate::messages::wire::{KINDS, Kind};
use murmurate::report::TrialReport;
use murmurate::results::totals::Published;

/// Messages of one kind that actors published, per robot and simulated second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KindCost {
    /// Kind of message.
    pub kind: Kind,
    /// Published messages of this kind, per robot \[1/s\].
    pub messages: f64,
    /// Bytes of the published messages of this kind, without authentication tags, per robot \[1/s\].
    pub bytes: f64,
}

/// Communication cost of a run, per robot and simulated second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Number of robots.
    pub robots: usize,
    /// Simulated time of the run \[s\].
    pub virtual_s: f64,
    /// Published messages of all kinds, per robot \[1/s\].
    pub messages: f64,
    /// Bytes of the published messages of all kinds, without authentication tags, per robot \[1/s\].
    pub bytes: f64,
    /// Messages and bytes of each kind of message.
    pub kinds: Vec<KindCost>,
    /// Datagrams that hosts accepted from links, per robot \[1/s\].
    pub deliveries: f64,
    /// Airtime of the frames on all emulated radio channels, per robot \[s/s\]; `None` without a radio.
    pub airtime: Option<f64>,
}

impl Cost {
    /// Returns the cost of a run of `robots` robots from the report of its trial, whose simulated time must not be
    /// zero.
    pub fn of(robots: usize, report: &TrialReport) -> Cost {
        let virtual_s = report.simulated.as_secs();
        let each = |count: u64| count as f64 / (robots as f64 * virtual_s);
        let totals = &report.totals;
        let all = totals.published.iter().fold(Published::default(), |sum, published| Published {
            messages: sum.messages + published.messages,
            bytes: sum.bytes + published.bytes,
        });
        let kinds = KINDS.iter().zip(&totals.published);
        Cost {
            robots,
            virtual_s,
            messages: each(all.messages),
            bytes: each(all.bytes),
            kinds: kinds
                .map(|(&kind, published)| KindCost {
                    kind,
                    messages: each(published.messages),
                    bytes: each(published.bytes),
                })
                .collect(),
            deliveries: each(totals.links.accepted),
            airtime: (totals.radio.channel_ns > 0).then(|| each(totals.radio.airtime_ns) * 1e-9),
        }
    }
}
