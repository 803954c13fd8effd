//! Senses of a deployment: their checks, and the link that carries what they perceive.

use serde::Deserialize;

use super::{Deployment, Routes, Senses};
use crate::config::{self, ConfigError};
use crate::messages::ids::RobotId;
use crate::messages::wire::Kind;
use crate::registry::Registry;
use crate::scenario::TaskFile;
use crate::senses::{MAX_SENSES, Settings};

/// Longest name of a sense or a role \[characters\].
const MAX_NAME: usize = 40;

/// Checks a name in the table `table`. The error names the field.
pub fn check_name(table: &str, name: &str) -> Result<(), ConfigError> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    if (1..=MAX_NAME).contains(&name.len()) && name.chars().all(plain) {
        return Ok(());
    }
    let why = format!("a name is 1 to {MAX_NAME} of a-z, 0-9, '-' and '_'");
    Err(ConfigError::field(format!("{table}.{name}"), why))
}

/// Reads the tables `senses` of a file that has nothing else (TOML). An error names the line or the field.
pub fn senses_of(text: &str) -> Result<Senses, ConfigError> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct File {
        senses: Senses,
    }
    let File { senses } = config::from_toml(text)?;
    Ok(senses)
}

impl Deployment {
    /// Returns the deployment with these senses of all its robots. If what they perceive has to cross hosts and no link
    /// carries it, the link that carries readings does.
    pub fn with_senses(mut self, senses: Senses) -> Deployment {
        self.senses = senses;
        self.carrying_senses()
    }

    /// Returns the deployment with a link for what its robots perceive, if that has to cross hosts and no link carries
    /// it: that of the readings.
    pub(super) fn carrying_senses(mut self) -> Deployment {
        let carried = self.links.iter().any(|link| link.carries.contains(&Kind::Sensed));
        // The routes need a link for all that crosses, which the check of the deployment looks for.
        if !carried && Routes::of(&self).crosses(Kind::Sensed) {
            let link = self.links.iter_mut().find(|link| link.carries.contains(&Kind::Reading));
            link.into_iter().for_each(|link| link.carries.push(Kind::Sensed));
        }
        self
    }

    /// Returns the deployment with these senses, as `with_senses` does, after a check of the senses and of the result.
    /// An error names the wrong field; also if the deployment has senses already.
    pub fn perceiving(self, registry: &Registry, senses: Senses) -> Result<Deployment, ConfigError> {
        if senses.is_empty() {
            return Ok(self);
        }
        if !self.senses.is_empty() {
            let why = "the deployment has senses of its own; write all of them in one place";
            return Err(ConfigError::field("senses", why));
        }
        for (name, settings) in &senses {
            registry.sense(name, settings, RobotId(0)).map_err(|error| error.within("senses"))?;
        }
        let deployment = self.with_senses(senses);
        deployment.check()?;
        Ok(deployment)
    }

    /// Returns the deployment with the senses of a task file, if there is one, besides its own. Under a name that the
    /// deployment has, it keeps its own.
    pub fn for_task(mut self, file: Option<&TaskFile>) -> Deployment {
        let Some(file) = file.filter(|file| !file.senses().is_empty()) else { return self };
        for (name, settings) in file.senses() {
            self.senses.entry(name.clone()).or_insert_with(|| Settings::of_task(settings.clone()));
        }
        self.carrying_senses()
    }

    /// Checks number and names of the senses. An error names the field.
    pub(super) fn check_senses(&self) -> Result<(), ConfigError> {
        let names = self.sense_names();
        if names.len() > MAX_SENSES {
            let why = format!("{} of them; a team has at most {MAX_SENSES}", names.len());
            return Err(ConfigError::field("senses", why));
        }
        names.iter().try_for_each(|name| check_name("senses", name))
    }
}
