//! Engines: what runs a graph. An engine is one file here, and takes and gives arrays of 32-bit floats.

#[cfg(feature = "rten")]
mod rten;

use std::sync::Arc;

/// Array of 32-bit floats, the last axis running fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Sizes along the axes.
    pub shape: Vec<usize>,
    /// All values.
    pub values: Vec<f32>,
}

/// Graph that is ready to run.
pub trait Engine: Send + Sync {
    /// Runs the graph on `inputs`, in the order of the names at loading, and returns the outputs in the order of
    /// theirs. An error is a sentence, also if the engine has panicked.
    fn run(&self, inputs: &[Array]) -> Result<Vec<Array>, String>;

    /// Notes that a robot begins anew: its state is at its start. The default does nothing, for an engine that keeps
    /// nothing from one call to the next.
    fn reset(&self) {}
}

/// Name and version of the engine of this program; `None` if it was built without one.
pub const NAME: Option<&str> = if cfg!(feature = "rten") { Some("rten 0.24.0") } else { None };

/// Returns the name and version of the engine of this program, and the kind of processor that it runs on, on which the
/// last digits of its numbers depend; empty without an engine.
pub fn about() -> String {
    let Some(name) = NAME else { return String::new() };
    #[cfg(target_arch = "x86_64")]
    let kind = {
        let [wide, fused] = [std::is_x86_feature_detected!("avx512f"), std::is_x86_feature_detected!("fma")];
        if wide {
            " with AVX-512"
        } else if fused {
            " with AVX2"
        } else {
            ""
        }
    };
    #[cfg(not(target_arch = "x86_64"))]
    let kind = "";
    let family = match () {
        () if cfg!(target_arch = "x86_64") => "x86-64",
        () if cfg!(target_arch = "aarch64") => "aarch64",
        () => "another processor",
    };
    format!("{name} on {family}{kind}")
}

/// Loads the graph with the content `bytes`, whose inputs and outputs have these names. An error is a sentence.
pub fn load(bytes: Vec<u8>, inputs: &[String], outputs: &[String]) -> Result<Arc<dyn Engine>, String> {
    #[cfg(feature = "rten")]
    return rten::load(bytes, inputs, outputs);
    #[cfg(not(feature = "rten"))]
    {
        let _ = (bytes, inputs, outputs);
        Err("policies of format 3 need an engine, and this program was built without the feature 'onnx': build one \
             that has it (docs/run-a-team.md)"
            .to_owned())
    }
}
