//! Comparison of several policies on the same episodes.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use crate::outcomes::CostOutcomes;
use crate::summary::Summary;
use murmurate::config::shown;
use murmurate::report::TrialReport;
use murmurate::scenario::judge::Verdict;

/// Results of several policies on the same episodes with the same seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Summary of each policy.
    pub(crate) policies: Vec<Summary>,
    /// Number of episodes in which only one policy succeeded, for each policy in the order of `policies`.
    pub(crate) alone_successful: Vec<usize>,
}

impl Comparison {
    /// Compares policies by their results; each entry of `results` has the summary of one policy and the reports of its
    /// trials.
    pub fn of(results: Vec<(Summary, Vec<TrialReport>)>) -> Comparison {
        let mut successful: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
        for (policy, (_, trials)) in results.iter().enumerate() {
            for episode in trials.iter().flat_map(|trial| &trial.episodes) {
                if episode.verdict == Verdict::Success {
                    successful.entry((episode.repeat, episode.episode)).or_default().push(policy);
                }
            }
        }
        let mut alone_successful = vec![0; results.len()];
        for policies in successful.values() {
            if let [policy] = policies[..] {
                alone_successful[policy] += 1;
            }
        }
        Comparison { policies: results.into_iter().map(|(summary, _)| summary).collect(), alone_successful }
    }
}

impl Comparison {
    /// Writes one line for each policy with its cost, in a scenario without goals.
    fn write_costs(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.policies.iter().map(|summary| summary.policy.len()).max().unwrap_or(0).max("policy".len());
        write!(f, "{:<width$}  {:>8}  {:>16}  {:>9}  failures", "policy", "cost", "95 %", "completed")?;
        for summary in &self.policies {
            let (policy, outcomes) = (shown::value(&summary.policy), &summary.outcomes);
            let Some(CostOutcomes { completed, cost_mean, cost_ci95: [low, high], .. }) = &outcomes.cost else {
                write!(f, "\n{policy:<width$}  {:>8}  {:>16}  {:>9}  {}", "-", "-", 0, outcomes.failures())?;
                continue;
            };
            let (within, failures) = (format!("{low:.4} to {high:.4}"), outcomes.failures());
            write!(f, "\n{policy:<width$}  {cost_mean:>8.4}  {within:>16}  {completed:>9}  {failures}")?;
        }
        let cost = self.policies.iter().find_map(|summary| summary.cost.as_ref());
        let cost = cost.map_or(String::new(), |cost| format!("mean {} [{}]", cost.name, cost.unit));
        write!(f, "\nThe episodes are the same; cost: {cost}.")
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for summary in &self.policies {
            writeln!(f, "{summary}\n")?;
        }
        if self.policies.iter().any(|summary| summary.outcomes.cost.is_some()) {
            return self.write_costs(f);
        }
        let width = self.policies.iter().map(|summary| summary.policy.len()).max().unwrap_or(0).max("policy".len());
        write!(f, "{:<width$}  {:>8}  {:>10}  {:>9}  failures", "policy", "success", "makespan", "it alone")?;
        for (summary, alone) in self.policies.iter().zip(&self.alone_successful) {
            let outcomes = &summary.outcomes;
            let makespan = outcomes.makespan_median_s.map_or("-".to_owned(), |median| format!("{median:.2} s"));
            let (policy, success) = (shown::value(&summary.policy), format!("{:.1} %", 100.0 * outcomes.success_rate));
            let failures = outcomes.failures();
            write!(f, "\n{policy:<width$}  {success:>8}  {makespan:>10}  {alone:>9}  {failures}")?;
        }
        write!(f, "\nThe episodes are the same; 'it alone': episodes in which no other of these policies succeeded.")
    }
}
