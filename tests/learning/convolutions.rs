//! Graph convolutions of PyTorch Geometric as policy files of format 2: robots compute from messages what these do.
//!
//! `tests/data/export_convolutions.py` generated the files, with the correct outputs as their probes. In the team of
//! each probe one robot has no neighbour, one has one, and six have four.

use std::path::Path;
use std::sync::Arc;

use murmurate::policy::gnn::GnnWeights;
use murmurate::policy::weights::WeightsError;
use murmurate::policy::{Draw, Model};
use murmurate::policy::{file, probe};
use murmurate::trial::Trial;

const FILES: [&str; 8] =
    ["graph_add", "graph_mean", "graph_max", "gatv2", "gatv2_self_loops", "gine", "transformer", "three_hops"];

fn read(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(format!("tests/data/conv_{name}.safetensors"));
    std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

#[test]
fn convolutions_answer_as_in_pytorch_geometric() {
    for name in FILES {
        let (_, difference) = probe::network(file::read(&read(name)).unwrap_or_else(|e| panic!("{name}: {e}")))
            .unwrap_or_else(|e| panic!("{name}: {e}"));
        let difference = difference.expect("the script writes a probe");
        println!("{name}: latents are off by {:.1e}, outputs by {:.1e}", difference.latent, difference.output);
        assert!(difference.latent <= 1e-5 && difference.output <= 1e-5, "{name}: {difference:?}");
    }
}

#[test]
fn the_probe_has_robots_with_no_neighbour_with_one_and_with_four() {
    let probe = file::read(&read("gatv2")).expect("it is sound").probe.expect("there is one");
    let heard = probe.heard.chunks(8).map(|row| row.iter().filter(|heard| **heard).count());
    assert_eq!(heard.collect::<Vec<_>>(), [0, 1, 4, 4, 4, 4, 4, 4]);
}

#[test]
fn a_convolution_that_computes_other_numbers_than_its_probe_is_refused() {
    let mut file = file::read(&read("three_hops")).expect("it is sound");
    let mut probe = file.probe.take().expect("the script writes one");
    let network = Arc::new(GnnWeights::new(file));
    probe.heard[8 + 2] = false;
    let error = probe.check(&network).expect_err("a message less").to_string();
    assert!(error.contains("latents"), "{error}");
    let mut changed = read("gine");
    *changed.last_mut().expect("it is not empty") ^= 0x80;
    assert!(matches!(file::read(&changed), Err(WeightsError::Hash { .. })));
}

#[test]
fn policies_of_one_and_of_three_hops_run_in_every_mode_and_repeat_bit_for_bit() {
    for name in ["gatv2", "three_hops"] {
        for mode in ["sim", "centralized", "offboard", "onboard-adhoc"] {
            let run = || {
                let model = Model::from_file(&read(name), "passage").expect("its probe matches");
                assert_eq!(model.name(), "gnn-hops");
                let model = model.with_draw(Draw::Sample).expect("it has a distribution");
                let report =
                    Trial::preset(mode, "passage").expect("it is a mode").model(model).seed(3).episodes(1).run();
                assert_eq!(report.episodes.len(), 1);
                report.totals.trace
            };
            assert_eq!(run(), run(), "{name} in mode {mode}");
        }
    }
}
