//! What a team costs: what a run has said and carried, per robot and second of its time. Who runs it measures the CPU.

use serde::{Deserialize, Serialize};

use super::trial::{Said, TrialReport};
use crate::messages::wire::{KINDS, Kind};

/// The same per robot and second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KindCost {
    /// The kind.
    pub kind: Kind,
    /// Messages published \[1/s\].
    pub messages: f64,
    /// Their bytes \[1/s\].
    pub bytes: f64,
}

/// What a run costs per robot and second of its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// The size of the team.
    pub robots: usize,
    /// How much time was simulated \[s\].
    pub virtual_s: f64,
    /// Messages published, of all kinds \[1/s\].
    pub messages: f64,
    /// Their bytes \[1/s\].
    pub bytes: f64,
    /// The same by kind.
    pub kinds: Vec<KindCost>,
    /// Datagrams that a host has taken in from a link \[1/s\].
    pub deliveries: f64,
    /// How long a robot's share of the frames was on the air, over all channels \[s/s\]; none without a radio.
    pub airtime: Option<f64>,
}

impl Cost {
    /// What a run of so many robots has cost per robot and second. It has to have been given a duration.
    pub fn of(robots: usize, report: &TrialReport) -> Cost {
        let virtual_s = report.simulated.as_secs();
        let each = |count: u64| count as f64 / (robots as f64 * virtual_s);
        let totals = &report.totals;
        let all = totals.said.iter().fold(Said::default(), |sum, said| Said {
            messages: sum.messages + said.messages,
            bytes: sum.bytes + said.bytes,
        });
        let kinds = KINDS.iter().zip(&totals.said);
        Cost {
            robots,
            virtual_s,
            messages: each(all.messages),
            bytes: each(all.bytes),
            kinds: kinds
                .map(|(&kind, said)| KindCost { kind, messages: each(said.messages), bytes: each(said.bytes) })
                .collect(),
            deliveries: each(totals.links.accepted),
            airtime: (totals.radio.channel_ns > 0).then(|| each(totals.radio.airtime_ns) * 1e-9),
        }
    }
}
