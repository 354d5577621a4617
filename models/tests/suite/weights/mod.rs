//! Weight files of all kinds, whole and damaged.
//!
//! The files are in `tests/data`; their values are the integer hash, so each is known.

mod allocations;
mod containers;
mod damage;
mod fit;
mod folders;
mod hostile_config;
mod loading;
mod network;
mod round_trip;
mod wrapper;
