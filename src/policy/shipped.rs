//! Files of the trained policies that are built into the program. `policies/README.md` describes how they were trained.

/// Names of the built-in trained policies, by which a user selects them: the default one of a scenario, the one trained
/// under the conditions of the paper arXiv 2111.01777 (robots act in lock step, and every message arrives), and the one
/// trained for teams of many sizes with the safety filter.
pub const NAMES: [&str; 3] = ["shipped", "published", "any-size"];

/// Returns the content of the built-in policy file named `name`, one of [`NAMES`], for the scenario named `scenario`.
/// `None` means that no such policy is built in.
pub fn built_in(name: &str, scenario: &str) -> Option<&'static [u8]> {
    match (name, scenario) {
        ("shipped", "passage") => Some(include_bytes!("../../policies/passage.safetensors")),
        ("shipped", "flocking") => Some(include_bytes!("../../policies/flocking-k3.safetensors")),
        ("published", "passage") => Some(include_bytes!("../../policies/passage-published.safetensors")),
        ("any-size", "passage") => Some(include_bytes!("../../policies/passage-any-size.safetensors")),
        ("any-size", "swap") => Some(include_bytes!("../../policies/swap-any-size.safetensors")),
        _ => None,
    }
}
