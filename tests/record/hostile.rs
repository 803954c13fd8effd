//! Records that somebody has made to do harm: no panic, no hang and no more than 256 MB, whatever they say.
//!
//! The variable MURMURATE_MUTATIONS sets the number of mutations (`just full-damage`: 20 000). `fuzz/` has a
//! coverage-guided target for the same reader.

use std::io::Cursor;
use std::path::Path;
use std::time::{Duration, Instant};

use murmurate::random::Seed;
use murmurate_record::identity::Identity;
use murmurate_record::reader::{Item, Reader};
use murmurate_record::repair::copy;
use murmurate_record::stage::Stage;
use murmurate_record::tape;
use rand::{Rng, RngExt};
use tempfile::TempDir;

use crate::damage::in_chunks;
use crate::program::{murmurate, run, text};

/// Does with a file what the commands do with it.
fn read_all(bytes: &[u8]) -> u64 {
    let Ok(mut reader) = Reader::of(Path::new("hostile"), Cursor::new(bytes.to_vec())) else { return 0 };
    let mut messages = 0;
    while let Some(item) = reader.next_item().expect("memory can be read") {
        match item {
            Item::Message(message) => {
                messages += 1;
                if let Some(turn) = tape::read(&message.data) {
                    assert!(turn.frames().count() < 100_000);
                }
            }
            Item::Metadata(_, values) => {
                let _ = Identity::of_metadata(&values);
                let _ = Stage::of_metadata(&values);
            }
            Item::Schema(_) | Item::Channel(_) | Item::Attachment(_) => {}
        }
    }
    let mut reader = Reader::of(Path::new("hostile"), Cursor::new(bytes.to_vec())).expect("as before");
    // What a writer refuses is an error.
    let _ = copy(&mut reader, Vec::new(), Cursor::new(Vec::new()));
    messages
}

/// Numbers that lengths and counts break at.
const NUMBERS: [u64; 12] =
    [0, 1, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 1 << 31, 1 << 40, u64::MAX, u64::MAX - 8, i64::MAX as u64];

fn mutate(bytes: &mut Vec<u8>, random: &mut impl Rng) {
    for _ in 0..random.random_range(1..5) {
        if bytes.len() < 16 {
            return;
        }
        let at = random.random_range(0..bytes.len() - 8);
        match random.random_range(0..7) {
            0 => bytes[at] = random.random(),
            1 => {
                let number = NUMBERS[random.random_range(0..NUMBERS.len())].to_le_bytes();
                let width = [2, 4, 8][random.random_range(0..3)];
                bytes[at..at + width].copy_from_slice(&number[..width]);
            }
            2 => bytes.truncate(at),
            3 => {
                let piece = bytes[at..(at + random.random_range(1..400)).min(bytes.len())].to_vec();
                let to = random.random_range(0..bytes.len());
                bytes.splice(to..to, piece);
            }
            4 => drop(bytes.drain(at..(at + random.random_range(1..400)).min(bytes.len()))),
            5 => bytes[at] = [1, 2, 3, 4, 5, 6, 7, 9, 12, 15, 0x80, 0xff][random.random_range(0..12)],
            _ => checked(bytes, random),
        }
    }
}

/// Changes bytes in a chunk and gives it the checksum that fits, as somebody would who wants them to be believed.
fn checked(bytes: &mut [u8], random: &mut impl Rng) {
    let mut at = 8;
    let mut chunks = Vec::new();
    while at + 9 < bytes.len() {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
        let Some(end) = usize::try_from(length).ok().and_then(|l| l.checked_add(at + 9)).filter(|e| *e <= bytes.len())
        else {
            break;
        };
        if bytes[at] == 6 && length > 60 {
            chunks.push(at..end);
        }
        at = end;
    }
    if chunks.is_empty() {
        return;
    }
    let chunk = chunks[random.random_range(0..chunks.len())].clone();
    let elements = chunk.start + 9 + 40..chunk.end;
    for _ in 0..random.random_range(1..4) {
        let at = random.random_range(elements.clone());
        let number = NUMBERS[random.random_range(0..NUMBERS.len())].to_le_bytes();
        let width = [1, 2, 4, 8][random.random_range(0..4)].min(elements.end - at);
        bytes[at..at + width].copy_from_slice(&number[..width]);
    }
    let crc = crc32fast::hash(&bytes[elements]);
    bytes[chunk.start + 9 + 24..chunk.start + 9 + 28].copy_from_slice(&crc.to_le_bytes());
}

#[test]
fn no_mutation_of_a_record_ends_in_a_panic_or_takes_long() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("whole.mcap");
    in_chunks(&path);
    let whole = std::fs::read(&path).unwrap();
    // A short one, so that most mutations hit its structure.
    let short = [&whole[..12_000.min(whole.len())], &whole[whole.len() - 12_000..]].concat();
    let count: u32 = std::env::var("MURMURATE_MUTATIONS").map_or(600, |count| count.parse().expect("a number"));
    let mut random = Seed::of_run(45).stream("mutations");
    assert!(read_all(&whole) > 500);
    for number in 0..count {
        let mut bytes = if number % 4 == 0 { whole.clone() } else { short.clone() };
        mutate(&mut bytes, &mut random);
        let begun = Instant::now();
        read_all(&bytes);
        // A hang, not a slow machine: such a file takes milliseconds.
        assert!(begun.elapsed() < Duration::from_secs(20), "number {number}: {:?}", begun.elapsed());
    }
}

/// An element with a length that need not be its own.
fn element(opcode: u8, length: u64, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &length.to_le_bytes(), body].concat()
}

