//! Size of a team's task, as its deployment has it.

use super::Deployment;
use crate::scenario;

impl Deployment {
    /// Returns the settings with which the scenario of this team is made: its robots, their hull, and the task's size.
    pub fn settings(&self) -> scenario::Settings {
        let Deployment { robots, gap_m, scale, hull_m, .. } = *self;
        scenario::Settings { robots: Some(robots), gap_m, scale, hull_m }
    }

    /// Returns the deployment with the width of the bottleneck, scale and hull of `settings`, where they are set.
    pub fn sized(self, settings: &scenario::Settings) -> Deployment {
        let (gap_m, scale) = (settings.gap_m.or(self.gap_m), settings.scale.or(self.scale));
        Deployment { gap_m, scale, hull_m: settings.hull_m.or(self.hull_m), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deployment_keeps_its_size_in_toml_and_a_setting_counts_before_it() {
        let small = scenario::Settings { hull_m: Some(0.06), ..scenario::Settings::default() };
        let deployment = Deployment::preset("offboard", 4).expect("a preset");
        assert!(!deployment.to_toml().contains("hull_m"), "what is not set is not written");
        let deployment = deployment.sized(&scenario::Settings { scale: Some(0.5), ..small });
        assert_eq!(Deployment::from_toml(&deployment.to_toml()).as_ref(), Ok(&deployment));
        let sized = deployment.sized(&scenario::Settings { hull_m: Some(0.08), ..small }).settings();
        assert_eq!((sized.robots, sized.scale, sized.hull_m), (Some(4), Some(0.5), Some(0.08)));
    }
}
