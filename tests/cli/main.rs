//! Tests of the command line: commands that end by themselves, their output, files and refusals.

mod devices;
#[cfg(feature = "train")]
mod keys;
#[cfg(feature = "train")]
mod outside;
#[cfg(feature = "train")]
mod pages;
#[cfg(feature = "sim")]
mod pictures;
mod policies;
#[path = "../program/mod.rs"]
mod program;
#[cfg(feature = "train")]
mod refusals;
mod robot;
#[cfg(feature = "completions")]
mod shells;
#[cfg(feature = "train")]
mod sizes;
#[cfg(feature = "study")]
mod study;
#[cfg(feature = "study")]
mod study_network;
#[cfg(all(feature = "rigid", feature = "sim"))]
mod teams;
#[cfg(feature = "train")]
mod train;
