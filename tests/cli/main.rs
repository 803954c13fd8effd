//! The program as a user meets it: commands that end by themselves, their output, files and refusals.

#[cfg(unix)]
mod keys;
#[path = "../program/mod.rs"]
mod program;
mod refusals;
mod study;
mod study_network;
#[cfg(unix)]
mod teams;
mod train;
