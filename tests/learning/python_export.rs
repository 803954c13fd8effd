//! Policy files written by Python, as `docs/bring-your-policy.md` shows, load and answer as they did there.
//!
//! `tests/data/export.py` generated the files and the expected outputs.

use std::path::Path;
use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::observation::Observation;
use murmurate::policy::file;
use murmurate::policy::gnn::{Gnn, GnnWeights};
use murmurate::policy::manifest::{Architecture, EdgeField};
use murmurate::policy::weights::WeightsError;
use murmurate::policy::{Draw, Model, Neighbour, Policy};
use murmurate::time::Span;

/// Case of a fully connected team: inputs, messages and actions, one entry per robot.
#[derive(serde::Deserialize)]
struct Case {
    position: Vec<[f32; 2]>,
    velocity: Vec<[f32; 2]>,
    goal: Vec<[f32; 2]>,
    /// Ages by robot, then by neighbour \[ms\].
    age_ms: Vec<Vec<u64>>,
    latent: Vec<Vec<f32>>,
    output: Vec<[f32; 4]>,
}

fn read(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(name);
    std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn text(name: &str) -> String {
    String::from_utf8(read(name)).expect("it is text")
}

/// Runs all cases of an architecture; returns the largest errors of latents and outputs.
fn compare(architecture: &str) -> (Arc<GnnWeights>, f32, f32) {
    let file = file::read(&read(&format!("tests/data/python_{architecture}.safetensors")))
        .unwrap_or_else(|e| panic!("{architecture}: {e}"));
    let network = Arc::new(GnnWeights::new(file));
    let mut gnn = Gnn::new(Arc::clone(&network), Draw::Mean, RobotId(0));
    let mut expected: serde_json::Value =
        serde_json::from_str(&text("tests/data/python_expected.json")).expect("it is JSON");
    let cases: Vec<Case> = serde_json::from_value(expected[architecture].take()).expect("they are cases");
    assert_eq!(cases.len(), 3);

    let (mut latent_off, mut output_off) = (0.0f32, 0.0f32);
    let off = |found: &[f32], expected: &[f32]| {
        assert_eq!(found.len(), expected.len());
        found.iter().zip(expected).map(|(found, expected)| (found - expected).abs()).fold(0.0, f32::max)
    };
    for case in cases {
        let team = 0..case.position.len();
        let motion = |i: usize| Motion { position: case.position[i].into(), velocity: case.velocity[i].into() };
        let own = |i: usize| Observation::new(motion(i), Vec2::from(case.goal[i]));
        let mut latent = vec![vec![0.0; gnn.interface().features]; team.len()];
        for (i, latent) in latent.iter_mut().enumerate() {
            gnn.encode(&own(i), latent);
            latent_off = latent_off.max(off(latent, &case.latent[i]));
        }
        for i in team.clone() {
            let heard = team.clone().filter(|j| *j != i).map(|j| Neighbour {
                motion: motion(j),
                features: &latent[j],
                age: Span::from_millis(case.age_ms[i][j]),
            });
            let heard: Vec<Neighbour> = heard.collect();
            output_off = output_off.max(off(&gnn.outputs(&own(i), &latent[i], &heard), &case.output[i]));
        }
    }
    (network, latent_off, output_off)
}

#[test]
fn files_from_python_answer_as_they_did_there() {
    for architecture in ["published", "full"] {
        let (_, latent_off, output_off) = compare(architecture);
        println!("{architecture}: latents are off by {latent_off:.1e}, outputs by {output_off:.1e}");
        assert!(latent_off <= 1e-4 && output_off <= 1e-4, "{architecture}: {latent_off:e}, {output_off:e}");
    }
}

#[test]
fn a_manifest_from_python_is_read_unchanged() {
    let (network, ..) = compare("full");
    let manifest = network.manifest().format_1().expect("it is of format 1");
    assert_eq!(manifest.architecture, Architecture::Full);
    assert_eq!(manifest.edge, [EdgeField::Age, EdgeField::RelativePosition]);
    assert_eq!((manifest.log_std_max, manifest.training.as_ref()), (Some(0.5), None));
}

#[test]
fn a_network_that_computes_other_numbers_than_its_probe_is_refused() {
    let bytes = read("tests/data/python_full.safetensors");
    let model = Model::from_file(&bytes, "passage").expect("its probe matches");
    assert_eq!(model.assumed(), None, "its manifest says everything");
    let mut file = file::read(&bytes).expect("the file is sound");
    let mut probe = file.probe.take().expect("the script writes one");
    let network = Arc::new(GnnWeights::new(file));
    let difference = probe.check(&network).expect("it matches");
    assert!(difference.latent < 1e-5 && difference.output < 1e-5, "{difference:?}");
    probe.output[3] += 0.01;
    let error = probe.check(&network).expect_err("one number differs").to_string();
    assert!(error.contains("outputs") && error.contains("activation"), "{error}");
    probe.output[3] = f32::NAN;
    assert!(probe.check(&network).is_err());
}

#[test]
fn a_file_from_python_whose_weights_were_changed_is_refused() {
    let mut file = read("tests/data/python_full.safetensors");
    // Flips the sign of the last number.
    *file.last_mut().expect("it is not empty") ^= 0x80;
    assert!(matches!(file::read(&file), Err(WeightsError::Hash { .. })));
}

#[test]
fn the_page_on_export_shows_the_script_that_made_these_files() {
    let (page, script) = (text("docs/bring-your-policy.md"), text("tests/data/export.py"));
    let blocks: Vec<&str> = page.split("```python\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    assert!(blocks.len() >= 2, "the page shows the export and a manifest");
    for block in blocks {
        assert!(script.contains(block), "not in tests/data/export.py:\n{block}");
    }
}
