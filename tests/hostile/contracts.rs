//! Readers of policies of format 3 and of roles: contracts, graphs, and what a process in Python says.
#![allow(dead_code)] // Each fuzz target uses one.

use std::path::Path;

use murmurate::deploy::{Deployment, roles_of};
use murmurate::registry::Registry;
use murmurate_onnx::Contract;
use murmurate_onnx::frames::{self, Kind};
use murmurate_onnx::network::ports;
use murmurate_onnx::parts::Parts;
use murmurate_onnx::structure::{Role, Structure};

fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}

/// A contract: read, with the arrays of its calls, and written as the greeting to a process.
pub fn contract(bytes: &[u8]) -> bool {
    let Some(Ok(contract)) = text(bytes).map(Contract::parse) else { return false };
    for role in [Role::Step, Role::Encode, Role::Relay, Role::Act] {
        let (inputs, outputs) = ports(&contract, role);
        assert!(inputs.iter().chain(&outputs).all(|port| !port.name.is_empty()));
    }
    assert!(frames::hello(&contract).is_ok());
    contract.interface().check().is_ok()
}

/// A graph: what it says of itself, held against a contract, and the contract in its metadata.
pub fn graph(bytes: &[u8]) -> bool {
    let contract = Contract::parse(include_str!("../onnx/data/recurrent.policy.toml")).expect("it is sound");
    let _ = Parts::of_graph(bytes.to_vec());
    Structure::read(bytes).is_ok_and(|structure| structure.check(&contract, Role::Step).is_ok())
}

/// Frames of the process of a policy in Python: its greeting and the outputs of a call.
pub fn python(bytes: &[u8]) -> bool {
    let contract = Contract::parse(include_str!("../onnx/data/recurrent.policy.toml")).expect("it is sound");
    let (_, outputs) = ports(&contract, Role::Step);
    let (mut rest, mut all_sound) = (bytes, !bytes.is_empty());
    while let Some((bytes, after)) = rest.split_first_chunk::<{ frames::HEAD }>() {
        let Ok(head) = frames::head(*bytes) else { return false };
        let Some((body, after)) = after.split_at_checked(head.body) else { return false };
        rest = after;
        all_sound &= match head.kind {
            kind if kind == Kind::Hello as u8 => frames::greeting(body).is_ok(),
            _ => frames::outputs(body, 1, &outputs).is_ok_and(|arrays| {
                arrays.iter().all(|array| array.shape.iter().product::<usize>() == array.values.len())
            }),
        };
    }
    all_sound && rest.is_empty()
}

/// Roles: read, and given to the robots of a deployment.
pub fn roles(bytes: &[u8]) -> bool {
    let registry = Registry::builtin();
    let Some(Ok(roles)) = text(bytes).map(|text| roles_of(&registry, text, Path::new("policies"))) else {
        return false;
    };
    let deployment = Deployment::preset("onboard-infra", 5).expect("it is a mode");
    deployment.in_roles(&registry, roles).is_ok()
}
