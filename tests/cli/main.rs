//! Tests of the command line: commands that end by themselves, their output, files and refusals.

mod commands;
mod devices;
mod keys;
mod onnx;
mod outside;
mod pages;
mod pictures;
mod policies;
#[path = "../program/mod.rs"]
mod program;
mod refusals;
mod robotarium;
mod roles;
mod shells;
mod sizes;
mod study;
mod study_commbench;
mod study_network;
mod study_sweep;
mod task_files;
mod teams;
mod train;
