//! Numerics of policies: gradients, whole trainings, files from Python, and allocations of a step.

mod allocation;
mod gradients;
mod python_export;
mod training;
