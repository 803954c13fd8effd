//! Networks of policy files, as far as training supports them.

use super::layer::Activation;
use super::shape::{Aggregation, HopShape, MessagePart, Shape, UpdatePart, Widths};
use murmurate::policy::file::AnyManifest;
use murmurate::policy::hops::manifest::{self, Input, Layers, Manifest, SelfLoop};
use murmurate::policy::hops::perceptron;

impl Shape {
    /// Checks a manifest, and returns the shape of its network. The error names the first wrong field, or one that
    /// training does not support.
    pub fn of_manifest(manifest: &AnyManifest) -> Result<Shape, String> {
        let shape = match manifest {
            AnyManifest::Format1(manifest) => {
                manifest.check()?;
                let widths = [&manifest.encoder, &manifest.message, &manifest.update].map(Vec::clone);
                let edge = manifest.edge.iter().map(|field| field.floats()).sum();
                Shape::one_hop(manifest.architecture, widths, edge)
            }
            AnyManifest::Format2(manifest) => {
                manifest.check()?;
                of_format_2(manifest)?
            }
        };
        shape.check().map(|()| shape)
    }
}

fn of_format_2(manifest: &Manifest) -> Result<Shape, String> {
    let hops = manifest.hops.iter().enumerate();
    Ok(Shape {
        encoder: widths("encoder", &manifest.encoder)?,
        memory: manifest.memory.map(|memory| memory.floats),
        hops: hops.map(|(index, hop)| of_hop(&format!("hops.{index}"), hop)).collect::<Result<_, _>>()?,
        decoder: Some(widths("decoder", &manifest.decoder)?),
        edge: manifest.edge_floats(),
    })
}

fn of_hop(field: &str, hop: &manifest::Hop) -> Result<HopShape, String> {
    let needed = |name: &str, layers: &Option<Layers>| {
        let layers = layers.as_ref().ok_or_else(|| format!("{field}.{name}: training needs it; add it"))?;
        Ok::<_, String>((widths(&format!("{field}.{name}"), layers)?, layers.inputs.clone()))
    };
    let aggregation = match hop.aggregation {
        manifest::Aggregation::Sum => Aggregation::Sum,
        manifest::Aggregation::Mean => Aggregation::Mean,
        _ => return Err(format!("{field}.aggregation: training supports 'sum' and 'mean'")),
    };
    let self_loop = match hop.self_loop {
        None => false,
        Some(SelfLoop::ZeroEdge) => true,
        Some(SelfLoop::MeanEdge) => return Err(format!("{field}.self_loop: training supports 'zero-edge'")),
    };
    let (message, message_inputs) = needed("message", &hop.message)?;
    let (update, update_inputs) = needed("update", &hop.update)?;
    let part = |input: &Input| match input {
        Input::Own | Input::Messages => MessagePart::Own,
        Input::Sender => MessagePart::Sender,
        Input::Edge => MessagePart::Edge,
    };
    let update_part = |input: &Input| if *input == Input::Own { UpdatePart::Own } else { UpdatePart::Messages };
    Ok(HopShape {
        message,
        message_inputs: message_inputs.iter().map(part).collect(),
        aggregation,
        self_loop,
        update,
        update_inputs: update_inputs.iter().map(update_part).collect(),
    })
}

fn widths(field: &str, layers: &Layers) -> Result<Widths, String> {
    let supported = |name: &str, activation: perceptron::Activation| match activation {
        perceptron::Activation::Linear => Ok(Activation::Linear),
        perceptron::Activation::Relu => Ok(Activation::Relu),
        perceptron::Activation::Tanh => Ok(Activation::Tanh),
        _ => Err(format!("{field}.{name}: training supports 'linear', 'relu' and 'tanh', not {activation:?}")),
    };
    let between = supported("activation", layers.activation.unwrap_or_default())?;
    let last = supported("output_activation", layers.output_activation)?;
    Ok(Widths { widths: layers.widths.clone(), between, last })
}