#[test]
fn lengths_that_lie_are_refused_by_all_commands_within_256_mb() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    in_chunks(&path("whole.mcap"));
    let magic = b"\x89MCAP0\r\n".to_vec();
    let header = element(1, 8, &[0; 8]);
    // The content of an attachment, longer than its element.
    let mut attachment = [0; 16].to_vec();
    attachment.extend([1, 0, 0, 0, b'a', 0, 0, 0, 0]);
    attachment.extend(u64::from(u32::MAX).to_le_bytes());
    attachment.extend([0; 12]);
    let long = [&magic[..], &header, &element(9, attachment.len() as u64, &attachment)].concat();
    // A chunk of two GB before compression, and one of 64 kB that says that it is of 30 MB.
    let chunk = |size: u64, kind: &str, elements: &[u8]| {
        let mut body = [0; 16].to_vec();
        body.extend(size.to_le_bytes());
        body.extend([0; 4]);
        body.extend((kind.len() as u32).to_le_bytes());
        body.extend(kind.as_bytes());
        body.extend((elements.len() as u64).to_le_bytes());
        body.extend(elements);
        element(6, body.len() as u64, &body)
    };
    let packed = ruzstd::encoding::compress_to_vec(&[0u8; 40_000_000][..], ruzstd::encoding::CompressionLevel::Fastest);
    let reserve = [&magic[..], &header, &chunk(1 << 31, "zstd", &packed)].concat();
    let bomb =
        [&magic[..], &header, &chunk(1 << 25, "zstd", &packed), &chunk(40_000_000, "lz4", &[4; 70_000])].concat();
    let whole = std::fs::read(path("whole.mcap")).unwrap();
    // Attached files without end: more than is read.
    let mut many = whole[..whole.len() / 2].to_vec();
    let piece = [&attachment[..25], &(20u64 << 20).to_le_bytes(), &vec![7; 20 << 20], &[0; 4]].concat();
    (0..8).for_each(|_| many.extend(element(9, piece.len() as u64, &piece)));
    for (name, bytes) in [("long", long), ("reserve", reserve), ("bomb", bomb), ("many", many)] {
        let file = path(&format!("{name}.mcap"));
        std::fs::write(&file, bytes).unwrap();
        let file = file.to_str().unwrap();
        let csv = path("out.csv");
        let csv = csv.to_str().unwrap();
        let merged = path("merged");
        let commands: [&[&str]; 5] = [
            &["record", "info", file],
            &["replay", file],
            &["record", "export", file, "--trajectories", csv],
            &["record", "merge", file, "-o", merged.to_str().unwrap()],
            &["record", "repair", file],
        ];
        for command in commands {
            // A limit of 256 MB on what it may write to in memory.
            let limited = ["-c", "ulimit -d 262144 && exec \"$0\" \"$@\""];
            let program = murmurate(&[]).get_program().to_owned();
            let mut sh = std::process::Command::new("bash");
            let output = sh.args(limited).arg(program).args(command).env_remove("MURMURATE_LOG").output().unwrap();
            let code = output.status.code();
            let said = text(&output.stderr);
            assert!(matches!(code, Some(0..=2)), "{name}: {command:?}: {code:?} {said}");
        }
    }
}

#[test]
fn records_that_are_pipes_or_devices_are_refused_at_once() {
    let folder = TempDir::new().unwrap();
    let pipe = folder.path().join("pipe.mcap");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for path in [pipe.to_str().unwrap(), "/dev/zero"] {
        for command in [&["record", "info"][..], &["replay"], &["record", "repair"], &["replay", "--watch"]] {
            let output = murmurate(&[command, &[path]].concat()).output().unwrap();
            let said = text(&output.stderr);
            assert!(
                output.status.code() == Some(2) && said.contains("not a regular file"),
                "{command:?} {path}: {said}"
            );
        }
    }
}

/// A record with other arguments than those with which it was made.
fn with_arguments(from: &Path, to: &Path, change: impl Fn(&mut Vec<String>)) {
    let mut reader = Reader::open(from).unwrap();
    let mut writer = mcap::Writer::new(std::fs::File::create(to).unwrap()).unwrap();
    while let Some(item) = reader.next_item().unwrap() {
        if let Item::Metadata(name, mut metadata) = item
            && name != "murmurate.digest"
        {
            if let Some(arguments) = metadata.get_mut("arguments") {
                let mut all: Vec<String> = serde_json::from_str(arguments).unwrap();
                change(&mut all);
                *arguments = serde_json::to_string(&all).unwrap();
            }
            writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn a_replay_opens_no_file_that_a_record_names_and_does_not_have() {
    let folder = TempDir::new().unwrap();
    let runs = folder.path().join("runs");
    let sim = ["sim", "--mode", "centralized", "--episodes", "1", "--repeats", "1", "--record", runs.to_str().unwrap()];
    assert!(run(&sim).status.success());
    let (record, forged) = (crate::records(&runs).remove(0), folder.path().join("forged.mcap"));
    let secret = folder.path().join("secret.toml");
    std::fs::write(&secret, "word = 1\n").unwrap();
    let pipe = folder.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for named in [secret.to_str().unwrap(), pipe.to_str().unwrap(), "/dev/zero"] {
        for flag in ["--policy", "--faults", "--conditions", "--radio", "--episodes-file"] {
            with_arguments(&record, &forged, |arguments| arguments.extend([flag.to_owned(), named.to_owned()]));
            let output = run(&["replay", forged.to_str().unwrap()]);
            let said = text(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{flag} {named}: {said}");
            let refused = said.contains("does not have it") || said.contains("not understood");
            assert!(refused && !said.contains("word"), "{flag} {named}: {said}");
        }
    }
}
