//! End-to-end tests, one module per subject. They are one test program because linking the whole workspace takes long.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may stop where it fails"
)]

mod architecture;
mod arm;
mod audit;
mod audit_page;
mod bad_input;
mod cli;
mod compare;
mod compare_shards;
mod dependencies;
mod encoder;
mod engines;
mod export;
mod file_locks;
mod foreign;
mod fuzz_corpus;
mod golden;
mod hdf5_damage;
mod identity;
mod image_rollouts;
mod images;
mod influence;
mod interrupt;
mod kill;
mod lerobot;
mod many_files;
mod network_mounts;
mod notebooks;
mod notes;
mod object_store;
mod parts;
mod pipeline;
mod policies;
mod query;
mod real_data;
mod relatives;
mod rendered;
mod report;
mod robomimic;
mod robosuite;
mod robosuite_rollouts;
mod rollouts;
mod scenes;
mod schemas;
mod source_changes;
mod spatial_report;
mod support;
mod train;
mod videos;
mod words;
mod worlds;
