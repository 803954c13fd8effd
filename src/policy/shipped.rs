//! The policies that come with the program, one a scenario that has one. `policies/README.md` says how they were made.

/// The file of the shipped policy for a scenario.
pub fn shipped(scenario: &str) -> Option<&'static [u8]> {
    match scenario {
        "passage" => Some(include_bytes!("../../policies/passage.safetensors")),
        _ => None,
    }
}

/// The file of the policy for a scenario that was trained for the paper's own conditions: lock step, perfect messages.
pub fn published(scenario: &str) -> Option<&'static [u8]> {
    match scenario {
        "passage" => Some(include_bytes!("../../policies/passage-published.safetensors")),
        _ => None,
    }
}
