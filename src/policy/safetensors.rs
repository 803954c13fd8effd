//! The safetensors file format: a JSON header with metadata, followed by named tensors.
//!
//! A file starts with the length of its header (8 bytes, little-endian). The header and the tensors follow, without
//! gaps. Everything is checked before a tensor is returned, and no allocation is larger than the file.
//!
//! The header is taken apart here and checked by the library: its own reader quotes names in errors, allows headers of
//! 100 MB, and adds up a file's lengths without a check for overflow.

use std::cmp::Ordering;
use std::collections::BTreeMap;

pub use ::safetensors::Dtype;
pub use ::safetensors::tensor::TensorView;
use ::safetensors::tensor::{Metadata, TensorInfo};
use serde::Deserialize;

use crate::config;

/// Size of the field with the length of the header \[bytes\].
const LENGTH_BYTES: usize = 8;
/// Longest header that is accepted \[bytes\]: a hundred times what a policy of eight hops has. A parsed header takes up
/// to thirty times its length in memory, so the limit of the library, 100 MB, would take gigabytes.
const MAX_HEADER_BYTES: u64 = 4_000_000;

/// Content of a safetensors file, whose header and lengths are checked.
#[derive(Debug)]
pub struct SafeTensors<'a> {
    /// Metadata texts of the file, by name.
    pub metadata: BTreeMap<String, String>,
    /// Tensors of the file, by name.
    pub tensors: BTreeMap<String, TensorView<'a>>,
}

/// JSON header of a safetensors file: metadata texts, and an entry for each tensor, by name.
#[derive(Deserialize)]
struct Header {
    #[serde(rename = "__metadata__", default)]
    metadata: Option<BTreeMap<String, String>>,
    #[serde(flatten)]
    tensors: BTreeMap<String, TensorInfo>,
}

/// Parses and checks a safetensors file, of which `bytes` is the whole content. The returned tensors borrow their data
/// from `bytes`. The error describes the fault and quotes nothing of the file.
pub fn read(bytes: &[u8]) -> Result<SafeTensors<'_>, String> {
    const OFFSETS: &str = "the offsets of a tensor do not match its shape and the end of the one before";
    let (length, rest) = bytes.split_first_chunk::<LENGTH_BYTES>().ok_or("it is shorter than 8 bytes")?;
    let length = u64::from_le_bytes(*length);
    if length > MAX_HEADER_BYTES {
        return Err(format!("its header would have {length} bytes"));
    }
    let (header, data) = rest.split_at_checked(length as usize).ok_or("it ends within its header")?;
    let header: Header = serde_json::from_slice(header)
        .map_err(|e| metadata_is_no_text(header).unwrap_or(format!("its header: {}", config::json(&e))))?;
    let mut entries: Vec<(String, TensorInfo)> = header.tensors.into_iter().collect();
    entries.sort_by_key(|(_, info)| info.data_offsets);
    let checked = Metadata::new(None, entries).map_err(|_| OFFSETS)?;
    match checked.data_len().cmp(&data.len()) {
        Ordering::Greater => return Err("it ends within a tensor".to_owned()),
        Ordering::Less => return Err("there are bytes after the last tensor".to_owned()),
        Ordering::Equal => {}
    }
    let view = |(name, info): (String, &TensorInfo)| {
        let (from, to) = info.data_offsets;
        Ok((name, TensorView::new(info.dtype, info.shape.clone(), &data[from..to]).map_err(|_| OFFSETS)?))
    };
    let tensors = checked.tensors().into_iter().map(view).collect::<Result<_, &str>>()?;
    Ok(SafeTensors { metadata: header.metadata.unwrap_or_default(), tensors })
}

/// Returns the error of a header whose metadata hold something else than texts, such as a manifest as an object; `None`
/// if they do not.
fn metadata_is_no_text(header: &[u8]) -> Option<String> {
    let header: serde_json::Value = serde_json::from_slice(header).ok()?;
    let other = header.get("__metadata__")?.as_object()?.values().find(|value| !value.is_string())?;
    let kind = match other {
        serde_json::Value::Object(_) => "an object",
        serde_json::Value::Array(_) => "a list",
        _ => "no text",
    };
    Some(format!(
        "its header: a value of '__metadata__' is {kind}; each has to be a text, so write the manifest as JSON text"
    ))
}

/// Returns the bytes of a safetensors file with these tensors and one metadata text, with its name, if any. The library
/// writes several in no fixed order.
///
/// # Panics
/// If the offsets of the tensors exceed the address space.
pub fn write(metadata: Option<(String, String)>, tensors: &BTreeMap<String, TensorView>) -> Vec<u8> {
    let metadata = metadata.map(|text| [text].into());
    ::safetensors::serialize(tensors, metadata).expect("tensors that are in memory fit into a file")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::shipped::built_in;

    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), data].concat()
    }

    #[test]
    fn a_file_that_is_read_and_written_is_unchanged() {
        let shipped = built_in("robust", "passage").expect("one is built in");
        let file = read(shipped).unwrap();
        assert_eq!(file.metadata.len(), 1);
        assert!(write(file.metadata.into_iter().next(), &file.tensors) == shipped, "nothing of it is lost");
        let published = built_in("published", "passage").expect("one is built in");
        let file = read(published).unwrap();
        assert_eq!(read(&write(None, &file.tensors)).unwrap().tensors, file.tensors);
    }

    #[test]
    fn an_inconsistent_file_is_refused_and_never_quoted() {
        let one = |kind: &str, shape: &str, offsets: &str| {
            format!(r#"{{"secret":{{"dtype":"{kind}","shape":{shape},"data_offsets":{offsets}}}}}"#)
        };
        let sound = one("F32", "[2]", "[0,8]");
        assert_eq!(read(&file(&sound, &[0; 8])).unwrap().tensors["secret"].shape(), [2]);
        assert!(read(&file("{}", &[])).unwrap().tensors.is_empty());
        let huge = format!("[{0},{0}]", usize::MAX);
        // Eight tensors whose lengths together are just below the address space.
        const EIGHTH: usize = usize::MAX / 8;
        let all = (0..8).map(|at| {
            let [from, to] = [at * EIGHTH, (at + 1) * EIGHTH];
            format!(r#""secret{at}":{{"dtype":"U8","shape":[{EIGHTH}],"data_offsets":[{from},{to}]}}"#)
        });
        let all = format!("{{{}}}", all.collect::<Vec<_>>().join(","));
        for wrong in [
            Vec::new(),
            vec![0; 7],
            vec![0; 8],
            vec![0xff; 64],
            file(&sound, &[0; 7]),
            file(&sound, &[0; 9]),
            file(&sound, &[0; 8])[..60].to_vec(),
            file(&all, &[0; 8]),
            file("[\"secret\"]", &[]),
            file("{\"secret\": 1}", &[]),
            file("{\"secret\"", &[]),
            file(&one("F33", "[2]", "[0,8]"), &[0; 8]),
            file(&one("F32", "[3]", "[0,8]"), &[0; 8]),
            file(&one("F32", &huge, "[0,8]"), &[0; 8]),
            file(&one("F32", "[2]", "[4,12]"), &[0; 12]),
            file(&one("F32", "[2]", "[8,0]"), &[0; 8]),
            file(&one("F32", "[-2]", "[0,8]"), &[0; 8]),
        ] {
            let why = read(&wrong).expect_err("it is no file of this format");
            assert!(!why.contains("secret") && !why.contains('\n'), "{why}");
        }
    }
}
