//! Policies as numbers: gradients, whole trainings, files from Python, and what a step allocates.

mod allocation;
mod gradients;
mod python_export;
mod training;
