//! Folders with a bad file among good ones, copies of records, and files of other programs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use murmurate_record::reader::{Item, Reader};
use tempfile::TempDir;

use crate::program::{refuses, run, text};
use crate::records;

fn simulated(folder: &Path, seed: &str) -> PathBuf {
    let to = folder.to_str().unwrap();
    let sim = ["sim", "--mode", "centralized", "--episodes", "1", "--repeats", "1", "--seed", seed, "--record", to];
    assert!(run(&sim).status.success());
    records(folder).remove(0)
}

fn said(args: &[&str]) -> (i32, String, String) {
    let output = run(args);
    (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
}

/// A file of another program: two channels of one topic, each with a schema and properties of its own.
fn foreign(path: &Path, whole: bool) {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let options = WriteOptions::new().compression(None).profile("ros2").library("rosbag2");
    let mut writer: Writer<_> = options.chunk_size(Some(600)).create(&mut bytes).unwrap();
    let channels = [("Twist", "x"), ("TwistStamped", "y")].map(|(name, quality)| {
        let schema = writer.add_schema(&format!("geometry_msgs/msg/{name}"), "ros2msg", name.as_bytes()).unwrap();
        let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), quality.to_owned())]);
        writer.add_channel(schema, "/cmd_vel", "cdr", &metadata).unwrap()
    });
    for number in 0..50u32 {
        let channel_id = channels[number as usize % 2];
        let log_time = 1_000_000_000 + u64::from(number) * 10_000_000;
        let header = MessageHeader { channel_id, sequence: 7 * number, log_time, publish_time: log_time - 5_000_000 };
        let text = format!("{}{number:02}", ["T", "S"][number as usize % 2]);
        writer.write_to_known_channel(&header, text.as_bytes()).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let bytes = bytes.into_inner();
    std::fs::write(path, if whole { &bytes[..] } else { &bytes[..2500] }).unwrap();
}

