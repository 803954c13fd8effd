//! The network study: its stations beside those of others, and what a growing team costs.

mod fast_dds;
mod growth;
