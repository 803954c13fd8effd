//! Any bytes as those of an autopilot: the frames in them, signatures, and what driver and source make of whole frames
//! with any content.
#![no_main]

use libfuzzer_sys::fuzz_target;
use murmurate::edge::Settings;
use murmurate::localization::In;
use murmurate::messages::ids::RobotId;
use murmurate::time::{Span, Time};
use murmurate_mavlink::frames::{self, Found, Framer, Splitter, Version};
use murmurate_mavlink::link::FromWorker;
use murmurate_mavlink::signing::{Key, Signer};
use murmurate_mavlink::{driver, source};

/// Settings by an odd and an even first byte: of a copter with ArduPilot, and of a rover with PX4.
const SETTINGS: [&str; 2] = [
    "address = 'udpin://127.0.0.1:14550'\nautopilot = 'px4'\nvehicle = 'rover'\nspeed_m_s = 0.6",
    "address = 'udpin://127.0.0.1:14550'\nautopilot = 'ardupilot'\nvehicle = 'copter'\nspeed_m_s = 0.6\narm = true",
];
const SOURCE: &str = "address = 'udpin://127.0.0.1:14551'\norigin_latitude_deg = 52.0\norigin_longitude_deg = 0.1";

fn settings(text: &str) -> Settings {
    Settings { name: "mavlink".to_owned(), table: text.parse().expect("TOML") }
}

/// Reads bytes as those of a line, in two pieces.
fn line(bytes: &[u8]) {
    let key = Key::read("0123456789abcdef".repeat(4).as_bytes()).expect("a key");
    let (mut splitter, mut signer) = (Splitter::default(), Signer::new(key));
    let mut each = |found: Found| {
        if let Found::Frame(frame) = found {
            assert!(frames::header(frame).is_some());
            let _ = frames::parse(frame);
            let _ = signer.check(1 << 40, &frames::raw(frame));
        }
    };
    let (first, second) = bytes.split_at(bytes.len() / 2);
    splitter.take(first, &mut each);
    splitter.take(second, &mut each);
    splitter.end();
}

/// Reads bytes as messages, each a number of a message, a length and its content, and returns whole frames with them.
fn whole(mut bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut framer = Framer::new(1, 1, Version::Two);
    let mut found = Vec::new();
    while let [low, high, length, rest @ ..] = bytes {
        let (payload, rest) = rest.split_at(usize::from(*length).min(rest.len()));
        let cut = [&[0xfd, payload.len() as u8, 0, 0, 0, 1, 1, *low, *high, 0][..], payload, &[0, 0]].concat();
        found.extend(frames::parse(&cut).ok().map(|received| framer.frame(1 << 40, &received.message)));
        bytes = rest;
    }
    found
}

fuzz_target!(|bytes: &[u8]| {
    line(bytes);
    let [first, bytes @ ..] = bytes else { return };
    let chosen = settings(SETTINGS[usize::from(first & 1)]);
    let mut driver = (driver::make(&chosen, RobotId(0)).expect("they are sound").driver)();
    let mut source = (source::make(&settings(SOURCE), &[RobotId(0)]).expect("they are sound").source)();
    let (mut now, mut out, mut read) = (Time::ZERO, Vec::new(), Vec::new());
    driver.receive(now, &FromWorker::Opened.encode(), &mut out);
    for frame in whole(bytes) {
        now = now + Span::from_millis(20);
        let packet = FromWorker::Frames(&frame).encode();
        driver.receive(now, &packet, &mut out);
        driver.wake(now, &mut out);
        source.take(now, In::Packet(&packet), &mut read);
    }
    driver.receive(now, bytes, &mut out);
    source.take(now, In::Packet(bytes), &mut read);
});
