//! Engines: what runs a graph. An engine is one file here, and takes and gives arrays of 32-bit floats.

#[cfg(feature = "onnxruntime")]
mod onnxruntime;
#[cfg(feature = "rten")]
mod rten;

use std::path::Path;

use std::sync::Arc;

use murmurate::messages::ids::RobotId;

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

    /// Notes that `robot` begins anew, with a seed for random numbers: its state is at its start. The default does
    /// nothing, for an engine that keeps nothing from one call to the next.
    fn reset(&self, _robot: RobotId, _seed: u64) {}

    /// Returns the engine for the thread that asks for it, which alone uses it; `None`, the default, for one that all
    /// threads use at once.
    fn of_thread(&self) -> Option<Arc<dyn Engine>> {
        None
    }

    /// Returns whether calls of several robots are made as one, if they ask before they take their answers.
    fn is_joint(&self) -> bool {
        false
    }

    /// Keeps the call of a robot until it takes its answer. The default does nothing.
    fn ask(&self, _robot: RobotId, _inputs: &[Array]) {}

    /// Returns the outputs of the call that the robot has asked for, which is made now with all others that wait;
    /// `None`, the default, if it has asked for none.
    fn answer(&self, _robot: RobotId) -> Option<Result<Vec<Array>, String>> {
        None
    }
}

/// Returns the name and version of the engine of this program; `None` if it was built without one.
pub fn name() -> Option<&'static str> {
    #[cfg(feature = "onnxruntime")]
    if let Some(name) = onnxruntime::name() {
        return Some(name);
    }
    cfg!(feature = "rten").then_some("rten 0.24.0")
}

/// Makes onnxruntime the engine of this process, by its library `path`. The first call counts. Does nothing in a
/// program without the feature `onnxruntime`. An error is a sentence.
pub fn open(path: &Path) -> Result<(), String> {
    #[cfg(feature = "onnxruntime")]
    return onnxruntime::open(path);
    #[cfg(not(feature = "onnxruntime"))]
    {
        let _ = path;
        Ok(())
    }
}

/// Returns the name and version of the engine of this program, and the kind of processor that it runs on, on which the
/// last digits of its numbers depend; empty without an engine.
pub fn about() -> String {
    let Some(name) = name() else { return String::new() };
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
    #[cfg(feature = "onnxruntime")]
    if onnxruntime::name().is_some() {
        return onnxruntime::load(&bytes, inputs, outputs);
    }
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
