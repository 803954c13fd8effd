//! A policy file of format 1 or 2 as data for numpy: one description of its networks, and one row of floats.

use anyhow::{Context, Result};
use murmurate::policy::file::AnyManifest;
use murmurate::policy::hops::manifest::Entry;
use murmurate::policy::manifest::{Architecture, Manifest};
use serde::Serialize;
use serde_json::{Value, json};

/// Name and shape of a tensor, in the order of the floats.
#[derive(Debug, PartialEq, Serialize)]
pub struct Tensor {
    name: String,
    shape: Vec<usize>,
}

/// Networks of a policy, in the words of format 2, and their weights.
pub struct Network {
    /// Manifest in the words of format 2; a hop may have the field `relative` beside them: its message network takes
    /// the difference of the sender's input from the own, and a term of the robot itself.
    pub policy: Value,
    /// Tensors, whose floats lie one after the other.
    pub tensors: Vec<Tensor>,
    /// Floats of all tensors, rows first.
    pub floats: Vec<f32>,
}

/// Returns the networks of the policy file `bytes`, which was checked and has this manifest. An error says what of the
/// policy numpy alone does not compute.
pub fn of(manifest: &AnyManifest, bytes: &[u8]) -> Result<Result<Network, String>> {
    if let Some(Entry::Channel(named)) = manifest.observation().iter().find(|entry| entry.request().is_some()) {
        let name = &named.name;
        return Ok(Err(format!("it observes '{name}', a sense or channel that the exported actor does not have")));
    }
    let policy = match manifest {
        AnyManifest::Format1(manifest) => of_format_1(manifest),
        AnyManifest::Format2(manifest) => {
            let mut policy = serde_json::to_value(manifest).context("a manifest is JSON")?;
            policy.as_object_mut().context("a manifest is an object")?.remove("training");
            policy
        }
    };
    let (tensors, floats) = tensors(bytes)?;
    Ok(Ok(Network { policy, tensors, floats }))
}

/// Returns the description of a policy of format 1 in the words of format 2.
fn of_format_1(manifest: &Manifest) -> Value {
    let network = |inputs: &[&str], widths: &[usize]| json!({"inputs": inputs, "widths": widths, "activation": "relu"});
    let relative = manifest.architecture == Architecture::Published;
    let (to_message, to_update): (&[&str], &[&str]) =
        if relative { (&["sender"], &["messages"]) } else { (&["own", "sender", "edge"], &["own", "messages"]) };
    json!({
        "observation": manifest.observation,
        "edge": manifest.edge,
        "encoder": {"widths": manifest.encoder, "activation": "relu"},
        "hops": [{
            "relative": relative,
            "aggregation": "sum",
            "message": network(to_message, &manifest.message),
            "update": network(to_update, &manifest.update),
        }],
        "distribution": manifest.distribution,
        "draw": manifest.draw,
        "log_std_max": manifest.log_std_max,
        "radius_m": manifest.radius_m,
        "rate_hz": manifest.rate_hz,
        "limit_m_s": manifest.limit_m_s,
    })
}

/// Returns the tensors of a safetensors file by the names of format 2, without its test data, and their floats.
fn tensors(bytes: &[u8]) -> Result<(Vec<Tensor>, Vec<f32>)> {
    let (length, rest) = bytes.split_first_chunk::<8>().context("the file was checked")?;
    let (header, data) = rest.split_at_checked(u64::from_le_bytes(*length).try_into()?).context("it was checked")?;
    let header: serde_json::Map<String, Value> = serde_json::from_slice(header)?;
    let (mut tensors, mut floats) = (Vec::new(), Vec::new());
    for (name, about) in header.iter().filter(|(name, _)| *name != "__metadata__" && !name.starts_with("probe.")) {
        let shape: Vec<usize> = serde_json::from_value(about["shape"].clone())?;
        let [from, until]: [usize; 2] = serde_json::from_value(about["data_offsets"].clone())?;
        let bytes = data.get(from..until).context("the file was checked")?;
        floats.extend(bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)));
        tensors.push(Tensor { name: renamed(name), shape });
    }
    Ok((tensors, floats))
}

/// Returns the name that a tensor of format 1, or of the file published with the paper, has in format 2.
fn renamed(name: &str) -> String {
    let of_hop = |theirs: &str, ours: &str| Some(format!("hops.0.{ours}.{}", name.strip_prefix(theirs)?));
    of_hop("message.", "message")
        .or_else(|| of_hop("gnn.", "message"))
        .or_else(|| of_hop("update.", "update"))
        .or_else(|| of_hop("post.", "update"))
        .unwrap_or_else(|| name.to_owned())
}

/// Returns the content of a file `.npy` (format 1.0) of one axis with these floats.
pub fn npy(floats: &[f32]) -> Vec<u8> {
    /// Bytes before the header's text: magic, version, length.
    const BEFORE: usize = 10;
    let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({},), }}", floats.len());
    let length = (BEFORE + text.len() + 1).next_multiple_of(64) - BEFORE;
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((length as u16).to_le_bytes());
    file.extend(format!("{text:<width$}\n", width = length - 1).bytes());
    file.extend(floats.iter().flat_map(|float| float.to_le_bytes()));
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_numpy_has_a_header_of_whole_blocks() {
        let file = npy(&[1.0, 2.0]);
        assert_eq!((file.len(), &file[..8], &file[8..10]), (128 + 8, &b"\x93NUMPY\x01\x00"[..], &[118, 0][..]));
        assert!(file[..128].ends_with(b"\n") && file[128..] == [0, 0, 128, 63, 0, 0, 0, 64]);
    }

    #[test]
    fn tensors_of_the_published_file_get_their_names() {
        let all = ["encoder.0.weight", "gnn.2.bias", "post.0.weight", "message.0.bias", "hops.1.score.0.weight"];
        let names = all.map(renamed);
        let expected =
            ["encoder.0.weight", "hops.0.message.2.bias", "hops.0.update.0.weight", "hops.0.message.0.bias", all[4]];
        assert_eq!(names, expected);
    }
}
