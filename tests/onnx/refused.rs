//! Refusals of policies when they are loaded, each one sentence that names the field or the tensor.

use std::sync::Arc;

use murmurate::random::Seed;
use murmurate_onnx::Network;
use murmurate_onnx::check;
use murmurate_onnx::structure::Structure;
use rand::RngExt;

/// Returns why a contract with this change is refused.
fn refusal(name: &str, from: &str, to: &str) -> String {
    let text = super::contract(name);
    assert!(text.contains(from), "the contract has {from:?}");
    of(&text.replacen(from, to, 1))
}

fn of(text: &str) -> String {
    let loaded = super::parts(text).and_then(Network::load).map(Arc::new);
    match loaded.and_then(|network| check::check(&network)) {
        Ok(_) => panic!("it is not refused: {text}"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn a_contract_that_does_not_fit_its_graph_is_refused_with_both_sides() {
    let cases = [
        ("format = 3", "format = 4", "its contract: format: 4; this program reads contracts of format 3"),
        ("rate_hz = 20", "rate_hz = 5", "its contract: rate_hz: 5 is not 10 to 1000"),
        (
            "[observation.goal]",
            "[observation.target]",
            "its input 'goal' is no observation of the contract, and none of ",
        ),
        ("shape = [2]", "shape = [3]", "its input 'goal' is [2] a robot: the contract says [3]"),
        ("\"age\"]", "\"age\", \"distance\"]", "its input 'edges' takes 5 floats a neighbour: the contract makes 6"),
        ("floats = 6", "floats = 7", "its input 'messages' takes 6 floats a neighbour: the contract makes 7"),
        (
            "[message]\nfloats = 6",
            "[message]\nfloats = 0",
            "it takes an input 'messages', and the contract has no message",
        ),
        ("floats = 12", "floats = 13", "its input 'state' is [12] a robot: the contract says [13]"),
        (
            "unit = \"m/s\"\nframe = \"policy\"\nlimit",
            "unit = \"m\"\nframe = \"policy\"\nlimit",
            "its contract: action.unit: it has to be m/s for this kind",
        ),
        ("limit = 1.5", "", "its contract: action.limit: it is missing or not above zero"),
        ("hold_s = 0.2", "hold_s = 0.01", "its contract: hold_s: 0.01 is not one period to 60 s"),
        ("after_gap_s = 0.5", "after_gap_s = 0.01", "its contract: state.after_gap_s: 0.01 is less than one period"),
        ("max_neighbours = 4", "max_neighbours = 0", "its contract: max_neighbours: 0 is not 1 to 64"),
        (
            "graph = \"recurrent.onnx\"",
            "",
            "its contract: graph: it is missing: the file of the graph, beside this one",
        ),
        ("max_neighbours = 4", "sha256 = \"00\"", "its contract: sha256: the graphs are not those of the contract"),
        ("kind = \"velocity\"", "kind = \"choice\"", "its contract: action.unit: a choice has none"),
        (
            "max_neighbours = 4",
            "max_neighbors = 4",
            "its contract: line 7, column 1 (max_neighbors): unknown field `max_neighbors`",
        ),
    ];
    for (from, to, expected) in cases {
        let found = refusal("recurrent", from, to);
        assert!(found.starts_with(expected), "{found}\nfor {to:?}, expected {expected}");
        assert!(!found.contains('\n'), "{found}");
    }
}

const PLAIN: &str = r#"
format = 3
name = "bad"
graph = "GRAPH"
rate_hz = 20
radius_m = 2.0
hold_s = 0.2
[observation.goal]
source = "goal-minus-position"
shape = [2]
unit = "m"
frame = "policy"
[action]
kind = "velocity"
unit = "m/s"
limit = 1.0
"#;

#[test]
fn what_only_a_run_shows_is_found_by_a_run() {
    let nobody = of(&PLAIN.replace("GRAPH", "bad-nobody.onnx"));
    assert_eq!(nobody, "its graph: with no neighbour its output 'action' is not finite");
    let chance = of(&PLAIN.replace("GRAPH", "bad-chance.onnx"));
    assert!(chance.starts_with("its operator 'RandomNormalLike' is not in the list"), "{chance}");
}

#[test]
fn a_graph_that_is_cut_off_or_changed_is_read_or_refused_by_a_sentence() {
    let whole = super::bytes("recurrent.onnx");
    let contract = super::contract("recurrent");
    let mut stream = Seed::of_run(4).stream("mutations");
    let (mut refused, count) = (0, 3000);
    for at in 0..count {
        let mut bytes = whole.clone();
        if at % 3 == 0 {
            bytes.truncate(stream.random_range(0..whole.len()));
        } else {
            for _ in 0..1 + at % 4 {
                let place = stream.random_range(0..bytes.len());
                bytes[place] = stream.random_range(0..=255);
            }
        }
        let read = |_: &str| -> Result<Vec<u8>, std::convert::Infallible> { Ok(bytes.clone()) };
        let Ok(parts) = murmurate_onnx::Parts::of_contract(&contract, read);
        let checked = parts.and_then(|parts| {
            let graph = &parts.graphs[0];
            Ok(graph.structure.check(&parts.contract, graph.role)?)
        });
        // What runs is run in a process of its own, with limits: tests/cli/onnx.rs.
        if let Err(error) = checked {
            let said = error.to_string();
            assert!(!said.contains('\n') && said.len() < 400, "{said}");
            refused += 1;
        }
    }
    assert!((count / 4..count).contains(&refused), "{refused} of {count}: some change a weight alone");
}

#[test]
fn what_is_no_onnx_file_is_refused() {
    for bytes in [&b""[..], b"format = 3", &[0xff; 100], &[0x0a, 0xff, 0xff, 0xff, 0xff, 0x0f]] {
        let said = Structure::read(bytes).expect_err("it is none").to_string();
        assert!(said.starts_with("it is no ONNX file"), "{said}");
    }
}

#[test]
fn a_contract_and_a_graph_that_do_not_agree_on_ids_are_refused() {
    let table = "[robots]\nid = \"one-hot\"\n";
    let cases = [
        ("id-one-hot", table, "", "it takes an input 'id', and the contract has no table [robots]"),
        (
            "silent",
            "[edges]",
            "[robots]\nid = \"number\"\n[edges]",
            "its contract has a table [robots], and no graph has an",
        ),
        ("id-one-hot", "\"one-hot\"", "\"number\"", "its input 'id' is [3] a robot: the contract says [1]"),
        ("id-one-hot", "\"one-hot\"", "\"one-hot\"\nmost = 4", "its input 'id' is [3] a robot: the contract says [4]"),
        ("id-one-hot", "\"one-hot\"", "\"one-hot\"\nmost = 0", "its contract: robots.most: 0 is not 1 to 4096"),
        (
            "id-one-hot",
            "graph = \"id-one-hot.onnx\"",
            "python = \"a:B\"",
            "its contract: robots.most: it is missing: the number of robots of the largest team",
        ),
        ("id-one-hot", "[observation.goal]", "[observation.id]", "its contract: observation.id: the names messages, "),
    ];
    for (name, from, to, expected) in cases {
        let found = refusal(name, from, to);
        assert!(found.starts_with(expected), "{found}\nfor {to:?}, expected {expected}");
    }
}
