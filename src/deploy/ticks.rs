//! Tick offsets that a deployment sets: times of agents' control ticks within their period.

use super::{Deployment, Host, Stepping};
use crate::config::ConfigError;
use crate::messages::ids::RobotId;
use crate::time::Span;

impl Deployment {
    /// Returns the time of an Agent's control ticks within their period, as the deployment sets it; `None` if it sets
    /// none or agents step at the same time. `first` is the Agent's robot with the smallest id.
    pub(crate) fn tick_offset(&self, first: RobotId) -> Option<Span> {
        let of = |host: &Host| {
            let agent = host.agents.iter().position(|robots| robots.iter().min() == Some(&first.0))?;
            host.tick_offsets_s.get(agent).copied()
        };
        self.hosts.iter().find_map(of).filter(|_| self.stepping == Stepping::Seeded).map(Span::from_secs)
    }
}

impl Host {
    /// Checks that the host has one tick offset for each of its agents or none, and that each is 0 to 1 s. An error
    /// names the field.
    pub(super) fn check_offsets(&self) -> Result<(), ConfigError> {
        let (offsets, agents) = (&self.tick_offsets_s, self.agents.len());
        let wrong = |reason: String| Err(ConfigError::field("host.tick_offsets_s", reason));
        if !offsets.is_empty() && offsets.len() != agents {
            return wrong(format!("{} of them on '{}', which has {agents} agents", offsets.len(), self.name));
        }
        match offsets.iter().find(|offset| !(0.0..=1.0).contains(*offset)) {
            Some(offset) => wrong(format!("{offset} on '{}' is not 0 to 1 s", self.name)),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_are_those_of_the_agents_in_their_order_and_wrong_ones_are_refused() {
        let mut deployment = Deployment::preset("onboard-adhoc", 2).unwrap();
        assert_eq!(deployment.tick_offset(RobotId(1)), None);
        deployment.hosts[1].tick_offsets_s = vec![0.02];
        assert_eq!(deployment.tick_offset(RobotId(1)), Some(Span::from_millis(20)));
        assert_eq!(Deployment::from_toml(&deployment.to_toml()), Ok(deployment.clone()));
        for wrong in [vec![0.0, 0.0], vec![-0.1]] {
            deployment.hosts[1].tick_offsets_s = wrong;
            assert!(deployment.check().unwrap_err().to_string().contains("tick_offsets_s"));
        }
    }
}
