//! Scaling of the groups in a configuration to a team of another size.

use super::config::Config;
use murmurate::registry::Registry;
use murmurate::scenario::{ScenarioError, Settings};

impl Config {
    /// Returns the configuration with the weights that the scenario gives to terms of the reward (`scenario::Weights`),
    /// and with the `groups` of the curriculum scaled: the team sizes of each sum to the configured number of robots,
    /// or to the scenario's default if none is configured. They keep their proportions if the scenario supports teams
    /// of these sizes; otherwise the robots are split in another way, or not at all.
    ///
    /// # Errors
    /// If there is no such scenario, or it does not support that number of robots.
    pub fn scaled_for(mut self, scenario: &str, registry: &Registry) -> Result<Config, ScenarioError> {
        let settings = self.settings(None, None);
        let build = |robots| registry.scenario(scenario, &Settings { robots, ..settings });
        let scenario = build(self.robots)?;
        let robots = scenario.robots();
        self.reward = self.reward.weighted(scenario.weights());
        let supported = |size: usize| build(Some(size)).is_ok();
        for stage in &mut self.curriculum {
            for groups in &mut stage.groups {
                *groups = scaled(groups, robots, supported);
            }
        }
        Ok(self)
    }
}

/// Returns the sizes of groups scaled to a sum of `robots`.
fn scaled(groups: &[usize], robots: usize, supported: impl Fn(usize) -> bool) -> Vec<usize> {
    let total: usize = groups.iter().sum();
    if total == robots {
        return groups.to_vec();
    }
    // The cumulative sums are rounded, so that the sizes add up to the team.
    let sums = groups.iter().scan(0, |sum, size| {
        *sum += size;
        Some((*sum * robots + total / 2) / total)
    });
    let mut before = 0;
    let proportional: Vec<usize> = sums.map(|sum| sum - std::mem::replace(&mut before, sum)).collect();
    if proportional.iter().all(|size| supported(*size)) {
        return proportional;
    }
    // For two groups, the split nearest to the proportional one; of two equally near splits, the more even one.
    let split = |first: &usize| supported(*first) && supported(robots - first);
    let nearest =
        (1..robots).filter(split).min_by_key(|first| (first.abs_diff(proportional[0]), robots.abs_diff(2 * first)));
    match nearest {
        Some(first) if groups.len() == 2 => vec![first, robots - first],
        _ => vec![robots],
    }
}

#[cfg(test)]
mod tests {
    use super::scaled;

    #[test]
    fn groups_keep_their_proportions_where_the_scenario_supports_their_sizes() {
        let any = |size: usize| size > 0;
        assert_eq!(scaled(&[2, 3], 5, any), [2, 3]);
        assert_eq!(scaled(&[2, 3], 6, any), [2, 4]);
        assert_eq!(scaled(&[2, 3], 10, any), [4, 6]);
        assert_eq!(scaled(&[5], 8, any), [8]);
        assert_eq!(scaled(&[1, 1, 1], 9, any), [3, 3, 3]);
        let two_or_more = |size: usize| size >= 2;
        assert_eq!(scaled(&[2, 3], 3, two_or_more), [3], "a robot by itself is no team");
        assert_eq!(scaled(&[2, 3], 4, two_or_more), [2, 2]);
        let even = |size: usize| size >= 2 && size.is_multiple_of(2);
        assert_eq!(scaled(&[2, 3], 8, even), [4, 4]);
        assert_eq!(scaled(&[2, 3], 6, even), [2, 4]);
        assert_eq!(scaled(&[2, 3], 2, even), [2]);
    }
}
