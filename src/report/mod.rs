//! What came of a run: episodes, their summary, and the tables that a person reads.

pub mod cost;
pub mod episode;
pub mod event;
pub mod statistics;
pub mod summary;
pub mod trial;
