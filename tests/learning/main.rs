//! Numerics of policies: gradients, whole trainings, files from Python, graph convolutions, and allocations of a step.

mod allocation;
mod channel;
mod convolutions;
mod experts;
mod gradients;
mod imitation;
mod memory;
mod python_export;
mod recurrent;
mod roles;
mod sensing;
mod training;
