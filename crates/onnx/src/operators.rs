//! Operators of ONNX graphs: those that a policy may have, and which of their inputs are sizes.

use std::collections::BTreeSet;

use crate::onnx::GraphProto;
use crate::refusal::{StructureError, refuse, shown};

/// Operators that a graph may have: those of feed-forward and recurrent networks, without loops, branches, random
/// numbers and sizes that depend on values.
pub const OPERATORS: [&str; 104] = [
    "Abs",
    "Acos",
    "Add",
    "And",
    "ArgMax",
    "ArgMin",
    "Asin",
    "Atan",
    "AveragePool",
    "BatchNormalization",
    "Cast",
    "CastLike",
    "Ceil",
    "Clip",
    "Concat",
    "Constant",
    "ConstantOfShape",
    "Conv",
    "ConvTranspose",
    "Cos",
    "CumSum",
    "DepthToSpace",
    "Div",
    "Einsum",
    "Elu",
    "Equal",
    "Erf",
    "Exp",
    "Expand",
    "EyeLike",
    "Flatten",
    "Floor",
    "GRU",
    "Gather",
    "GatherElements",
    "GatherND",
    "Gelu",
    "Gemm",
    "GlobalAveragePool",
    "GlobalMaxPool",
    "Greater",
    "GreaterOrEqual",
    "HardSigmoid",
    "HardSwish",
    "Identity",
    "InstanceNormalization",
    "IsInf",
    "IsNaN",
    "LSTM",
    "LayerNormalization",
    "LeakyRelu",
    "Less",
    "LessOrEqual",
    "Log",
    "LogSoftmax",
    "MatMul",
    "Max",
    "MaxPool",
    "Mean",
    "Min",
    "Mod",
    "Mul",
    "Neg",
    "Not",
    "OneHot",
    "Or",
    "PRelu",
    "Pad",
    "Pow",
    "Range",
    "Reciprocal",
    "ReduceL2",
    "ReduceMax",
    "ReduceMean",
    "ReduceMin",
    "ReduceProd",
    "ReduceSum",
    "ReduceSumSquare",
    "Relu",
    "Reshape",
    "Round",
    "ScatterElements",
    "Shape",
    "Sigmoid",
    "Sign",
    "Sin",
    "Size",
    "Slice",
    "Softmax",
    "Softplus",
    "Split",
    "Sqrt",
    "Squeeze",
    "Sub",
    "Sum",
    "Tan",
    "Tanh",
    "Tile",
    "TopK",
    "Transpose",
    "Trilu",
    "Unsqueeze",
    "Where",
    "Xor",
];
/// Largest number of operators in a graph.
const MAX_NODES: usize = 20_000;

/// Checks operators and their number.
pub(crate) fn check_nodes(graph: &GraphProto) -> Result<(), StructureError> {
    if graph.node.is_empty() || graph.node.len() > MAX_NODES {
        return refuse(format!("it has {} operators: 1 to {MAX_NODES} are expected", graph.node.len()));
    }
    for node in &graph.node {
        let (operator, domain) = (node.op_type.as_str(), node.domain.as_str());
        if !matches!(domain, "" | "ai.onnx") {
            let (domain, operator) = (shown(domain), shown(operator));
            return refuse(format!("its operator '{domain}.{operator}' is not one of ONNX's own"));
        }
        let known = OPERATORS.contains(&operator);
        if !known || node.attribute.iter().any(|attribute| attribute.g.is_some() || !attribute.graphs.is_empty()) {
            let operator = shown(operator);
            return refuse(format!(
                "its operator '{operator}' is not in the list of those that a policy may have: no loops, branches, \
                 random numbers or sizes that depend on values (docs/policy-format-3.md)"
            ));
        }
    }
    Ok(())
}

/// Inputs of operators that are sizes or places, by their numbers; of all other operators none are.
const SIZES: [(&str, &[usize]); 13] = [
    ("ConstantOfShape", &[0]),
    ("Range", &[0, 1, 2]),
    ("Expand", &[1]),
    ("Tile", &[1]),
    ("OneHot", &[1]),
    ("TopK", &[1]),
    ("Pad", &[1, 3]),
    ("Reshape", &[1]),
    ("Slice", &[1, 2, 3, 4]),
    ("Split", &[1]),
    ("Squeeze", &[1]),
    ("Unsqueeze", &[1]),
    ("CumSum", &[1]),
];

/// Checks that no size within the graph depends on the values of its inputs, but on their shapes alone: such a graph
/// could take any memory in a run that a check has not seen.
pub(crate) fn check_sizes(graph: &GraphProto) -> Result<(), StructureError> {
    let weights: BTreeSet<&str> = graph.initializer.iter().map(|tensor| tensor.name.as_str()).collect();
    let given = graph.input.iter().map(|input| input.name.as_str()).filter(|name| !weights.contains(name));
    let mut depends: BTreeSet<&str> = given.collect();
    let later: BTreeSet<&str> = graph.node.iter().flat_map(|node| &node.output).map(String::as_str).collect();
    let mut known = BTreeSet::new();
    for node in &graph.node {
        if node.input.iter().any(|input| later.contains(input.as_str()) && !known.contains(input.as_str())) {
            return refuse("an operator comes before the one that makes its input, which ONNX does not permit");
        }
        known.extend(node.output.iter().map(String::as_str));
        let operator = node.op_type.as_str();
        let sizes = SIZES.iter().find(|(name, _)| *name == operator).map_or(&[][..], |(_, sizes)| *sizes);
        let axes = if operator.starts_with("Reduce") { &[1][..] } else { sizes };
        if axes.iter().any(|at| node.input.get(*at).is_some_and(|input| depends.contains(input.as_str()))) {
            return refuse(format!("a size of its operator '{operator}' depends on the values of its inputs"));
        }
        if !matches!(operator, "Shape" | "Size") && node.input.iter().any(|input| depends.contains(input.as_str())) {
            depends.extend(node.output.iter().map(String::as_str));
        }
    }
    Ok(())
}
