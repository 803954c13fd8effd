//! Files of the trained policies that are built into the program. `policies/README.md` describes how they were trained.

/// Returns the content of the policy file of the default trained policy for the scenario named `scenario`. `None` means
/// that no such policy is built in.
pub fn shipped(scenario: &str) -> Option<&'static [u8]> {
    match scenario {
        "passage" => Some(include_bytes!("../../policies/passage.safetensors")),
        "flocking" => Some(include_bytes!("../../policies/flocking-k3.safetensors")),
        _ => None,
    }
}

/// Returns the content of the policy file trained for teams of any size, with the safety filter and without it, for the
/// scenario named `scenario`. `None` means that no such policy is built in.
pub fn any_size(scenario: &str) -> Option<&'static [u8]> {
    match scenario {
        "passage" => Some(include_bytes!("../../policies/passage-any-size.safetensors")),
        _ => None,
    }
}

/// Returns the content of the policy file trained under the conditions of the paper arXiv 2111.01777: robots act in
/// lock step, and every message arrives. `scenario` is the scenario's name; `None` means that no such policy is built
/// in.
pub fn published(scenario: &str) -> Option<&'static [u8]> {
    match scenario {
        "passage" => Some(include_bytes!("../../policies/passage-published.safetensors")),
        _ => None,
    }
}
