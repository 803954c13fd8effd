//! Policies of format 3: against a computation of their own in numpy, and what is refused. Scenario and
//! plant of JaxMARL's team are those of the crate in `tests/stranger`.

#[path = "../stranger/src/mpe.rs"]
mod mpe;
mod others;
mod parity;
#[cfg(test)]
#[path = "../stranger/src/recorded.rs"]
mod recorded;
mod refused;
#[path = "../stranger/src/spread.rs"]
mod spread;
mod team;

use std::path::{Path, PathBuf};

use murmurate_onnx::parts::Refused;
use murmurate_onnx::{Contract, Parts};

/// Returns the path of a file of the tests' data.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/onnx/data").join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(data(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn contract(name: &str) -> String {
    String::from_utf8(bytes(&format!("{name}.policy.toml"))).expect("it is text")
}

/// Puts a policy together from a contract whose graphs are in the tests' data.
fn parts(contract: &str) -> Result<Parts, Refused> {
    let read = |file: &str| -> Result<Vec<u8>, std::convert::Infallible> { Ok(bytes(file)) };
    let Ok(parts) = Parts::of_contract(contract, read);
    parts
}

#[test]
fn a_contract_is_written_and_read_again() {
    for name in ["recurrent", "field"] {
        let read = Contract::parse(&contract(name)).expect("it is sound");
        let json = serde_json::to_string(&read).expect("it is data");
        assert_eq!(Contract::parse(&json).expect("JSON as in metadata"), read);
    }
}
