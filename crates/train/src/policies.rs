//! Policies of a configuration: that of each role with what its robots perceive, or one for all robots.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::channels::{Channels, Perception};
use super::config::{Config, Policy};
use super::roles::Role;
use murmurate::config::ConfigError;
use murmurate::deploy::check_name;
use murmurate::policy::hops::entry::Entry;
use murmurate::scenario::Scenario;

impl Config {
    /// Returns the policy of each role with the role's name, in the order of the roles; without roles the policy of
    /// all robots, with an empty name.
    pub fn policies(&self) -> Vec<(&str, Policy)> {
        if self.roles.is_empty() {
            return vec![("", self.policy.clone())];
        }
        let of_role = |role: &Role| {
            let (mut policy, role) = (self.policy.clone(), role.clone());
            policy.observation = role.observation.unwrap_or(policy.observation);
            policy.encoder = role.encoder.unwrap_or(policy.encoder);
            policy.message = role.message.unwrap_or(policy.message);
            policy.update = role.update.unwrap_or(policy.update);
            policy
        };
        self.roles.iter().map(|(name, role)| (name.as_str(), of_role(role))).collect()
    }

    /// Returns the index of the role of each robot, by its id; empty without roles.
    pub fn role_of_robots(&self) -> Vec<u8> {
        let robots = self.roles.values().map(|role| role.robots.len()).sum();
        let mut roles = vec![0; robots];
        for (index, role) in (0..).zip(self.roles.values()) {
            role.robots.iter().for_each(|robot| roles[usize::from(*robot)] = index);
        }
        roles
    }

    /// Returns the entries of the observations of all roles, each once. The critic observes them of each robot.
    pub fn observed(&self) -> Vec<Entry> {
        let mut observed = Vec::new();
        for (_, policy) in self.policies() {
            // In a team without roles an entry that is there twice is observed twice.
            let new = |entry: &Entry| self.roles.is_empty() || !observed.contains(entry);
            let entries: Vec<Entry> = policy.observation.iter().filter(|entry| new(entry)).cloned().collect();
            observed.extend(entries);
        }
        observed
    }

    /// Returns the observations of the roles in their order, and then that of the critic, if there are roles, joined
    /// with the channels of `scenarios` and with the senses. An error names the wrong setting of a sense, or the
    /// channel that a scenario has not.
    pub fn perceptions(&self, scenarios: &[Arc<dyn Scenario>]) -> Result<Vec<Perception>, ConfigError> {
        let perception = |entries: &[Entry]| {
            let channels = Channels::new(entries, &self.senses, scenarios)?;
            Ok(Perception { entries: entries.into(), channels })
        };
        let mut perceptions = Vec::new();
        for (name, policy) in self.policies() {
            let own = self.roles.get(name).is_some_and(|role| role.has("observation"));
            perceptions.push(perception(&policy.observation).map_err(|error| match error {
                ConfigError::Field { field, reason } if own && field == "policy.observation" => {
                    ConfigError::field(format!("roles.{name}.observation"), reason)
                }
                other => other,
            })?);
        }
        if !self.roles.is_empty() {
            perceptions.push(perception(&self.observed())?);
        }
        Ok(perceptions)
    }

    /// Checks that each robot has one role, and that the policies of all roles can be trained together. The error names
    /// the first wrong field.
    pub(super) fn check_roles(&self) -> Result<(), ConfigError> {
        if self.roles.is_empty() {
            return Ok(());
        }
        let wrong = |field: String, why: String| Err(ConfigError::field(field, why));
        if self.roles.len() > usize::from(u8::MAX) {
            return wrong("roles".to_owned(), format!("there are {} roles; at most 255", self.roles.len()));
        }
        let alone = "policies of roles are trained with one hop and without memory";
        if self.policy.hops > 1 {
            return wrong("policy.hops".to_owned(), format!("{}, but {alone}; set 1", self.policy.hops));
        }
        if self.policy.memory.is_some() {
            return wrong("policy.memory".to_owned(), format!("{alone}; leave it out"));
        }
        let robots: usize = self.curriculum.first().map_or(0, |stage| stage.groups[0].iter().sum());
        let mut taken: BTreeMap<u16, &str> = BTreeMap::new();
        for (name, role) in &self.roles {
            check_name("roles", name)?;
            let field = |field: &str| format!("roles.{name}.{field}");
            if role.robots.is_empty() {
                return wrong(field("robots"), "no robot has the role; name some, or leave it out".to_owned());
            }
            for robot in &role.robots {
                if usize::from(*robot) >= robots {
                    let why = format!("there is no robot {robot}; they are 0 to {}", robots - 1);
                    return wrong(field("robots"), why);
                }
                if let Some(other) = taken.insert(*robot, name) {
                    return wrong(field("robots"), format!("robot {robot} has the role '{other}' already"));
                }
            }
            let (floats, own) = (self.policy.encoder.last(), role.encoder.as_ref());
            if let Some(own) = own.filter(|own| own.last() != floats) {
                let why = format!(
                    "its last width is {}, and that of policy.encoder {}; robots of all roles broadcast as many floats",
                    own.last().unwrap_or(&0),
                    floats.unwrap_or(&0)
                );
                return wrong(field("encoder"), why);
            }
        }
        match (0..=u16::MAX).find(|robot| !taken.contains_key(robot)) {
            Some(robot) if usize::from(robot) < robots => {
                wrong("roles".to_owned(), format!("robot {robot} has none; name each robot in one role"))
            }
            _ => Ok(()),
        }
    }
}
