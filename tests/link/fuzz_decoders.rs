//! Every decoder of the wire against seeded mutations of a committed corpus, for a bounded time: the part of fuzzing
//! that runs on any toolchain. `fuzz/` holds the coverage-guided targets over the same corpus.

use std::fs;
use std::path::Path;

use crate::rig::{LINK, config, network};
use murmurate::actor::Core;
use murmurate::actors::network::In;
use murmurate::net::protocol::codec::{self, Content, HEADER_BYTES};
use murmurate::net::protocol::parts::Lacking;
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::protocol::report::{Report, read_held, read_ids};
use murmurate::random::{Seed, Stream};
use murmurate::time::Time;
use rand::RngExt;

/// Number of mutations of each file of the corpus.
const ROUNDS: usize = 20_000;

pub fn corpus() -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/corpus");
    let mut paths: Vec<_> =
        fs::read_dir(folder).expect("a corpus").map(|entry| entry.expect("a file").path()).collect();
    paths.sort();
    assert!(paths.len() >= 7, "the corpus is committed");
    paths.iter().map(|path| fs::read(path).expect("a readable file")).collect()
}

/// Makes one to four changes: a bit, a byte, a piece removed, a piece duplicated, a piece of another file.
pub fn mutate(bytes: &mut Vec<u8>, other: &[u8], stream: &mut Stream) {
    for _ in 0..stream.random_range(1..=4) {
        if bytes.is_empty() {
            return;
        }
        let at = stream.random_range(0..bytes.len());
        let end = (at + stream.random_range(1..16)).min(bytes.len());
        match stream.random_range(0..5) {
            0 => bytes[at] ^= 1 << stream.random_range(0..8),
            1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xc4, 0xdd, 0xff][stream.random_range(0..7)],
            2 => drop(bytes.drain(at..end)),
            3 => {
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            _ => {
                let from = stream.random_range(0..other.len());
                let until = (from + stream.random_range(1..32)).min(other.len());
                bytes.splice(at..end, other[from..until].iter().copied());
            }
        }
    }
}

#[test]
fn no_decoder_accepts_an_invalid_mutation_of_the_corpus() {
    let corpus = corpus();
    let mut stream = Seed::of_run(1).stream("fuzz");
    let mut target = network(config(0, 4, 1, None, Setup::multicast(Reliabilities::new())));
    let mut out = Vec::new();
    let (mut decoded, mut refused) = (0u64, 0u64);
    for round in 0..ROUNDS * corpus.len() {
        let mut bytes = corpus[round % corpus.len()].clone();
        mutate(&mut bytes, &corpus[stream.random_range(0..corpus.len())], &mut stream);
        let _ = codec::peek(&bytes);
        let _ = codec::first(&bytes);
        for block in codec::blocks(&bytes) {
            let sound = match block {
                Ok((Content::Message(kind), body)) => {
                    codec::message(kind, body).map(|message| assert!(message.check().is_ok()))
                }
                Ok((content @ (Content::Report | Content::NumberedReport), body)) => {
                    Report::read(content, body).map(|report| {
                        let mut again = Vec::new();
                        report.write(&mut again);
                        assert_eq!(again, body, "what was read is what was written");
                    })
                }
                Ok((Content::Lacking, body)) => Lacking::read(body).map(drop),
                Ok((Content::Held, body)) => read_held(body).map(drop),
                Ok((content, body)) => read_ids(content, body).map(drop),
                Err(error) => Err(error),
            };
            *(if sound.is_ok() { &mut decoded } else { &mut refused }) += 1;
        }
        let _ = codec::decode(bytes.get(..bytes.len().min(HEADER_BYTES + 300)).unwrap_or_default());
        target.handle(Time::from_nanos(round as u64 * 1000), In::Frame(LINK, bytes.into(), None), &mut out);
        out.clear();
    }
    assert!(decoded > 1000 && refused > 1000, "{decoded} decoded, {refused} refused: the mutations bite");
}
