//! Results of a run: episodes, counts, summaries and their tables. (Figures and pictures are in `crates/figures`.)

pub mod ages;
pub mod comparison;
pub mod cost;
pub mod episode;
pub mod event;
pub mod grid;
pub mod hardware;
pub mod listening;
pub mod outcomes;
pub mod statistics;
pub mod summary;
pub mod trial;
