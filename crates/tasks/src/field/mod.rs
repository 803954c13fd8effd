//! Flocking through a field of obstacles: a team keeps one velocity, that of its migration, and passes between discs.
//!
//! The task joins that of Tolstaya et al., CoRL 2019 (arXiv 1903.10527), which is the scenario `flocking`, with the
//! obstacles and the migration of Olfati-Saber, "Flocking for multi-agent dynamic systems: algorithms and theory", IEEE
//! Transactions on Automatic Control 51 (3), 2006.

pub mod policy;
pub mod scenario;
pub mod size;
