//! Training by imitation: a policy of several hops learns the actions of an expert that may know more than it hears.
//!
//! The policy drives in its own rollouts, and the expert says what it would have done in each of the states that occur:
//! DAgger (Ross, Gordon and Bagnell, AISTATS 2011, arXiv 1011.0686), in the form of online learning, in which each
//! iteration learns from its own episodes alone. So a checkpoint holds weights and no episodes. It is how Tolstaya et
//! al., CoRL 2019 (arXiv 1903.10527), train the policies of the scenario `flocking`.
//!
//! Pure, as all of training: no clock, file or actor. `trainer` is the entry point.

pub mod config;
pub mod episode;
pub mod learn;
pub mod setup;
pub mod trainer;
pub mod units;
