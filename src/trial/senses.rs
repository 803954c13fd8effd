//! Senses of a trial's robots, as its registry makes them.

use std::collections::BTreeMap;

use super::Trial;
use crate::config::ConfigError;
use crate::messages::ids::RobotId;
use crate::observation::{Channel, builtin};
use crate::senses::{Layout, Parts, Settings};

impl Trial {
    /// Returns the senses of a robot with their indices and names, in the order of the indices. An error names the
    /// wrong setting.
    pub(crate) fn senses(&self, robot: RobotId) -> Result<Vec<(u8, String, Parts)>, ConfigError> {
        let make = |(index, name, settings): (u8, &str, &Settings)| {
            let parts = self.registry.sense(name, settings, robot).map_err(|error| {
                let role = self.deployment.role_of(robot).filter(|(_, role)| role.senses.contains_key(name));
                let within = error.within("senses");
                match role {
                    Some((role, _)) => within.within(role).within("roles"),
                    None => within,
                }
            });
            Ok((index, name.to_owned(), parts?))
        };
        self.deployment.senses_of(robot).into_iter().map(make).collect()
    }

    /// Returns the names and forms of the senses of any robot, in the order of their indices. None are returned if the
    /// settings of one are wrong; the check of the trial refuses them.
    pub fn sense_layouts(&self) -> Vec<(String, Layout)> {
        let of_robot = |robot| self.senses(robot).unwrap_or_default();
        let all = RobotId::team(self.deployment.robots).flat_map(of_robot);
        let by_index: BTreeMap<u8, _> = all.map(|(index, name, parts)| (index, (name, parts.layout))).collect();
        by_index.into_values().collect()
    }

    /// Returns the number of values of one measurement of each sense of each robot, together.
    pub fn sensed_values(&self) -> usize {
        let of_robot = |robot| self.senses(robot).unwrap_or_default();
        let all = RobotId::team(self.deployment.robots).flat_map(of_robot);
        all.map(|(_, _, parts)| parts.layout.floats()).sum()
    }

    /// Returns the channels of the observation that are senses of a robot.
    pub(super) fn sense_channels(&self, robot: RobotId) -> Vec<Channel> {
        let all = self.senses(robot).unwrap_or_default();
        all.iter().map(|(index, name, parts)| parts.layout.channel(name, usize::from(*index))).collect()
    }

    /// Checks that each robot can have its senses, that they have the form of those of all others, and names that no
    /// channel has. An error names the wrong field.
    pub(super) fn check_senses(&self) -> Result<(), ConfigError> {
        let names = self.deployment.sense_names();
        if names.is_empty() {
            return Ok(());
        }
        let wrong = |name: &str, why: String| Err(ConfigError::field(format!("senses.{name}"), why));
        let others = builtin::channels().into_iter().chain(self.scenario.channels());
        let taken: Vec<String> = others.map(|channel| channel.name.into_owned()).collect();
        if let Some(name) = names.iter().find(|name| taken.iter().any(|taken| taken == *name)) {
            return wrong(name, "a channel of the observation has this name; take another".to_owned());
        }
        let mut forms: BTreeMap<u8, (RobotId, Layout)> = BTreeMap::new();
        for robot in RobotId::team(self.deployment.robots) {
            let real = self.deployment.hosts.iter().any(|host| host.actuates.contains(&robot.0));
            let of_robot = self.deployment.senses_of(robot);
            for ((index, name, parts), (_, _, Settings { kind, .. })) in self.senses(robot)?.iter().zip(of_robot) {
                let (first, layout) = forms.entry(*index).or_insert_with(|| (robot, parts.layout.clone()));
                if parts.layout != *layout {
                    return wrong(name, format!("{robot} has another form of it than {first}; take another name"));
                }
                if real && parts.worker.is_none() {
                    let other = "give it another kind in the team file, such as 'program'";
                    return wrong(name, format!("'{kind}' is simulated, and {robot} is real: {other}"));
                }
            }
        }
        Ok(())
    }
}
