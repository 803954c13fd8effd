//! Files of the trained policies that are built into the program. `policies/README.md` describes how they were trained.

/// Names of the built-in trained policies, by which a user selects them: the default one of a scenario, the one that
/// was the default of the scenario `passage` before (trained for delay, loss and lag in teams of five at the most), the
/// one trained under the conditions of the paper (robots act in lock step, and every message arrives), and a former
/// name of the default one.
pub const NAMES: [&str; 4] = ["shipped", "robust", "published", "any-size"];

const PASSAGE: &[u8] = include_bytes!("../../policies/passage-any-size.safetensors");
const SWAP: &[u8] = include_bytes!("../../policies/swap-any-size.safetensors");

/// Returns the content of the built-in policy file named `name`, one of [`NAMES`], for the scenario named `scenario`.
/// `None` means that no such policy is built in.
pub fn built_in(name: &str, scenario: &str) -> Option<&'static [u8]> {
    match (name, scenario) {
        ("shipped" | "any-size", "passage") => Some(PASSAGE),
        ("shipped" | "any-size", "swap") => Some(SWAP),
        ("shipped", "four-rooms") => Some(include_bytes!("../../policies/four-rooms.safetensors")),
        ("shipped", "navigation") => Some(include_bytes!("../../policies/navigation.safetensors")),
        ("shipped", "coverage") => Some(include_bytes!("../../policies/coverage.safetensors")),
        ("shipped", "flocking") => Some(include_bytes!("../../policies/flocking-k3.safetensors")),
        ("robust", "passage") => Some(include_bytes!("../../policies/passage.safetensors")),
        ("published", "passage") => Some(include_bytes!("../../policies/passage-published.safetensors")),
        _ => None,
    }
}

/// Returns whether the shipped policy of the scenario named `scenario` is better than scripted navigation, by the
/// figures of `policies/README.md`. In `swap` it is faster for four robots, and for robots that lag on bad networks,
/// and slower or less successful for eight and more in other conditions.
pub(crate) fn is_best_for(scenario: &str) -> bool {
    matches!(scenario, "passage" | "flocking")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_policy_a_task_is_shipped_and_older_ones_keep_a_name() {
        for scenario in ["passage", "swap"] {
            assert_eq!(built_in("shipped", scenario), built_in("any-size", scenario), "{scenario}");
        }
        assert!(["passage", "flocking"].iter().all(|name| is_best_for(name) && built_in("shipped", name).is_some()));
        let passage: Vec<_> =
            NAMES[..3].iter().map(|name| built_in(name, "passage").expect("it is built in")).collect();
        assert!(passage[0] != passage[1] && passage[1] != passage[2] && passage[0] != passage[2]);
        assert!(built_in("shipped", "flocking").is_some() && built_in("robust", "swap").is_none());
    }
}
