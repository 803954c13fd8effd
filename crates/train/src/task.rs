//! Scenario of a training, whose task file is kept: a training that goes on has the task with which it began.

use std::sync::Arc;

use super::trainer::Plan;
use murmurate::registry::Registry;
use murmurate::scenario::{Scenario, ScenarioError};

impl Plan {
    /// Makes the scenario of the plan, from the text of the task file that the plan has, if it has one; otherwise the
    /// plan gets that text. Its configuration gets the senses of the file that the policy takes. Returns the registry
    /// that makes the same scenario in other sizes, too. An error says that there is no such scenario, or which setting
    /// it does not support.
    pub(super) fn scenario(&mut self, registry: &Registry) -> Result<(Registry, Arc<dyn Scenario>), ScenarioError> {
        let mut registry = registry.clone();
        if let Some(text) = &self.task {
            registry = registry.with_task_text(&self.scenario, text)?;
        }
        let scenario = registry.scenario(&self.scenario, &self.config.settings(self.config.robots, None))?;
        if let Some(file) = scenario.task_file() {
            self.task = Some(file.text().to_owned());
            registry = registry.with_task(&self.scenario, file.clone());
            self.config = self.config.clone().for_task(Some(file));
        }
        Ok((registry, scenario))
    }
}
