//! Files of the trained policies that are built into the program. `policies/README.md` says how they were made.

/// The file of the default policy for a scenario, if there is one.
pub fn shipped(scenario: &str) -> Option<&'static [u8]> {
    match scenario {
        "passage" => Some(include_bytes!("../../policies/passage.safetensors")),
        _ => None,
    }
}

/// The file of the policy for a scenario that was trained for the paper's conditions: lock step, perfect messages.
pub fn published(scenario: &str) -> Option<&'static [u8]> {
    match scenario {
        "passage" => Some(include_bytes!("../../policies/passage-published.safetensors")),
        _ => None,
    }
}
