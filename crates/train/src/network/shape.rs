//! Shapes of networks: widths, activations and inputs of all their parts.

use std::fmt;

use super::layer::Activation;
use murmurate::policy::manifest::Architecture;

/// Shape of a network: encoder, memory, hops and decoder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Network that encodes an observation.
    pub encoder: Widths,
    /// Number of floats of the memory, a gated recurrent unit (GRU) between the encoder and the first hop; `None`
    /// without one.
    pub memory: Option<usize>,
    /// Hops in their order.
    pub hops: Vec<HopShape>,
    /// Network that makes the outputs from those of the last hop; `None` if these are the outputs.
    pub decoder: Option<Widths>,
    /// Number of edge features.
    pub edge: usize,
}

/// Widths and activations of the layers of a perceptron.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Widths {
    /// Number of inputs, and then of outputs of each layer.
    pub widths: Vec<usize>,
    /// Activation between layers.
    pub between: Activation,
    /// Activation after the last layer.
    pub last: Activation,
}

impl Widths {
    /// Returns layers of these widths with ReLU between them, and with none after the last.
    pub fn rectified(widths: Vec<usize>) -> Widths {
        Widths { widths, between: Activation::Relu, last: Activation::Linear }
    }

    /// Returns the width of the output.
    pub fn outputs(&self) -> usize {
        self.widths.last().copied().unwrap_or(0)
    }
}

/// Shape of one hop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HopShape {
    /// Network that makes a message.
    pub message: Widths,
    /// Parts of the message network's input, in this order.
    pub message_inputs: Vec<MessagePart>,
    /// Method of combining messages.
    pub aggregation: Aggregation,
    /// Whether a robot is one of its own neighbours, with edge features of zero.
    pub self_loop: bool,
    /// Network that makes the hop's output.
    pub update: Widths,
    /// Parts of the update network's input, in this order.
    pub update_inputs: Vec<UpdatePart>,
}

/// Part of the input of a message network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessagePart {
    /// The receiver's own input of the hop.
    Own,
    /// The sender's input of the hop.
    Sender,
    /// The sender's input of the hop minus the receiver's. A network with this part has neither of the other two.
    Difference,
    /// The features of the edge.
    Edge,
}

/// Part of the input of an update network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpdatePart {
    /// The robot's own input of the hop.
    Own,
    /// The combined messages.
    Messages,
}

/// Method of combining the messages of a hop. Without any message the result is zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aggregation {
    /// Sum of the messages.
    Sum,
    /// Mean of the messages.
    Mean,
}

impl Shape {
    /// Returns the shape of a network of one hop without memory or decoder, as policies of format 1 have it. The lists
    /// have the widths of encoder, message and update network, each from its input on; `edge` is the number of edge
    /// features.
    pub fn one_hop(architecture: Architecture, widths: [Vec<usize>; 3], edge: usize) -> Shape {
        let [encoder, message, update] = widths.map(Widths::rectified);
        let (message_inputs, update_inputs): (&[MessagePart], &[UpdatePart]) = match architecture {
            Architecture::Published => (&[MessagePart::Difference], &[UpdatePart::Messages]),
            Architecture::Full => {
                (&[MessagePart::Own, MessagePart::Sender, MessagePart::Edge], &[UpdatePart::Own, UpdatePart::Messages])
            }
        };
        let hop = HopShape {
            message,
            message_inputs: message_inputs.to_vec(),
            aggregation: Aggregation::Sum,
            self_loop: architecture == Architecture::Published,
            update,
            update_inputs: update_inputs.to_vec(),
        };
        Shape { encoder, memory: None, hops: vec![hop], decoder: None, edge }
    }

    /// Returns the width of the input of the hop with the index `hop`.
    pub fn hop_input(&self, hop: usize) -> usize {
        match hop.checked_sub(1) {
            None => self.memory.unwrap_or(self.encoder.outputs()),
            Some(before) => self.hops[before].update.outputs(),
        }
    }

    /// Checks that the widths fit each other. The error names the first part that does not.
    pub fn check(&self) -> Result<(), String> {
        let expect = |part: String, widths: &Widths, input: usize| match widths.widths.first() {
            Some(first) if *first == input && widths.widths.len() > 1 => Ok(()),
            _ => Err(format!("{part}: widths {:?} do not begin with {input} and go on", widths.widths)),
        };
        expect("encoder".to_owned(), &self.encoder, self.encoder.widths.first().copied().unwrap_or(0))?;
        if self.hops.is_empty() {
            return Err("hops: there are none".to_owned());
        }
        for (index, hop) in self.hops.iter().enumerate() {
            let input = self.hop_input(index);
            let part = |part: &MessagePart| if *part == MessagePart::Edge { self.edge } else { input };
            let message = hop.message_inputs.iter().map(part).sum();
            expect(format!("hops.{index}.message"), &hop.message, message)?;
            let difference = hop.message_inputs.contains(&MessagePart::Difference);
            if difference
                && hop.message_inputs.iter().any(|part| matches!(part, MessagePart::Own | MessagePart::Sender))
            {
                return Err(format!("hops.{index}.message: a difference excludes own and sender"));
            }
            if !hop.update_inputs.contains(&UpdatePart::Messages) {
                return Err(format!("hops.{index}.update.inputs: training needs 'messages' among them"));
            }
            let part = |part: &UpdatePart| if *part == UpdatePart::Own { input } else { hop.message.outputs() };
            expect(format!("hops.{index}.update"), &hop.update, hop.update_inputs.iter().map(part).sum())?;
        }
        let last = self.hop_input(self.hops.len());
        self.decoder.as_ref().map_or(Ok(()), |decoder| expect("decoder".to_owned(), decoder, last))
    }
}

/// The widths of all parts, as in `[16, 32] memory 24, 2 hops [67, 64] [96, 64], [64, 4]`.
impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.encoder.widths)?;
        if let Some(floats) = self.memory {
            write!(f, " memory {floats}")?;
        }
        for HopShape { message, update, aggregation, self_loop, .. } in &self.hops {
            let own = if *self_loop { " with own" } else { "" };
            write!(f, ", {aggregation:?}{own} {:?} {:?}", message.widths, update.widths)?;
        }
        self.decoder.as_ref().map_or(Ok(()), |decoder| write!(f, ", {:?}", decoder.widths))
    }
}
