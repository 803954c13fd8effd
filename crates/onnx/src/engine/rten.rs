//! The engine rten, in Rust.

use std::cell::OnceCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use rten::{Model, NodeId, RunOptions, ThreadPool, ValueOrView};
use rten_tensor::{AsView, Layout, Tensor, TensorView};

use super::{Array, Engine};

struct Rten {
    model: Model,
    inputs: Vec<NodeId>,
    outputs: Vec<NodeId>,
}

/// Loads a graph from the content of an ONNX file.
pub fn load(bytes: Vec<u8>, inputs: &[String], outputs: &[String]) -> Result<Arc<dyn Engine>, String> {
    let model = guarded("cannot load it", || Model::load(bytes).map_err(|error| error.to_string()))?;
    let ids = |names: &[String]| -> Result<Vec<NodeId>, String> {
        names.iter().map(|name| model.node_id(name).map_err(|error| error.to_string())).collect()
    };
    let (inputs, outputs) = (ids(inputs)?, ids(outputs)?);
    Ok(Arc::new(Rten { model, inputs, outputs }))
}

impl Engine for Rten {
    fn run(&self, inputs: &[Array]) -> Result<Vec<Array>, String> {
        guarded("cannot run it", || {
            let given: Vec<(NodeId, ValueOrView)> = self.inputs.iter().copied().zip(inputs.iter().map(view)).collect();
            let options = RunOptions::default().with_thread_pool(Some(pool()));
            let outputs = self.model.run(given, &self.outputs, Some(options)).map_err(|error| error.to_string())?;
            let array = |value: rten::Value| -> Result<Array, String> {
                let tensor: Tensor<f32> = value.try_into().map_err(|_| "an output is no array of floats".to_owned())?;
                Ok(Array { shape: tensor.shape().to_vec(), values: tensor.to_vec() })
            };
            outputs.into_iter().map(array).collect()
        })
    }
}

fn view(array: &Array) -> ValueOrView<'_> {
    TensorView::from_data(array.shape.as_slice(), array.values.as_slice()).into()
}

/// Returns the calling thread's pool of one thread: with several, sums could come in another order.
fn pool() -> Arc<ThreadPool> {
    thread_local! {
        static POOL: OnceCell<Arc<ThreadPool>> = const { OnceCell::new() };
    }
    POOL.with(|pool| Arc::clone(pool.get_or_init(|| Arc::new(ThreadPool::with_num_threads(1)))))
}

/// Calls the engine, and makes an error of one line of its errors and panics.
fn guarded<T>(what: &str, call: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    let why = match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(done)) => return Ok(done),
        Ok(Err(why)) => why,
        Err(_) => "it panicked".to_owned(),
    };
    let line = why.lines().next().unwrap_or_default();
    let short: String = line.chars().filter(|c| !c.is_control()).take(160).collect();
    Err(format!("the engine {what}: {short}"))
}
