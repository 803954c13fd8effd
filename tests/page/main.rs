//! The live page: its server against everything that it refuses, and the page in a real browser.

mod browser;
#[cfg(feature = "foxglove")]
mod foxglove;
mod http;
mod metrics;
mod pixels;
#[path = "../program/mod.rs"]
mod program;
mod refusals;
mod replay;
mod requests;
mod run;
mod slow;
