//! Any bytes as a datagram: every block decoder, and what a message that gets through promises.
#![no_main]

use libfuzzer_sys::fuzz_target;
use murmurate::net::protocol::codec::{self, Content};
use murmurate::net::protocol::parts::Lacking;
use murmurate::net::protocol::report::{Report, read_held, read_ids};
use murmurate::net::protocol::roster;

fuzz_target!(|bytes: &[u8]| {
    let _ = codec::peek(bytes);
    let _ = codec::decode(bytes);
    for block in codec::blocks(bytes).flatten() {
        match block {
            (Content::Message(kind), body) => {
                if let Ok(message) = codec::message(kind, body) {
                    assert!(message.check().is_ok());
                }
            }
            (content @ (Content::Report | Content::NumberedReport), body) => drop(Report::read(content, body)),
            (Content::Lacking, body) => drop(Lacking::read(body)),
            (Content::Held, body) => drop(read_held(body)),
            (Content::Roster, body) => drop((roster::read(body), roster::read_page(body).map(drop))),
            (content, body) => drop(read_ids(content, body)),
        }
    }
});
