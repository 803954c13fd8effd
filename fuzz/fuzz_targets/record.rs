//! Any bytes as the file of a record: survey, elements, identity, turns and the copy that a repair makes.
#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use murmurate_record::identity::Identity;
use murmurate_record::reader::{Item, Reader};
use murmurate_record::repair::copy;
use murmurate_record::stage::Stage;
use murmurate_record::tape;

fuzz_target!(|bytes: &[u8]| {
    let open = || Reader::of(Path::new("fuzzed"), Cursor::new(bytes.to_vec()));
    let Ok(mut reader) = open() else { return };
    while let Some(item) = reader.next_item().expect("memory can be read") {
        match item {
            Item::Message(message) => drop(tape::read(&message.data)),
            Item::Metadata(_, values) => drop((Identity::of_metadata(&values), Stage::of_metadata(&values))),
            Item::Schema(_) | Item::Channel(_) | Item::Attachment(_) => {}
        }
    }
    let whole = reader.health().is_whole();
    let mut again = open().expect("as before");
    let mut copied = Cursor::new(Vec::new());
    if copy(&mut again, Vec::new(), &mut copied).is_ok() {
        // A copy of what is intact has nothing that is not.
        let copied = Reader::of(Path::new("copied"), Cursor::new(copied.into_inner())).expect("it was written as MCAP");
        assert!(copied.health().is_whole() || !whole, "{:?}", copied.health());
    }
});
