//! Task files that are built into the library, so that a program has their tasks without a file.

/// Name and text (TOML) of each: those of the benchmark `study commbench`, from `examples/tasks/`.
pub const BUILT_IN: [(&str, &str); 2] = [
    ("four-rooms", include_str!("../../../examples/tasks/four-rooms.toml")),
    ("navigation", include_str!("../../../examples/tasks/navigation.toml")),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry::Registry;
    use crate::scenario::Settings;

    #[test]
    fn every_built_in_task_makes_a_scenario_of_its_name() {
        for (name, text) in BUILT_IN {
            let registry = Registry::builtin().with_task_text(name, text).expect("a sound file");
            assert_eq!(registry.scenario(name, &Settings::default()).expect("a scenario").name(), name);
        }
    }
}
