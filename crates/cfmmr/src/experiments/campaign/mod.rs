//! Campaigns: seeded Monte Carlo studies over variations of a scenario, in parts that need not know
//! of each other.
//!
//! [`study`] says what each run is; [`parts`] computes and merges them; [`directory`] keeps the runs in blocks, each a file of JSON lines;
//! [`rows`] are the results in it; [`report`] tells what came out. A run is a function of the study and
//! its number alone, and so is a block, so any number of shards gives the same files.

pub mod directory;
pub mod parts;
pub mod pictures;
pub mod report;
pub mod rows;
pub mod shard;
pub mod study;

#[cfg(test)]
mod tests;
