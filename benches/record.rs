//! Cost of recording for the thread that drives a robot: the times to queue one event and one turn, 500 times a second,
//! while another thread writes the file.
//!
//! `cargo bench --bench record` takes five seconds; as a test it takes a tenth of one.

use std::time::{Duration, Instant};

use murmurate::messages::ids::HostId;
use murmurate::net::protocol::codec::Frame;
use murmurate::time::Time;
use murmurate::trial::Trial;
use murmurate_record::file::Beginning;
use murmurate_record::identity::Identity;
use murmurate_record::queue::WhenFull;
use murmurate_record::series::Retention;
use murmurate_record::topics::{Stage, Topics};
use murmurate_record::writer::Recording;
use murmurate_record::{Event, Scope};

const RATE: u32 = 500;

fn main() {
    let measured = std::env::args().any(|argument| argument == "--bench");
    let count = RATE * if measured { 5 } else { 1 } / if measured { 1 } else { 10 };
    let folder = tempfile::TempDir::new().expect("a folder");
    let stage = Stage::of(&Trial::preset("offboard", "passage").expect("a preset"));
    let beginning = Beginning { identity: Identity::here("1f", Vec::new(), ""), attached: Vec::new() };
    let topics = Topics::new(stage, Scope::Host, 0);
    let path = folder.path().join("host.mcap");
    let recording =
        Recording::start(&path, &beginning, topics, (WhenFull::Drop, Retention::default())).expect("a record");
    let (inlet, frame) = (recording.inlet(), Frame::from([7; 171]));
    let (began, mut took) = (Instant::now(), Vec::new());
    for step in 0..count {
        let due = Duration::from_secs(1) * step / RATE;
        while let Some(rest) = due.checked_sub(began.elapsed()) {
            std::thread::park_timeout(rest);
        }
        let before = Instant::now();
        inlet.push(Event::Published(HostId(0), Frame::clone(&frame)));
        inlet.turn(Time::from_nanos(u64::from(step) * 2_000_000));
        took.push(before.elapsed().as_nanos());
    }
    let dropped = recording.finish(None).expect("it is written");
    took.sort_unstable();
    let quantile = |share: f64| took[((took.len() - 1) as f64 * share) as usize];
    assert_eq!(dropped, 0);
    println!("event and turn: p50 {} ns, p99 {} ns, longest {} ns", quantile(0.5), quantile(0.99), quantile(1.0));
}
