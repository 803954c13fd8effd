//! Results of a run: episodes, summaries, tables, figures and pictures.

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
