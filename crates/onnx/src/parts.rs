//! Parts of a policy of format 3: its contract and the bytes of its graphs, as files or as one file.

use murmurate::config::ConfigError;

use crate::contract::{Contract, METADATA};
use crate::structure::{Role, Structure, StructureError};

/// Contract of a policy, and its graphs.
#[derive(Clone, Debug)]
pub struct Parts {
    /// Contract of the policy.
    pub contract: Contract,
    /// Graphs in the order of their calls.
    pub graphs: Vec<GraphFile>,
    /// Digest of the contract and all graphs: the first 64 bits of a BLAKE3 hash, as hexadecimal digits.
    pub digest: String,
}

/// File of a graph.
#[derive(Clone, Debug)]
pub struct GraphFile {
    /// Part of a step that the graph computes.
    pub role: Role,
    /// Inputs, outputs and metadata of the graph.
    pub structure: Structure,
    /// Content of the file.
    pub bytes: Vec<u8>,
}

impl GraphFile {
    fn read(role: Role, bytes: Vec<u8>) -> Result<GraphFile, StructureError> {
        Ok(GraphFile { role, structure: Structure::read(&bytes)?, bytes })
    }
}

/// Error of a policy of format 3 that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Refused {
    /// The contract is wrong.
    #[error("its contract: {0}")]
    Contract(#[from] ConfigError),
    /// A graph cannot be used with any contract.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// Contract and graph do not agree, or the graph does not run as a policy has to.
    #[error("{0}")]
    Disagree(String),
}

impl Parts {
    /// Puts a policy together from its contract `text`. `read` returns the content of a file that the contract names;
    /// the error is that of the caller.
    ///
    /// # Errors
    /// The outer error is that of `read`, the inner one says why the policy cannot be used.
    pub fn of_contract<E>(
        text: &str,
        mut read: impl FnMut(&str) -> Result<Vec<u8>, E>,
    ) -> Result<Result<Parts, Refused>, E> {
        let contract = match Contract::parse(text) {
            Ok(contract) => contract,
            Err(error) => return Ok(Err(error.into())),
        };
        let mut graphs = Vec::new();
        for (role, file) in contract.files() {
            graphs.push((role, read(file)?));
        }
        if graphs.is_empty() && contract.python.is_none() {
            let missing =
                ConfigError::field("graph", "it is missing: the file of the graph, beside this one; or 'python'");
            return Ok(Err(missing.into()));
        }
        let graphs = graphs.into_iter().map(|(role, bytes)| GraphFile::read(role, bytes));
        let graphs: Result<Vec<GraphFile>, _> = graphs.collect();
        Ok(graphs.map_err(Refused::from).and_then(|graphs| Parts::new(contract, text, graphs)))
    }

    /// Puts a policy together from the content of one ONNX file, whose metadata hold the contract.
    pub fn of_graph(bytes: Vec<u8>) -> Result<Parts, Refused> {
        let graph = GraphFile::read(Role::Step, bytes)?;
        let Some(text) = graph.structure.contract.clone() else {
            let why = format!(
                "its metadata '{METADATA}' are missing: the file says neither units nor rate. Write a contract, \
                 NAME.policy.toml, that names it (docs/policy-format-3.md)"
            );
            return Err(Refused::Disagree(why));
        };
        let contract = Contract::parse(&text)?;
        for (field, file) in [
            ("graph", &contract.graph),
            ("encode", &contract.encode),
            ("act", &contract.act),
            ("python", &contract.python),
        ] {
            if file.is_some() {
                let why = "a contract in the metadata of its graph names no file; leave it out";
                return Err(ConfigError::field(field, why).into());
            }
        }
        Parts::new(contract, &text, vec![graph])
    }

    fn new(contract: Contract, text: &str, graphs: Vec<GraphFile>) -> Result<Parts, Refused> {
        let mut hash = blake3::Hasher::new();
        for bytes in std::iter::once(text.as_bytes()).chain(graphs.iter().map(|graph| graph.bytes.as_slice())) {
            hash.update(&(bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        }
        let mut sum = hmac_sha256::Hash::new();
        graphs.iter().for_each(|graph| sum.update(&graph.bytes));
        let found = data_encoding::HEXLOWER.encode(&sum.finalize());
        if contract.sha256.as_ref().is_some_and(|wanted| *wanted != found) {
            let why = "the graphs are not those of the contract: their SHA-256 is another";
            return Err(ConfigError::field("sha256", why).into());
        }
        let inside = graphs.iter().filter_map(|graph| graph.structure.contract.as_deref());
        if inside.into_iter().any(|inside| !same(inside, &contract)) {
            let why = format!("a graph has another contract in its metadata '{METADATA}'; take one of both out");
            return Err(Refused::Disagree(why));
        }
        let digest = data_encoding::HEXLOWER.encode(&hash.finalize().as_bytes()[..8]);
        Ok(Parts { contract, graphs, digest })
    }
}

/// Returns whether a contract in metadata says what `contract` says, apart from the names of files.
fn same(inside: &str, contract: &Contract) -> bool {
    let without = |contract: &Contract| Contract {
        graph: None,
        encode: None,
        relay: Vec::new(),
        act: None,
        python: None,
        sha256: None,
        ..contract.clone()
    };
    Contract::parse(inside).is_ok_and(|inside| without(&inside) == without(contract))
}
