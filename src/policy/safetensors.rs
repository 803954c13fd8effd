//! The file format safetensors: named tensors of numbers behind a header in JSON, and notes about them.
//!
//! A file is the length of its header (8 bytes, little-endian), the header, and the tensors one after the other
//! without a gap. Everything is checked before a tensor is handed out; nothing is allocated that the file is not long
//! enough to fill.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::config;

/// The bytes that say how long the header is.
const LENGTH_BYTES: usize = 8;
/// The longest header that is read \[bytes\], as everyone has it who reads this format.
const MOST_BYTES: u64 = 100_000_000;
/// The types that there are, with the bytes of one number.
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

/// The type of 32-bit floats.
pub const F32: &str = "F32";

/// A file that has been checked.
#[derive(Debug)]
pub struct SafeTensors<'a> {
    /// Notes by name.
    pub metadata: BTreeMap<String, String>,
    /// Tensors by name.
    pub tensors: BTreeMap<String, Tensor<'a>>,
}

/// Numbers of one type.
#[derive(Debug, PartialEq)]
pub struct Tensor<'a> {
    /// The type, by its name in the file.
    pub kind: String,
    /// How many there are along each axis; the last one runs fastest.
    pub shape: Vec<usize>,
    /// The numbers, little-endian: as many as the shape says.
    pub data: &'a [u8],
}

/// What is before the tensors.
#[derive(Serialize, Deserialize)]
struct Header {
    #[serde(rename = "__metadata__", default, skip_serializing_if = "Option::is_none")]
    metadata: Option<BTreeMap<String, String>>,
    #[serde(flatten)]
    tensors: BTreeMap<String, Entry>,
}

/// A tensor in the header.
#[derive(Serialize, Deserialize)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    /// From where to where, in the bytes behind the header.
    data_offsets: [usize; 2],
}

/// Reads a file; the error says what is wrong with it, and quotes nothing of it.
pub fn read(bytes: &[u8]) -> Result<SafeTensors<'_>, String> {
    let (length, rest) = bytes.split_first_chunk::<LENGTH_BYTES>().ok_or("it is shorter than any")?;
    let length = u64::from_le_bytes(*length);
    if length > MOST_BYTES {
        return Err(format!("its header would have {length} bytes"));
    }
    let length = usize::try_from(length).map_err(|e| e.to_string())?;
    let (header, data) = rest.split_at_checked(length).ok_or("it ends in its header")?;
    let header: Header = serde_json::from_slice(header).map_err(|e| format!("its header: {}", config::json(&e)))?;
    let mut entries: Vec<(String, Entry)> = header.tensors.into_iter().collect();
    entries.sort_by_key(|(_, entry)| entry.data_offsets);
    let (mut tensors, mut at) = (BTreeMap::new(), 0);
    for (name, Entry { dtype, shape, data_offsets: [from, to] }) in entries {
        let Some((_, size)) = TYPES.iter().find(|(kind, _)| *kind == dtype) else {
            return Err("a tensor is of a type that is not known".to_owned());
        };
        let wanted = shape.iter().try_fold(*size, |bytes, along| bytes.checked_mul(*along));
        if from != at || to < from || wanted != Some(to - from) {
            return Err("a tensor has not the place of its shape, right behind the one before".to_owned());
        }
        let Some(data) = data.get(from..to) else { return Err("it ends in a tensor".to_owned()) };
        at = to;
        tensors.insert(name, Tensor { kind: dtype, shape, data });
    }
    if at != data.len() {
        return Err("something follows the last tensor".to_owned());
    }
    Ok(SafeTensors { metadata: header.metadata.unwrap_or_default(), tensors })
}

/// Writes a file, its tensors in the order of their names.
///
/// # Panics
/// If a tensor is of no known type, or not as long as its shape says.
pub fn write(file: &SafeTensors) -> Vec<u8> {
    let mut at = 0;
    let tensors = file.tensors.iter().map(|(name, Tensor { kind, shape, data })| {
        let size = TYPES.iter().find(|(known, _)| known == kind).expect("the type is known").1;
        assert_eq!(shape.iter().product::<usize>() * size, data.len(), "'{name}' is as long as its shape says");
        let from = at;
        at += data.len();
        (name.clone(), Entry { dtype: kind.clone(), shape: shape.clone(), data_offsets: [from, at] })
    });
    let tensors = tensors.collect();
    let metadata = Some(file.metadata.clone()).filter(|metadata| !metadata.is_empty());
    let mut header = serde_json::to_vec(&Header { metadata, tensors }).expect("a header is JSON");
    // The tensors begin where every number is aligned.
    header.resize(header.len().next_multiple_of(LENGTH_BYTES), b' ');
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.append(&mut header);
    file.tensors.values().for_each(|tensor| bytes.extend_from_slice(tensor.data));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::shipped::{published, shipped};

    fn file(header: &str, data: &[u8]) -> Vec<u8> {
        [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), data].concat()
    }

    #[test]
    fn a_file_that_is_written_again_is_the_same() {
        let shipped = shipped("passage").unwrap();
        assert!(write(&read(shipped).unwrap()) == shipped, "as the reference library has written it");
        let published = published("passage").unwrap();
        let file = read(published).unwrap();
        let again = write(&file);
        assert_eq!(read(&again).unwrap().tensors, file.tensors);
    }

    #[test]
    fn a_file_that_contradicts_itself_is_refused_and_never_quoted() {
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
