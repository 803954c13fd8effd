//! Tests of the library of tasks: whole trials with its scenarios and policies.

mod coverage;
mod field;
mod formation;
