//! Roles: robots of a team that have a policy, a radius, a drive or senses of their own.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::senses::check_name;
use super::{Deployment, Senses};
use crate::chassis;
use crate::config::{self, ConfigError};
use crate::messages::ids::RobotId;
use crate::policy::Models;
use crate::registry::Registry;
use crate::senses::Settings as SenseSettings;

/// Settings of the robots of one role; those that are left out are the team's.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Role {
    /// Ids of the robots that have the role; a robot has at most one.
    pub robots: Vec<u16>,
    /// Policy of these robots: path of a file, from the folder of the file that has the role, or a name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<PathBuf>,
    /// Distance within which these robots hear their neighbours \[m\]; that of their policy if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius_m: Option<f32>,
    /// Chassis and hardware limits of these robots; what is left out is as for all robots.
    #[serde(default, skip_serializing_if = "chassis::Settings::is_empty")]
    pub body: chassis::Settings,
    /// Senses of these robots, beside those of all robots; one with the same name takes the place of that of all.
    #[serde(default, skip_serializing_if = "Senses::is_empty")]
    pub senses: Senses,
}

/// Roles of a team, by their names.
pub type Roles = BTreeMap<String, Role>;

/// Reads the tables `roles` of a file that has nothing else (TOML). Paths of policies start from `folder`. An error
/// names the line or the field.
pub fn roles_of(registry: &Registry, text: &str, folder: &Path) -> Result<Roles, ConfigError> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct File {
        roles: Roles,
    }
    let File { roles } = config::from_toml(text)?;
    Ok(placed(registry, roles, folder))
}

/// Returns the roles with paths of policies that start from `folder`; names of policies stay.
pub(super) fn placed(registry: &Registry, mut roles: Roles, folder: &Path) -> Roles {
    for policy in roles.values_mut().filter_map(|role| role.policy.as_mut()) {
        if policy.to_str().is_none_or(|name| registry.policy(name).is_none()) {
            *policy = folder.join(&*policy);
        }
    }
    roles
}

impl Deployment {
    /// Returns the deployment with these roles of its robots, after a check of the roles and of the result. An error
    /// names the wrong field; also if the deployment has roles already.
    pub fn in_roles(mut self, registry: &Registry, roles: Roles) -> Result<Deployment, ConfigError> {
        if roles.is_empty() {
            return Ok(self);
        }
        if !self.roles.is_empty() {
            let why = "the deployment has roles of its own; write all of them in one place";
            return Err(ConfigError::field("roles", why));
        }
        for (role, Role { robots, senses, .. }) in &roles {
            let robot = RobotId(robots.first().copied().unwrap_or(0));
            let check = |(name, settings): (&String, &SenseSettings)| registry.sense(name, settings, robot).map(drop);
            let within = |error: ConfigError| error.within("senses").within(role).within("roles");
            senses.iter().try_for_each(check).map_err(within)?;
        }
        self.roles = roles;
        let deployment = self.carrying_senses();
        deployment.check()?;
        Ok(deployment)
    }

    /// Returns the deployment of a file in `folder`, from which the paths of its roles' policies start.
    pub fn from_folder(self, registry: &Registry, folder: &Path) -> Deployment {
        Deployment { roles: placed(registry, self.roles, folder), ..self }
    }

    /// Returns the role of a robot with its name; `None` if it has none.
    pub fn role_of(&self, robot: RobotId) -> Option<(&str, &Role)> {
        let found = self.roles.iter().find(|(_, role)| role.robots.contains(&robot.0));
        found.map(|(name, role)| (name.as_str(), role))
    }

    /// Returns the distance within which a robot hears its neighbours \[m\]: that of its role, or that of its policy.
    pub fn radius_m(&self, robot: RobotId, models: &Models) -> f32 {
        let of_role = self.role_of(robot).and_then(|(_, role)| role.radius_m);
        of_role.unwrap_or_else(|| models.of(robot).interface().radius_m)
    }

    /// Returns the names of the senses of any robot. The index of a sense in messages is its place among them.
    pub fn sense_names(&self) -> BTreeSet<&str> {
        let own = self.roles.values().flat_map(|role| role.senses.keys());
        self.senses.keys().chain(own).map(String::as_str).collect()
    }

    /// Returns the senses of a robot: the index, the name and the settings of each, in the order of their indices.
    pub fn senses_of(&self, robot: RobotId) -> Vec<(u8, &str, &SenseSettings)> {
        let own = self.role_of(robot).map(|(_, role)| &role.senses);
        let settings = |name: &str| own.and_then(|own| own.get(name)).or_else(|| self.senses.get(name));
        // The check refuses more senses than indices.
        let all = (0..=u8::MAX).zip(self.sense_names());
        all.filter_map(|(index, name)| Some((index, name, settings(name)?))).collect()
    }

    /// Checks names, robots, radii and drives of the roles. An error names the field.
    pub(super) fn check_roles(&self) -> Result<(), ConfigError> {
        let mut taken: BTreeMap<u16, &str> = BTreeMap::new();
        for (name, Role { robots, radius_m, .. }) in &self.roles {
            let wrong = |field: &str, why: String| {
                let error = ConfigError::field(field, why);
                Err(error.within(name).within("roles"))
            };
            check_name("roles", name)?;
            if robots.is_empty() {
                return wrong("robots", "no robot has the role; name some, or leave it out".to_owned());
            }
            for robot in robots {
                if usize::from(*robot) >= self.robots {
                    return wrong("robots", format!("there is no robot {robot}; they are 0 to {}", self.robots - 1));
                }
                if let Some(other) = taken.insert(*robot, name) {
                    return wrong("robots", format!("robot {robot} has the role '{other}' already"));
                }
            }
            if radius_m.is_some_and(|radius_m| !(radius_m > 0.0 && radius_m.is_finite())) {
                return wrong("radius_m", "it is not above zero".to_owned());
            }
        }
        Ok(())
    }
}
