//! Flags for the size of a task and of its robots, shared by `sim`, `train` and the studies of policies.

use murmurate::deploy::Deployment;
use murmurate::scenario::{ScenarioError, Settings};
use murmurate_robot::BadInput;

/// Flags for the size of a task and of its robots.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct SizeFlags {
    /// Factor on the lengths of the task, such as ground, walls and places, but not on the robots, 0.05 to 20
    /// (docs/simulate.md#sizes) [default: as the configuration or the deployment says, or else 1; in 'swap' the hull by
    /// 0.16 m]
    #[arg(long)]
    pub scale: Option<f32>,
    /// Radius of a robot's hull [m], 0.01 to 0.85: two robots collide at two of them, and the task keeps 1.5625 of them
    /// free about a robot's centre [default: as the configuration or the deployment says, or else 0.16]
    #[arg(long)]
    pub hull_m: Option<f32>,
}

impl SizeFlags {
    /// Returns `settings` with the scale and the hull of the flags, where they are given.
    pub fn over(&self, settings: Settings) -> Settings {
        Settings { scale: self.scale.or(settings.scale), hull_m: self.hull_m.or(settings.hull_m), ..settings }
    }

    /// Returns the flags that are given, without `--`, each with its value.
    pub fn given(&self) -> impl Iterator<Item = (&'static str, String)> {
        let flags = [("scale", self.scale), ("hull-m", self.hull_m)];
        flags.into_iter().filter_map(|(flag, value)| Some((flag, value?.to_string())))
    }
}

/// Returns the error of a scenario that cannot be made from settings. It names the flag of the wrong setting, or the
/// `files`, each with the settings that it has, where the setting is from; `flags` are those of the command line.
pub fn refused(error: &ScenarioError, flags: &Settings, files: &[(&str, Settings)]) -> BadInput {
    let field = error.field();
    let has = |settings: &Settings| match field {
        "scale" => settings.scale.is_some(),
        "hull_m" => settings.hull_m.is_some(),
        "gap_m" => settings.gap_m.is_some(),
        "robots" => settings.robots.is_some(),
        _ => false,
    };
    match files.iter().find(|(_, settings)| has(settings)) {
        Some((file, _)) if !has(flags) => BadInput(format!("{file}: {field}: {error}")),
        _ => BadInput(format!("--{}: {error}", field.replace('_', "-"))),
    }
}

/// Returns the settings of the size of a team's task that a deployment file has.
pub fn of_file(deployment: Option<&Deployment>) -> Settings {
    deployment.map(Deployment::settings).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::scenario::build;

    #[test]
    fn an_error_names_the_flag_or_else_the_file() {
        let error = build("swap", &Settings { hull_m: Some(9.0), ..Settings::default() }).unwrap_err();
        let file = [("the deployment file 'd.toml'", Settings { hull_m: Some(9.0), ..Settings::default() })];
        let said = |flags: &Settings| refused(&error, flags, &file).to_string();
        assert!(said(&Settings::default()).starts_with("the deployment file 'd.toml': hull_m: the scenario 'swap'"));
        assert!(said(&file[0].1).starts_with("--hull-m: the scenario 'swap' takes 0.01 to 0.85 m, not 9"));
        let unknown = build("maze", &Settings::default()).unwrap_err();
        assert!(refused(&unknown, &Settings::default(), &file).to_string().starts_with("--scenario: there is no"));
    }
}
