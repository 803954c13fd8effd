//! Any bytes for the reader that the environment variable READER names: files, and what devices say.
#![no_main]

#[path = "../../tests/hostile/contracts.rs"]
mod contracts;
#[path = "../../tests/hostile/readers.rs"]
mod readers;
#[cfg(feature = "train")]
#[path = "../../tests/hostile/trainings.rs"]
mod trainings;

use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;

/// A reader, which returns whether it accepts the bytes.
type Reader = fn(&[u8]) -> bool;

/// All readers by name.
const READERS: &[(&str, Reader)] = &[
    ("policy", readers::policy),
    ("contract", contracts::contract),
    ("graph", contracts::graph),
    ("python", contracts::python),
    ("roles", contracts::roles),
    ("team", readers::team),
    ("deployment", readers::deployment),
    ("faults", readers::faults),
    ("conditions", readers::conditions),
    ("radio", readers::radio),
    ("safety", readers::safety),
    ("episodes", readers::episodes),
    ("natnet", readers::natnet),
    ("gpsd", readers::gpsd),
    ("lines", readers::lines),
    ("robomaster", readers::robomaster),
    ("ros2", readers::ros2),
    #[cfg(feature = "train")]
    ("training", trainings::training),
    #[cfg(feature = "train")]
    ("checkpoint", trainings::checkpoint),
    #[cfg(feature = "train")]
    ("imitation", trainings::imitation),
    #[cfg(feature = "train")]
    ("journal", trainings::journal),
];

static READER: OnceLock<Reader> = OnceLock::new();

fuzz_target!(|bytes: &[u8]| {
    let read = READER.get_or_init(|| {
        let name = std::env::var("READER").expect("READER names a reader");
        READERS.iter().find(|(known, _)| *known == name).expect("there is such a reader").1
    });
    read(bytes);
});