#[test]
fn one_bad_file_is_named_and_left_out_and_does_not_spoil_the_folder() {
    let folder = TempDir::new().unwrap();
    let good = simulated(&folder.path().join("runs"), "1");
    let runs = folder.path().join("runs");
    let of = runs.to_str().unwrap();
    assert_eq!(said(&["replay", of]).0, 0);
    type Make = fn(&Path);
    let bad: [(&str, &str, Make); 5] = [
        ("empty", "empty: nothing was written", |path| std::fs::write(path, "").unwrap()),
        ("zeroed", "nothing was written but zeros", |path| std::fs::write(path, [0; 40_000]).unwrap()),
        ("foreign", "no record of this program", |path| foreign(path, true)),
        ("text", "it is no MCAP file", |path| std::fs::write(path, "a, b\n".repeat(900)).unwrap()),
        ("folder", "not a regular file", |path| std::fs::create_dir(path).unwrap()),
    ];
    for (name, why, make) in bad {
        let path = runs.join(format!("{name}.mcap"));
        make(&path);
        let (code, out, err) = said(&["replay", of]);
        assert!(code == 1 && out.contains("equal, "), "{name}: {code} {out}{err}");
        assert!(
            err.contains("left out") && err.contains(&format!("{name}.mcap")) && err.contains(why),
            "{name}: {err}"
        );
        let (code, out, err) = said(&["record", "info", of]);
        // A whole file of another program is whole.
        assert!(
            code == i32::from(name != "foreign") && out.contains("whole") && out.contains(&format!("{name}.mcap")),
            "{name}: {out}{err}"
        );
        let (code, _, err) = said(&["replay", path.to_str().unwrap()]);
        assert!(code == 2 && (name == "folder" || err.contains(why)), "{name} alone: {code} {err}");
        if path.is_dir() { std::fs::remove_dir(&path).unwrap() } else { std::fs::remove_file(&path).unwrap() }
    }
    // A copy counts once, and the whole one of two is taken.
    let bytes = std::fs::read(&good).unwrap();
    std::fs::write(runs.join("a-cut-copy.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(runs.join("z-copy.mcap"), &bytes).unwrap();
    let (code, out, err) = said(&["replay", of]);
    assert_eq!((code, out.matches("equal, ").count()), (0, 1), "{out}{err}");
    assert!(!out.contains("cut") && err.matches("counts once").count() == 2, "{out}{err}");
}

#[test]
fn a_repair_of_another_program_s_file_keeps_channels_schemas_times_and_numbers() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("bag.mcap");
    foreign(&path, false);
    let before = everything(&path);
    assert!(before.len() > 20, "{}", before.len());
    let (code, _, err) = said(&["record", "repair", path.to_str().unwrap()]);
    assert_eq!(code, 0, "{err}");
    assert_eq!(everything(&path), before);
    let said = text(&run(&["record", "info", path.to_str().unwrap()]).stdout);
    assert!(said.contains("whole") && said.contains("/cmd_vel"), "{said}");
    assert_eq!(Reader::open(&path).unwrap().profile(), "ros2");
    // A second repair does not write over the first original.
    std::fs::write(&path, &std::fs::read(&path).unwrap()[..2000]).unwrap();
    refuses(&["record", "repair", path.to_str().unwrap()], &["bag.mcap.cut", "is there already"]);
}

/// Channel, schema, quality, number, two times and bytes of a message.
type Whole = (u16, String, String, u32, u64, u64, Vec<u8>);

/// All messages of a file, each with its channel's schema and properties, its number and its times.
fn everything(path: &Path) -> Vec<Whole> {
    let mut reader = Reader::open(path).unwrap();
    let (mut schemas, mut all) = (BTreeMap::new(), Vec::new());
    while let Some(item) = reader.next_item().unwrap() {
        match item {
            Item::Schema(schema) => drop(schemas.insert(schema.id, schema.name.clone())),
            Item::Message(message) => {
                let (channel, schema) = (&message.channel, schemas[&message.channel.schema].clone());
                let quality = channel.metadata["offered_qos_profiles"].clone();
                all.push((channel.id, schema, quality, message.sequence, message.at, message.published, message.data));
            }
            _ => {}
        }
    }
    for (_, schema, quality, number, at, published, data) in &all {
        let expected =
            if data[0] == b'T' { ("geometry_msgs/msg/Twist", "x") } else { ("geometry_msgs/msg/TwistStamped", "y") };
        assert_eq!((&**schema, &**quality), expected);
        assert_eq!((*at - published, number % 7), (5_000_000, 0));
    }
    all
}

#[test]
fn files_of_other_programs_without_checksums_are_whole_and_unchecked() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("bare.mcap");
    let options = WriteOptions::new().compression(None).calculate_chunk_crcs(false).calculate_data_section_crc(false);
    let mut writer =
        options.calculate_summary_section_crc(false).create(std::fs::File::create(&path).unwrap()).unwrap();
    let channel_id = writer.add_channel(0, "/a", "json", &BTreeMap::new()).unwrap();
    let header = MessageHeader { channel_id, sequence: 0, log_time: 1, publish_time: 1 };
    writer.write_to_known_channel(&header, b"{}").unwrap();
    writer.finish().unwrap();
    let (code, out, _) = said(&["record", "info", path.to_str().unwrap()]);
    assert!(code == 0 && out.contains("whole, unchecked"), "{out}");
}

