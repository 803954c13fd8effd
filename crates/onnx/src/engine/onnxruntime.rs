//! The engine onnxruntime, of a library that the user names: it is opened when the program runs, and not part of it.

use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use ort::session::builder::GraphOptimizationLevel;
use ort::session::{Session, SessionInputValue};
use ort::value::TensorRef;

use super::{Array, Engine};

/// Name of the library that is open, or the reason why it is not.
static LIBRARY: OnceLock<Result<String, String>> = OnceLock::new();

/// Opens the library `path` for all graphs that are loaded from now on. Only the first call in a process has an effect.
pub fn open(path: &Path) -> Result<(), String> {
    LIBRARY.get_or_init(|| opened(path)).clone().map(drop)
}

fn opened(path: &Path) -> Result<String, String> {
    if cfg!(target_env = "musl") {
        return Err("a program that is linked statically opens no library; leave the variable out".to_owned());
    }
    let environment = ort::init_from(path).map_err(|error| line(&error.to_string()))?;
    environment.with_name("murmurate").with_telemetry(false).commit();
    // Of all that the library says of itself, its commit tells builds apart.
    let commit = ort::info().split_once("git-commit-id=").map_or("", |(_, rest)| rest);
    let commit: String = commit.chars().take_while(char::is_ascii_alphanumeric).collect();
    Ok(format!("onnxruntime of commit {commit}"))
}

/// Returns the name of the library that is open; `None` if none is.
pub fn name() -> Option<&'static str> {
    LIBRARY.get()?.as_deref().ok()
}

struct Onnxruntime {
    /// Calls of a session exclude each other.
    session: Mutex<Session>,
    inputs: Vec<String>,
    outputs: Vec<String>,
}

/// Makes a session that runs a graph on one thread: with several, sums could come in another order.
fn session(bytes: &[u8]) -> Result<Session, String> {
    let builder = Session::builder().map_err(|error| error.to_string())?;
    let builder = builder.with_intra_threads(1).map_err(|error| error.to_string())?;
    let builder = builder.with_inter_threads(1).map_err(|error| error.to_string())?;
    let builder = builder.with_deterministic_compute(true).map_err(|error| error.to_string())?;
    let builder = builder.with_optimization_level(GraphOptimizationLevel::Level3).map_err(|error| error.to_string());
    builder?.commit_from_memory(bytes).map_err(|error| error.to_string())
}

/// Loads a graph from the content of an ONNX file.
pub fn load(bytes: &[u8], inputs: &[String], outputs: &[String]) -> Result<Arc<dyn Engine>, String> {
    let session = session(bytes).map_err(|error| format!("the engine cannot load it: {}", line(&error)))?;
    let (inputs, outputs) = (inputs.to_vec(), outputs.to_vec());
    Ok(Arc::new(Onnxruntime { session: Mutex::new(session), inputs, outputs }))
}

impl Engine for Onnxruntime {
    fn run(&self, inputs: &[Array]) -> Result<Vec<Array>, String> {
        let failed = |error: ort::Error| format!("the engine cannot run it: {}", line(&error.to_string()));
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        let mut given: Vec<(&str, SessionInputValue)> = Vec::with_capacity(inputs.len());
        for (name, Array { shape, values }) in self.inputs.iter().zip(inputs) {
            let view = TensorRef::from_array_view((shape.as_slice(), values.as_slice())).map_err(failed)?;
            given.push((name, view.into()));
        }
        let found = session.run(given).map_err(failed)?;
        let array = |name: &String| -> Result<Array, String> {
            let value = found.get(name).ok_or_else(|| format!("the engine has no output '{name}'"))?;
            let (shape, values) = value.try_extract_tensor::<f32>().map_err(failed)?;
            let shape = shape.iter().map(|size| usize::try_from(*size).unwrap_or(0)).collect();
            Ok(Array { shape, values: values.to_vec() })
        };
        self.outputs.iter().map(array).collect()
    }
}

/// Returns an error of the library as one short line.
fn line(text: &str) -> String {
    text.lines().next().unwrap_or_default().chars().filter(|c| !c.is_control()).take(200).collect()
}
