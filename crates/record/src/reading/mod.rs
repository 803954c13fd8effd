//! Reading of MCAP files that may be damaged: what is intact in them, and what is not.
//!
//! The crate `mcap` writes our files. It ends at the first thing that is wrong in a file and trusts lengths that the
//! file states, so reading is here: [`element`] decodes single elements, [`chunk`] decompresses and checks a chunk,
//! [`source`] reads bytes at any place, and [`mod@survey`] finds the intact ranges of a whole file, [`damage`].

mod checks;
pub mod chunk;
pub mod damage;
pub mod element;
mod search;
pub mod source;
pub mod survey;
mod verdict;
