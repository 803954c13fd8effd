//! Checks that every host, robot, link and kind of message named in a team file exists.

use std::collections::BTreeSet;

use super::layers::place;
use super::{TeamFile, kebab, only_robot, text};
use crate::config::ConfigError;
use crate::messages::ids::RobotId;

impl TeamFile {
    /// Checks that the hosts, robots, links and kinds of messages that occur in keys of the team file, such as
    /// `host.pc.policy`, exist in its deployment. An error names the field.
    pub(super) fn check_names(&self) -> Result<(), ConfigError> {
        let deployment = &self.deployment;
        let hosts: BTreeSet<&str> = deployment.hosts.iter().map(|host| host.name.as_str()).collect();
        let links: BTreeSet<&str> = deployment.links.iter().map(|link| link.name.as_str()).collect();
        if let Some(name) = hosts.iter().chain(&links).find(|name| name.contains('.')) {
            return Err(ConfigError::field("deployment", format!("the name '{name}' may have no dot in a team file")));
        }
        let known = |what: &str, names: &BTreeSet<&str>, name: &str| {
            let there = names.iter().copied().collect::<Vec<_>>().join(", ");
            let there = if there.is_empty() { "none".to_owned() } else { there };
            if names.contains(name) { Ok(()) } else { Err(format!("there is no {what} '{name}'; there are {there}")) }
        };
        for (key, entry) in self.layers.below("") {
            let parts: Vec<&str> = key.split('.').collect();
            let inner = if matches!(parts[0], "robot" | "host") { &parts[2..] } else { &parts[..] };
            let outer = match parts[..] {
                ["host", name, ..] => known("host", &hosts, name),
                ["robot", name, ..] => self.check_robot(name),
                _ => Ok(()),
            };
            let rest = match *inner {
                ["link", link, "transport"] => known("link", &links, link).and_then(|()| {
                    let found = self.registry.transport(text(entry)).map(drop);
                    found.map_err(|unknown| unknown.to_string())
                }),
                ["link", link, "reliability", kind] => {
                    known("link", &links, link).and_then(|()| self.check_carries(link, kind))
                }
                // A table that the link's transport defines.
                ["link", link, _, host] => known("link", &links, link).and_then(|()| known("host", &hosts, host)),
                ["link", link, ..] => known("link", &links, link),
                _ => Ok(()),
            };
            outer.and(rest).map_err(|why| ConfigError::field(place(key, &entry.origin), why))?;
        }
        Ok(())
    }

    fn check_robot(&self, name: &str) -> Result<(), String> {
        let robots = self.deployment.robots;
        let robot = name.parse::<u16>().ok().filter(|robot| robot.to_string() == name);
        let Some(robot) = robot.filter(|robot| usize::from(*robot) < robots) else {
            return Err(format!("there is no robot '{name}'; they are 0 to {}", robots - 1));
        };
        let host = self.host_of(RobotId(robot)).map_err(|error| error.to_string())?;
        let host = &self.deployment.hosts[usize::from(host.0)];
        match only_robot(&host.agents) {
            Some(_) => Ok(()),
            None => Err(format!("host '{0}' runs more robots than this; write [host.{0}]", host.name)),
        }
    }

    fn check_carries(&self, link: &str, kind: &str) -> Result<(), String> {
        let carries = self.deployment.links.iter().filter(|other| other.name == link).flat_map(|link| &link.carries);
        let kinds: Vec<String> = carries.map(|kind| kebab(*kind)).collect();
        if kinds.iter().any(|carried| carried == kind) {
            return Ok(());
        }
        Err(format!("link '{link}' does not carry '{kind}'; it carries {}", kinds.join(", ")))
    }
}
