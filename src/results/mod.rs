//! Results of a run, as data: the result of an episode, the state of the team at a step, counts and trace. The Recorder
//! makes them, and reports summarise them.

pub mod ages;
pub mod episode;
pub mod hardware;
pub mod listening;
pub mod sensing;
pub mod totals;
