//! Policies of others against their frameworks: records of what each answers there (`examples/others/*/reference.py`).

use std::path::{Path, PathBuf};

use murmurate_onnx::engine::{self, Array};
use murmurate_onnx::{Contract, Network, Parts, check};
use serde::Deserialize;
use serde_json::{Map, Value};

/// Largest difference of an output in the unit of its framework, relative above 1.
const TOLERANCE: f32 = 1e-5;

/// Steps of a team, in which states and messages go on from step to step.
#[derive(Deserialize)]
struct Record {
    robots: usize,
    steps: Vec<Step>,
}

#[derive(Deserialize)]
struct Step {
    /// Whether states and messages are at their start.
    reset: bool,
    robots: Vec<Robot>,
}

/// Inputs and answers of one robot.
#[derive(Deserialize)]
struct Robot {
    /// Inputs by their names, without the axis of robots.
    given: Map<String, Value>,
    /// Robots whose messages of the step before it hears.
    near: Vec<usize>,
    /// First values of outputs by their names.
    expected: Map<String, Value>,
}

/// Returns the shape and the values of nested lists.
fn array(value: &Value) -> Array {
    let Value::Array(list) = value else {
        return Array { shape: Vec::new(), values: vec![value.as_f64().expect("a number") as f32] };
    };
    let parts: Vec<Array> = list.iter().map(array).collect();
    let shape = std::iter::once(parts.len()).chain(parts.first().map_or(Vec::new(), |part| part.shape.clone()));
    Array { shape: shape.collect(), values: parts.iter().flat_map(|part| part.values.clone()).collect() }
}

fn of_one(array: Array) -> Array {
    Array { shape: [&[1], array.shape.as_slice()].concat(), ..array }
}

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/others").join(name)
}

pub fn parts(contract: &str) -> Parts {
    let path = folder(&format!("{contract}.policy.toml"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let read = |file: &str| std::fs::read(path.with_file_name(file));
    Parts::of_contract(&text, read).expect("its files are there").expect("they fit")
}

/// Returns the messages that a robot hears as an input, with as many places as the contract says.
fn heard(contract: &Contract, near: &[usize], said: &[Vec<f32>]) -> [Array; 2] {
    let (floats, places) = (contract.message.floats, near.len().max(1));
    let mut messages: Vec<f32> = near.iter().flat_map(|&other| said[other].clone()).collect();
    messages.resize(places * floats, 0.0);
    let mut taken = vec![1.0; near.len()];
    taken.resize(places, 0.0);
    [Array { shape: vec![1, places, floats], values: messages }, Array { shape: vec![1, places], values: taken }]
}

/// Runs a team through a record, and returns the largest difference of an output. `unit` is the value that 1 of the
/// framework stands for.
fn difference(contract: &str, record: &Record, unit: f32) -> f32 {
    let parts = parts(contract);
    let Parts { contract, graphs, .. } = &parts;
    let [graph] = &graphs[..] else { panic!("it is one graph") };
    let names = |ports: &[murmurate_onnx::structure::Port]| ports.iter().map(|port| port.name.clone()).collect();
    let (inputs, outputs): (Vec<String>, Vec<String>) =
        (names(&graph.structure.inputs), names(&graph.structure.outputs));
    let engine = engine::load(graph.bytes.clone(), &inputs, &outputs).expect("it loads");
    let start = |floats: usize| vec![vec![0.0_f32; floats]; record.robots];
    let (mut states, mut said) = (start(contract.state_floats()), start(contract.message.floats));
    let mut worst = 0.0_f32;
    for step in &record.steps {
        if step.reset {
            (states, said) = (start(contract.state_floats()), start(contract.message.floats));
        }
        let before = said.clone();
        for (robot, entry) in step.robots.iter().enumerate() {
            let [messages, taken] = heard(contract, &entry.near, &before);
            let input = |name: &String| match (name.as_str(), entry.given.get(name)) {
                (_, Some(value)) => of_one(array(value)),
                ("messages", _) => messages.clone(),
                ("heard", _) => taken.clone(),
                ("state", _) => of_one(Array { shape: vec![states[robot].len()], values: states[robot].clone() }),
                ("own_message", _) => of_one(Array { shape: vec![before[robot].len()], values: before[robot].clone() }),
                (other, _) => panic!("the record has no '{other}'"),
            };
            let found = engine.run(&inputs.iter().map(input).collect::<Vec<_>>()).expect("it runs");
            for (name, found) in outputs.iter().zip(found) {
                let expected = entry.expected.get(name).map_or(Vec::new(), |value| array(value).values);
                // Of a long message a few floats of all parts are recorded.
                let stride = if name == "message" { found.values.len() / expected.len().max(1) } else { 1 };
                for (one, other) in found.values.iter().step_by(stride.max(1)).zip(&expected) {
                    worst = worst.max((one - other).abs() / other.abs().max(unit));
                }
                match name.as_str() {
                    "message" => said[robot] = found.values,
                    "state_next" => states[robot] = found.values,
                    _ => assert!(!expected.is_empty(), "the record has '{name}'"),
                }
            }
        }
    }
    worst
}

fn read(path: &Path) -> Record {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_slice(&bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Policies, each with the name of its record, and the value of an output that 1 of its framework stands for.
const POLICIES: [(&str, &str, f32); 5] = [
    ("gcbfplus/single", "gcbfplus-single", 1.0),
    // Accelerations in m/s2.
    ("gcbfplus/double", "gcbfplus-double", 2.5),
    ("jaxmarl/spread", "jaxmarl-spread", 1.0),
    ("sizes/filter", "sizes-filter", 1.0),
    ("sizes/embedding", "sizes-embedding", 1.0),
];

/// The records in the repository have some 60 steps; with the variable `RECORDS`, a folder with longer ones.
#[test]
fn policies_of_others_answer_as_in_their_frameworks() {
    let folder = std::env::var_os("RECORDS").map_or_else(|| super::data("others"), PathBuf::from);
    for (policy, record, unit) in POLICIES {
        let record = read(&folder.join(format!("{record}.json")));
        assert!(record.steps.len() >= 60, "{policy}");
        let worst = difference(policy, &record, unit);
        println!("{policy}: {} steps, at most {worst:.1e} apart", record.steps.len());
        assert!(worst <= TOLERANCE, "{policy}: {worst:e}");
    }
}

#[test]
fn policies_of_others_pass_the_check_of_the_program() {
    for (policy, ..) in POLICIES {
        let network = std::sync::Arc::new(Network::load(parts(policy)).expect("it loads"));
        check::check(&network).unwrap_or_else(|why| panic!("{policy}: {why}"));
    }
}