#[test]
fn messages_that_only_the_checksum_of_the_file_covers_are_not_used_if_it_is_wrong() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("theirs.mcap");
    for in_chunks in [true, false] {
        let options = WriteOptions::new().compression(None).use_chunks(in_chunks);
        let mut writer = options.create(std::fs::File::create(&path).unwrap()).unwrap();
        let channel_id = writer.add_channel(0, "/a", "json", &BTreeMap::new()).unwrap();
        for sequence in 0..50 {
            let header = MessageHeader { channel_id, sequence, log_time: 9, publish_time: 9 };
            writer.write_to_known_channel(&header, b"{\"number\":40}").unwrap();
        }
        writer.finish().unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        let (mut at, mut chunks) = (8, 0);
        while bytes[at] != 0x0F {
            if bytes[at] == 6 {
                bytes[at + 33..at + 37].fill(0);
                chunks += 1;
            }
            at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        }
        assert_eq!(chunks > 0, in_chunks);
        let crc = crc32fast::hash(&bytes[..at]);
        bytes[at + 9..at + 13].copy_from_slice(&crc.to_le_bytes());
        std::fs::write(&path, bytes).unwrap();
        let (code, out, _) = said(&["record", "info", path.to_str().unwrap()]);
        assert!(code == 0 && out.contains("whole\n") && out.contains("50  /a"), "{out}");
        let mut bytes = std::fs::read(&path).unwrap();
        let at = bytes.windows(3).position(|window| window == b":40").unwrap() + 1;
        bytes[at] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let (code, out, _) = said(&["record", "info", path.to_str().unwrap()]);
        assert!(code == 1 && out.contains("DAMAGED") && !out.contains("/a"), "{out}");
        assert!(out.contains("messages that have none of their own"), "{out}");
    }
}

/// The same record with its chunks compressed, each as one frame.
fn compressed(from: &Path, to: &Path, kind: &str) {
    let bytes = std::fs::read(from).unwrap();
    let (mut copy, mut at) = (bytes[..8].to_vec(), 8);
    while at + 9 < bytes.len() - 8 {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        let body = &bytes[at + 9..at + 9 + length];
        match bytes[at] {
            6 => {
                let elements = &body[40..];
                let packed = match kind {
                    "zstd" => ruzstd::encoding::compress_to_vec(elements, ruzstd::encoding::CompressionLevel::Fastest),
                    _ => {
                        let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
                        std::io::Write::write_all(&mut encoder, elements).unwrap();
                        encoder.finish().unwrap()
                    }
                };
                let mut chunk = body[..28].to_vec();
                chunk.extend((kind.len() as u32).to_le_bytes());
                chunk.extend(kind.as_bytes());
                chunk.extend((packed.len() as u64).to_le_bytes());
                chunk.extend(packed);
                copy.push(6);
                copy.extend((chunk.len() as u64).to_le_bytes());
                copy.extend(chunk);
            }
            // Indexes hold places, which have changed.
            7 => {}
            0x0F => {
                copy.extend([0x0F, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
                copy.extend([0x02, 20, 0, 0, 0, 0, 0, 0, 0]);
                copy.extend([0; 20]);
                break;
            }
            _ => copy.extend(&bytes[at..at + 9 + length]),
        }
        at += 9 + length;
    }
    copy.extend(&bytes[bytes.len() - 8..]);
    std::fs::write(to, copy).unwrap();
}

#[test]
fn compressed_copies_of_a_record_are_read_and_replay_equal() {
    let folder = TempDir::new().unwrap();
    let record = simulated(&folder.path().join("runs"), "1");
    for kind in ["zstd", "lz4"] {
        let copy = folder.path().join(format!("{kind}.mcap"));
        compressed(&record, &copy, kind);
        let size = |path: &Path| path.metadata().unwrap().len();
        assert!(size(&copy) < size(&record), "{kind}: {} of {}", size(&copy), size(&record));
        let (code, out, err) = said(&["replay", copy.to_str().unwrap()]);
        assert!(code == 0 && out.contains("equal, "), "{kind}: {out}{err}");
        let (code, out, _) = said(&["record", "info", copy.to_str().unwrap()]);
        assert!(code == 0 && out.contains("whole"), "{kind}: {out}");
        // A flipped bit is found in these, too.
        let mut bytes = std::fs::read(&copy).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 4;
        std::fs::write(&copy, bytes).unwrap();
        let (code, out, _) = said(&["record", "info", copy.to_str().unwrap()]);
        assert!(code == 1 && out.contains("DAMAGED"), "{kind}: {out}");
    }
}
