//! The program as a user runs it: files written, exit codes, messages, hostile input. Commands run in this process
//! (`scenesplat`); those that are about a process, or start some, run as one (`process`).

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod adapt;
mod bench;
mod budget;
mod chunk;
mod codes;
mod collect_end_to_end;
mod collect_labels;
mod command_line;
mod commands;
mod compare;
mod convert;
mod doctor;
mod effects;
mod first_screen;
mod gpu;
mod hostile;
mod inputs;
mod inspect;
mod lift_labels;
mod many;
mod networks;
mod objects;
mod optimise;
mod outputs;
mod own_labels;
mod pareto;
mod prepare;
mod prepare_frames;
mod probe;
mod reconstruct;
mod render;
mod room;
mod serve;
mod settings;
mod simulate;
mod strange;
mod support;
mod text;
mod text_model;
mod training;
mod trials;
mod upright;
