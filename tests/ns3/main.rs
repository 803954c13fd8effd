//! The radio channel beside runs of ns-3 3.44, which lie as tables outside the repository: `MURMURATE_RADIO_DATA`, or
//! `../shared/radio/data`. Without them each test says so, and tests nothing.

mod cases;
mod run;
#[path = "../skip/mod.rs"]
mod skip;
mod table;
