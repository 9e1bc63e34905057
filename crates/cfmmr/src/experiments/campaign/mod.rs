//! Campaigns: seeded Monte Carlo studies over variations of a scenario, computed in independent parts (shards).
//!
//! [`study`] defines each run; [`parts`] computes and merges runs; [`directory`] stores runs in blocks, one file of
//! JSON lines each; [`rows`] holds results; [`report`] summarises. A run or a block depends only on the study and its
//! own number, so any number of shards gives the same files.

pub mod directory;
pub mod parts;
pub mod pictures;
pub mod report;
pub mod rows;
pub mod shard;
pub mod study;

#[cfg(test)]
mod tests;
