//! Senses of a trial's robots, as its registry makes them.

use super::Trial;
use crate::config::ConfigError;
use crate::messages::ids::RobotId;
use crate::observation::{Channel, builtin};
use crate::senses::{Layout, Parts, Settings};

impl Trial {
    /// Returns the senses of a robot with their names, in the order of the names. An error names the wrong setting.
    pub(crate) fn senses(&self, robot: RobotId) -> Result<Vec<(String, Parts)>, ConfigError> {
        let make = |(name, settings): (&String, &Settings)| {
            let parts = self.registry.sense(name, settings, robot);
            Ok((name.clone(), parts.map_err(|error| error.within("senses"))?))
        };
        self.deployment.senses.iter().map(make).collect()
    }

    /// Returns the names and forms of the senses of each robot, in the order of the names. None are returned if the
    /// settings of one are wrong; the check of the trial refuses them.
    pub fn sense_layouts(&self) -> Vec<(String, Layout)> {
        let all = self.senses(RobotId(0)).unwrap_or_default();
        all.into_iter().map(|(name, parts)| (name, parts.layout)).collect()
    }

    /// Returns the channels of the observation that are senses.
    pub(super) fn sense_channels(&self) -> Vec<Channel> {
        let all = self.sense_layouts();
        all.iter().enumerate().map(|(index, (name, layout))| layout.channel(name, index)).collect()
    }

    /// Checks that each robot can have its senses, that they have the form of those of all others, and names that no
    /// channel has. An error names the wrong field.
    pub(super) fn check_senses(&self) -> Result<(), ConfigError> {
        if self.deployment.senses.is_empty() {
            return Ok(());
        }
        let wrong = |name: &str, why: String| Err(ConfigError::field(format!("senses.{name}"), why));
        let others = builtin::channels().into_iter().chain(self.scenario.channels());
        let taken: Vec<String> = others.map(|channel| channel.name.into_owned()).collect();
        if let Some(name) = self.deployment.senses.keys().find(|name| taken.contains(name)) {
            return wrong(name, "a channel of the observation has this name; take another".to_owned());
        }
        let first = self.senses(RobotId(0))?;
        for robot in RobotId::team(self.deployment.robots) {
            let real = self.deployment.hosts.iter().any(|host| host.actuates.contains(&robot.0));
            for ((name, parts), (_, of_first)) in self.senses(robot)?.iter().zip(&first) {
                if parts.layout != of_first.layout {
                    return wrong(name, format!("{robot} has another form of it than robot 0"));
                }
                if real && parts.worker.is_none() {
                    let kind = &self.deployment.senses[name].kind;
                    return wrong(name, format!("'{kind}' is simulated, and {robot} is real; take 'program'"));
                }
            }
        }
        Ok(())
    }
}
