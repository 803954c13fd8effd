//! Results of a run: episodes, summaries, tables, figures and pictures.

pub mod ages;
pub mod comparison;
pub mod cost;
pub mod episode;
pub mod event;
#[cfg(feature = "report")]
pub mod figures;
pub mod grid;
pub mod hardware;
pub mod listening;
pub mod outcomes;
#[cfg(feature = "report")]
pub mod page;
pub mod picture;
#[cfg(feature = "png")]
pub mod png;
pub mod statistics;
pub mod summary;
pub mod trial;
