//! The flags of each command that can be called.

use super::failure::from_usage;
use crate::commands::{LabelArgs, Labelling, evaluate, inspect, query};
use crate::effects::EffectArgs;
use crate::flags::Inference;
use anyhow::Result;
use clap::Parser;
use std::ffi::OsString;

/// Of a network.
#[derive(Debug, Parser)]
pub struct NetworkFlags {
    #[command(flatten)]
    pub inference: Inference,
}

/// Of how a scene lies.
#[derive(Debug, Parser)]
pub struct AlignFlags {
    #[command(flatten)]
    pub inference: Inference,
}

/// Of `features`.
#[derive(Debug, Parser)]
pub struct FeatureFlags {
    #[command(flatten)]
    pub effects: EffectArgs,
    #[command(flatten)]
    pub inference: Inference,
}

/// Of `segment`.
#[derive(Debug, Parser)]
pub struct SegmentFlags {
    #[command(flatten)]
    pub labelling: Labelling,
}

/// Of `query`.
#[derive(Debug, Parser)]
pub struct QueryFlags {
    #[command(flatten)]
    pub args: query::Args,
}

/// Of `objects`.
#[derive(Debug, Parser)]
pub struct ObjectFlags {
    #[command(flatten)]
    pub labels: LabelArgs,
}

/// Of `evaluate`.
#[derive(Debug, Parser)]
pub struct EvaluateFlags {
    #[command(flatten)]
    pub args: evaluate::Args,
}

/// Of `inspect`.
#[derive(Debug, Parser)]
pub struct InspectFlags {
    #[command(flatten)]
    pub args: inspect::Args,
}

/// Reads flags, without the name of a program in front.
pub fn parse<P: Parser>(flags: &[OsString]) -> Result<P> {
    let words = std::iter::once(OsString::from("scenesplat")).chain(flags.iter().cloned());
    P::try_parse_from(words).map_err(|error| from_usage(&error))
}
