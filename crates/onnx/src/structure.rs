//! Structure of an ONNX graph: its inputs, outputs, operators and metadata, without running it.

use std::collections::BTreeSet;

use prost::Message;

use crate::contract::{Contract, MAX_ROBOTS, METADATA, Pad, ROLES};
use crate::onnx::{DimensionProto, EXTERNAL, FLOAT, ModelProto, TensorProto, ValueInfoProto};
pub use crate::operators::OPERATORS;
use crate::operators::{check_nodes, check_sizes};
pub use crate::refusal::StructureError;
use crate::refusal::{refuse, shown};
pub use crate::role::Role;

/// Largest size of a weight along an axis, and of all axes together.
const MAX_SIZE: [u64; 2] = [1 << 20, 1 << 26];

/// Input or output of a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Name of the tensor.
    pub name: String,
    /// Sizes along the axes, the first of which is that of robots; `None` for one that the caller chooses. Empty if the
    /// file does not say.
    pub shape: Vec<Option<usize>>,
}

/// Structure of a graph.
#[derive(Clone, Debug)]
pub struct Structure {
    /// Inputs that the caller gives, in their order.
    pub inputs: Vec<Port>,
    /// Outputs in their order.
    pub outputs: Vec<Port>,
    /// Number of operators.
    pub operators: usize,
    /// Contract in the metadata of the file.
    pub contract: Option<String>,
}

impl Structure {
    /// Reads the structure of the ONNX file with the content `bytes`. Fails if it is no ONNX file, or if it has
    /// operators or weights that a policy may not have.
    pub fn read(bytes: &[u8]) -> Result<Structure, StructureError> {
        let Ok(model) = ModelProto::decode(bytes) else { return refuse("it is no ONNX file, or its end is missing") };
        let Some(graph) = &model.graph else { return refuse("it is no ONNX file: it has no graph") };
        check_nodes(graph)?;
        check_sizes(graph)?;
        let constants = graph.node.iter().flat_map(|node| &node.attribute).filter_map(|attribute| attribute.t.as_ref());
        graph.initializer.iter().chain(constants).try_for_each(check_weights)?;
        let weights: BTreeSet<&str> = graph.initializer.iter().map(|tensor| tensor.name.as_str()).collect();
        let given = graph.input.iter().filter(|input| !weights.contains(input.name.as_str()));
        let inputs = given.map(|input| port(input, "input")).collect::<Result<Vec<_>, _>>()?;
        let outputs = graph.output.iter().map(|output| port(output, "output")).collect::<Result<Vec<_>, _>>()?;
        for ports in [&inputs, &outputs] {
            let names: BTreeSet<&str> = ports.iter().map(|port| port.name.as_str()).collect();
            if names.len() != ports.len() {
                return refuse("two of its inputs or outputs have one name");
            }
        }
        let used: BTreeSet<&str> = graph.node.iter().flat_map(|node| &node.input).map(String::as_str).collect();
        if let Some(port) = inputs.iter().find(|port| !used.contains(port.name.as_str())) {
            let name = shown(&port.name);
            return refuse(format!("its input '{name}' is used by nothing, left over by the export: take it out"));
        }
        let entry = model.metadata_props.iter().find(|entry| entry.key == METADATA);
        let contract = entry.map(|entry| entry.value.clone());
        Ok(Structure { inputs, outputs, operators: graph.node.len(), contract })
    }

    /// Checks that the graph takes and gives what the contract says of a graph with this `role`. An error names the
    /// tensor, what was found and what is expected.
    pub fn check(&self, contract: &Contract, role: Role) -> Result<(), StructureError> {
        for port in &self.inputs {
            self.check_input(port, contract, role)?;
        }
        let takes = |name: &str| self.inputs.iter().any(|port| port.name == name);
        if (takes("messages") || takes("edges")) && !takes("heard") {
            return refuse("it takes neighbours without 'heard' [R, K]: an empty place would count as a neighbour");
        }
        let state = contract.state_floats();
        for (name, floats) in self.expected_outputs(contract, role) {
            let Some(port) = self.outputs.iter().find(|port| port.name == name) else {
                let names: Vec<&str> = self.outputs.iter().map(|port| shown(&port.name)).collect();
                return refuse(format!("it has no output '{name}' (it has {})", names.join(", ")));
            };
            fits(port, &[floats], "output")?;
        }
        if matches!(role, Role::Step | Role::Act) && takes("state") != (state > 0) {
            let graph = if takes("state") { "takes" } else { "does not take" };
            return refuse(format!("it {graph} an input 'state', and the contract has {state} floats of state"));
        }
        Ok(())
    }

    /// Returns the outputs of a graph with this `role`, each with its number of floats for a robot.
    pub fn expected_outputs(&self, contract: &Contract, role: Role) -> Vec<(&'static str, usize)> {
        let (message, state) = (contract.message.floats, contract.state_floats());
        let moves = self.outputs.iter().any(|port| port.name == "state_next");
        let all = [
            ("action", contract.action_floats(), matches!(role, Role::Step | Role::Act)),
            ("message", message, role != Role::Act && message > 0),
            (
                "state_next",
                state,
                state > 0 && (matches!(role, Role::Step | Role::Act) || role == Role::Encode && moves),
            ),
        ];
        all.into_iter().filter(|(_, _, there)| *there).map(|(name, floats, _)| (name, floats)).collect()
    }

