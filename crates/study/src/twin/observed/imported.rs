//! The run of an imported record, which has one clock: measured states, beginnings of episodes, receipts.

use super::super::links::Crossing;
use super::places::Places;
use super::{Log, Run};
use murmurate::messages::ids::{HostId, LinkId};
use murmurate_record::receipt::Receipt;

impl Run {
    /// Returns the run of an imported record of `robots` robots. `period_ns` is the period of its states \[ns\].
    /// Receipts of messages that were sent while no robot was seen are left out, and counted.
    pub fn imported(log: &Log, robots: usize, period_ns: i64) -> Run {
        let episode_at = |ns: i64| log.begins.partition_point(|begin| *begin <= ns).saturating_sub(1) as u32;
        let mut run = Run::empty(robots, log.begins.len());
        run.move_robots(std::slice::from_ref(log), &|_, ns| Some(ns), &episode_at, period_ns);
        // By episode: the first and the last time at which a robot was seen.
        let mut spans: Vec<Option<[i64; 2]>> = vec![None; log.begins.len()];
        for state in &log.states {
            if let Some(span) = spans.get_mut(episode_at(state.at_ns) as usize) {
                let [first, last] = span.unwrap_or([state.at_ns; 2]);
                *span = Some([first.min(state.at_ns), last.max(state.at_ns)]);
            }
        }
        let places = Places::of_import(log, robots);
        let crossing = |receipt: &Receipt| {
            let episode = episode_at(receipt.sent_ns);
            let [first, last] = spans.get(episode as usize).copied().flatten()?;
            let seen = first.saturating_sub(period_ns)..=last.saturating_add(period_ns);
            let took_ns = match receipt.received_ns {
                Some(received_ns) => Some(received_ns.checked_sub(receipt.sent_ns)?),
                None => None,
            };
            let (link, from, to) = (LinkId(0), HostId(receipt.from), HostId(receipt.to));
            let distance_m = places.between(from, to, receipt.sent_ns);
            let crossing = Crossing { episode, link, from, to, took_ns, distance_m };
            seen.contains(&receipt.sent_ns).then_some(crossing)
        };
        run.crossings = log.receipts.iter().filter_map(crossing).collect();
        run.left_out = log.receipts.len() - run.crossings.len();
        run
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::lag::Moved;
    use super::super::State;
    use super::*;
    use murmurate_record::clocks::Traffic;

    #[test]
    fn receipts_of_an_import_count_only_while_its_robots_are_seen() {
        let still = Moved { velocity: [0.0; 2], command: [0.0; 2] };
        let state = |at_ns: i64| State { at_ns, robot: 0, place: [0.0; 2], moved: still, touches: false };
        let receipt = |sent_ns: i64, received_ns: Option<i64>| Receipt { from: 0, to: 1, sent_ns, received_ns };
        let log = Log {
            host: HostId(0),
            traffic: Traffic::default(),
            sent: Vec::new(),
            arrived: Vec::new(),
            states: [100, 110, 120, 300, 310].map(state).to_vec(),
            results: Vec::new(),
            begins: vec![100, 300],
            receipts: [(50, None), (105, Some(107)), (200, Some(202)), (305, Some(i64::MIN)), (311, None), (900, None)]
                .map(|(sent_ns, received_ns)| receipt(sent_ns, received_ns))
                .to_vec(),
            span: None,
            complete: true,
            has_gaps: false,
        };
        let run = Run::imported(&log, 2, 10);
        let kept: Vec<(u32, Option<i64>)> = run.crossings.iter().map(|one| (one.episode, one.took_ns)).collect();
        assert_eq!((kept, run.left_out), (vec![(0, Some(2)), (1, None)], 4));
    }
}
