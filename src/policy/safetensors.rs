//! The safetensors file format: a JSON header with metadata, followed by named tensors.
//!
//! A file starts with the length of its header (8 bytes, little-endian). The header and the tensors follow, without
//! gaps. Everything is checked before a tensor is returned, and no allocation is larger than the file.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::config;

/// Size of the field with the length of the header \[bytes\].
const LENGTH_BYTES: usize = 8;
/// Longest header that is accepted \[bytes\]: a hundred times what a policy of eight hops has. A parsed header takes up
/// to thirty times its length in memory, so the limit of the reference library, 100 MB, would take gigabytes.
const MAX_HEADER_BYTES: u64 = 4_000_000;
/// The data types of the format, with the size of one number \[bytes\].
const TYPES: [(&str, usize); 15] = [
    ("BOOL", 1),
    ("U8", 1),
    ("I8", 1),
    ("F8_E5M2", 1),
    ("F8_E4M3", 1),
    ("U16", 2),
    ("I16", 2),
    ("F16", 2),
    ("BF16", 2),
    ("U32", 4),
    ("I32", 4),
    (F32, 4),
    ("U64", 8),
    ("I64", 8),
    ("F64", 8),
];

/// Name of the data type of 32-bit floats in a safetensors file.
pub const F32: &str = "F32";

/// Content of a safetensors file, whose header and lengths are checked.
#[derive(Debug)]
pub struct SafeTensors<'a> {
    /// Metadata texts of the file, by name.
    pub metadata: BTreeMap<String, String>,
    /// Tensors of the file, by name.
    pub tensors: BTreeMap<String, Tensor<'a>>,
}

/// Tensor in a safetensors file: numbers of one data type in a row-major array.
#[derive(Debug, PartialEq)]
pub struct Tensor<'a> {
    /// Name of the data type, as in the file, such as `F32`.
    pub kind: String,
    /// Size of the tensor along each axis. The order is row-major, so the last index varies fastest.
    pub shape: Vec<usize>,
    /// Bytes of the numbers, little-endian; there are as many numbers as the shape gives.
    pub data: &'a [u8],
}

/// JSON header of a safetensors file: metadata texts, and an entry for each tensor, by name.
#[derive(Serialize, Deserialize)]
struct Header {
    #[serde(rename = "__metadata__", default, skip_serializing_if = "Option::is_none")]
    metadata: Option<BTreeMap<String, String>>,
    #[serde(flatten)]
    tensors: BTreeMap<String, Entry>,
}

/// Entry of one tensor in the header of a safetensors file: data type, shape, and place of its data.
#[derive(Serialize, Deserialize)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    /// Begin and end of its data, in bytes from the end of the header.
    data_offsets: [usize; 2],
}

/// Parses and checks a safetensors file, of which `bytes` is the whole content. The returned tensors borrow their data
/// from `bytes`. The error describes the fault and quotes nothing of the file.
pub fn read(bytes: &[u8]) -> Result<SafeTensors<'_>, String> {
    let (length, rest) = bytes.split_first_chunk::<LENGTH_BYTES>().ok_or("it is shorter than 8 bytes")?;
    let length = u64::from_le_bytes(*length);
    if length > MAX_HEADER_BYTES {
        return Err(format!("its header would have {length} bytes"));
    }
    let length = usize::try_from(length).map_err(|e| e.to_string())?;
    let (header, data) = rest.split_at_checked(length).ok_or("it ends within its header")?;
    let header: Header = serde_json::from_slice(header)
        .map_err(|e| metadata_is_no_text(header).unwrap_or(format!("its header: {}", config::json(&e))))?;
    let mut entries: Vec<(String, Entry)> = header.tensors.into_iter().collect();
    entries.sort_by_key(|(_, entry)| entry.data_offsets);
    let (mut tensors, mut at) = (BTreeMap::new(), 0);
    for (name, Entry { dtype, shape, data_offsets: [from, to] }) in entries {
        let Some((_, size)) = TYPES.iter().find(|(kind, _)| *kind == dtype) else {
            return Err("a tensor has an unknown data type".to_owned());
        };
        let wanted = shape.iter().try_fold(*size, |bytes, along| bytes.checked_mul(*along));
        if from != at || to < from || wanted != Some(to - from) {
            return Err("the offsets of a tensor do not match its shape and the end of the one before".to_owned());
        }
        let Some(data) = data.get(from..to) else { return Err("it ends within a tensor".to_owned()) };
        at = to;
        tensors.insert(name, Tensor { kind: dtype, shape, data });
    }
    if at != data.len() {
        return Err("there are bytes after the last tensor".to_owned());
    }
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

/// Returns the bytes of a safetensors file with the content `file`; the tensors are in the order of their names.
///
/// # Panics
/// If a tensor has an unknown data type, or if its data do not have the length that its shape gives.
pub fn write(file: &SafeTensors) -> Vec<u8> {
    let mut at = 0;
    let tensors = file.tensors.iter().map(|(name, Tensor { kind, shape, data })| {
        let size = TYPES.iter().find(|(known, _)| known == kind).expect("the type is known").1;
        assert_eq!(shape.iter().product::<usize>() * size, data.len(), "'{name}' has the length that its shape gives");
        let from = at;
        at += data.len();
        (name.clone(), Entry { dtype: kind.clone(), shape: shape.clone(), data_offsets: [from, at] })
    });
    let tensors = tensors.collect();
    let metadata = Some(file.metadata.clone()).filter(|metadata| !metadata.is_empty());
    let mut header = serde_json::to_vec(&Header { metadata, tensors }).expect("a header is JSON");
    // Padded so that the tensors are aligned for every data type.
    header.resize(header.len().next_multiple_of(LENGTH_BYTES), b' ');
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.append(&mut header);
    file.tensors.values().for_each(|tensor| bytes.extend_from_slice(tensor.data));
    bytes
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
        assert!(write(&read(shipped).unwrap()) == shipped, "as written by the reference library");
        let published = built_in("published", "passage").expect("one is built in");
        let file = read(published).unwrap();
        let again = write(&file);
        assert_eq!(read(&again).unwrap().tensors, file.tensors);
    }

    #[test]
    fn an_inconsistent_file_is_refused_and_never_quoted() {
        let one = |kind: &str, shape: &str, offsets: &str| {
            format!(r#"{{"secret":{{"dtype":"{kind}","shape":{shape},"data_offsets":{offsets}}}}}"#)
        };
        let sound = one("F32", "[2]", "[0,8]");
        assert_eq!(read(&file(&sound, &[0; 8])).unwrap().tensors["secret"].shape, [2]);
        assert!(read(&file("{}", &[])).unwrap().tensors.is_empty());
        let huge = format!("[{0},{0}]", usize::MAX);
        for wrong in [
            Vec::new(),
            vec![0; 7],
            vec![0; 8],
            vec![0xff; 64],
            file(&sound, &[0; 7]),
            file(&sound, &[0; 9]),
            file(&sound, &[0; 8])[..60].to_vec(),
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
