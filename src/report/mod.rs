//! Results of a run: episodes, counts, summaries and their tables. (Figures and pictures are in `crates/figures`.)

pub mod comparison;
pub mod cost;
pub mod event;
pub mod grid;
pub mod hardware;
pub mod outcomes;
pub mod statistics;
pub mod summary;
pub mod trial;