    /// Returns the number of floats of the input `id` of a robot; `None` if the graph takes none. An error says that
    /// contract and graph do not agree on it.
    pub fn id_floats(&self, contract: &Contract) -> Result<Option<usize>, StructureError> {
        let Some(port) = self.inputs.iter().find(|port| port.name == "id") else { return Ok(None) };
        let Some(robots) = contract.robots else {
            return refuse("it takes an input 'id', and the contract has no table [robots]");
        };
        let of_graph = port.shape.get(1).copied().flatten();
        let Some(floats) = robots.floats().or(of_graph) else {
            return refuse(
                "its input 'id' has no fixed size, the number of robots of the largest team: add robots.most",
            );
        };
        fits(port, &[floats], "input")?;
        match (1..=MAX_ROBOTS).contains(&floats) {
            true => Ok(Some(floats)),
            false => refuse(format!("its input 'id' has {floats} floats: 1 to {MAX_ROBOTS} are expected")),
        }
    }

    fn check_input(&self, port: &Port, contract: &Contract, role: Role) -> Result<(), StructureError> {
        let (message, edges, state) = (contract.message.floats, contract.edge_floats(), contract.state_floats());
        let name = shown(&port.name);
        let needs = |floats: usize, field: &str| match floats {
            0 => refuse(format!("it takes an input '{name}', and the contract has no {field}")),
            floats => Ok(floats),
        };
        // The axis of neighbours is the caller's.
        let of_neighbours = |floats: Option<usize>| -> Result<(), StructureError> {
            if role == Role::Encode {
                return refuse(format!("a graph 'encode' takes no '{name}': nothing is heard before it"));
            }
            let rank = 2 + usize::from(floats.is_some());
            let fixed = port.shape.get(1).copied().flatten();
            if !port.shape.is_empty() && port.shape.len() != rank {
                return refuse(format!("its input '{name}' has {} axes: {rank} are expected", port.shape.len()));
            }
            if let Some(places) = fixed.filter(|places| *places != contract.max_neighbours) {
                let most = contract.max_neighbours;
                return refuse(format!("its input '{name}' takes {places} neighbours: max_neighbours is {most}"));
            }
            if fixed.is_some() && contract.pad == Pad::Exact {
                return refuse(format!("its input '{name}' has a fixed number of neighbours: set pad = \"max\""));
            }
            let last = port.shape.get(2).copied().flatten();
            match last.zip(floats).filter(|(found, floats)| found != floats) {
                Some((found, floats)) => {
                    refuse(format!("its input '{name}' takes {found} floats a neighbour: the contract makes {floats}"))
                }
                None => Ok(()),
            }
        };
        match port.name.as_str() {
            "messages" => of_neighbours(Some(needs(message, "message")?)),
            "edges" => of_neighbours(Some(needs(edges, "edges")?)),
            "heard" => of_neighbours(None),
            "own_message" if role == Role::Encode => {
                refuse("a graph 'encode' takes no 'own_message': it makes the message".to_owned())
            }
            "own_message" => fits(port, &[needs(message, "message")?], "input"),
            "state" => fits(port, &[needs(state, "state")?], "input"),
            "id" => self.id_floats(contract).map(drop),
            other => match contract.observation.get(other) {
                Some(observed) => fits(port, &observed.shape, "input"),
                None => refuse(format!(
                    "its input '{name}' is no observation of the contract, and none of {}",
                    ROLES.join(", ")
                )),
            },
        }
    }
}

/// Checks that weights are in the file itself, and of a size that a policy may have.
fn check_weights(tensor: &TensorProto) -> Result<(), StructureError> {
    let name = shown(&tensor.name);
    if tensor.data_location == EXTERNAL || !tensor.external_data.is_empty() {
        return refuse(format!("its weights '{name}' are in another file: export it with external_data=False"));
    }
    let sizes = tensor.dims.iter().map(|size| u64::try_from(*size).unwrap_or(u64::MAX));
    // An axis of size zero must not hide another one that is huge.
    let all = sizes.clone().fold(1_u64, |all, size| all.saturating_mul(size.max(1)));
    if sizes.clone().any(|size| size > MAX_SIZE[0]) || all > MAX_SIZE[1] {
        let [axis, most] = MAX_SIZE;
        return refuse(format!("its weights '{name}' have more than {axis} numbers along an axis, or {most} in all"));
    }
    Ok(())
}

fn port(value: &ValueInfoProto, what: &str) -> Result<Port, StructureError> {
    let name = value.name.clone();
    let tensor = value.r#type.as_ref().and_then(|kind| kind.tensor_type.as_ref());
    if name.is_empty() || tensor.is_none_or(|tensor| tensor.elem_type != FLOAT) {
        return refuse(format!("its {what} '{}' is no tensor of 32-bit floats", shown(&name)));
    }
    let size = |dim: &DimensionProto| dim.dim_value.and_then(|size| usize::try_from(size).ok());
    let shape = tensor.and_then(|tensor| tensor.shape.as_ref());
    Ok(Port { name, shape: shape.map_or(Vec::new(), |shape| shape.dim.iter().map(size).collect()) })
}

/// Checks that a tensor has this shape for a robot, as far as the file says.
fn fits(port: &Port, expected: &[usize], what: &str) -> Result<(), StructureError> {
    if port.shape.is_empty() {
        return Ok(());
    }
    let found = &port.shape[1..];
    let agrees = found.len() == expected.len()
        && found.iter().zip(expected).all(|(one, other)| one.is_none_or(|one| one == *other));
    if agrees {
        return Ok(());
    }
    let size = |size: &Option<usize>| size.map_or("any".to_owned(), |size| size.to_string());
    let (name, found) = (shown(&port.name), found.iter().map(size).collect::<Vec<_>>().join(", "));
    refuse(format!("its {what} '{name}' is [{found}] a robot: the contract says {expected:?}"))
}
