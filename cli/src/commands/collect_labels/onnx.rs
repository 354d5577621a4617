//! Networks in ONNX files.

use super::args::Args;
use crate::error::WrongUse;
use crate::session::Session;
use anyhow::Result;
use scenesplat::collection::{PictureEncoder, Segmenter};

#[cfg(feature = "onnx")]
use crate::receipt::sha256_of;
#[cfg(feature = "onnx")]
use anyhow::Context;
#[cfg(feature = "onnx")]
use scenesplat::picture_networks::{MaskSegments, OnnxCrops};
#[cfg(feature = "onnx")]
use scenesplat::vision::onnx::{OnnxClicks, OnnxEncoder, OnnxRuntime};

/// What `--segments onnx` asks for.
#[cfg(feature = "onnx")]
pub(super) fn segments(session: &Session<'_>, args: &Args) -> Result<Box<dyn Segmenter>> {
    let flag = "--segments onnx needs --onnx-segments, the folder with encoder.onnx and decoder.onnx; superpixels need no \
                weights";
    let folder = args.onnx_segments.as_ref().ok_or_else(|| WrongUse(flag.to_owned()))?;
    session.outputs.reads(folder)?;
    session.receipt.fingerprint("onnx segments", folder)?;
    let runtime = runtime(session, args)?;
    let name = format!("onnx {} {}", sha256_of(folder)?.0, runtime.build());
    let network = OnnxClicks::open(&runtime, folder)?;
    Ok(Box::new(MaskSegments::new(network, args.mask_settings(), &name)?))
}

/// What `--features onnx` asks for.
#[cfg(feature = "onnx")]
pub(super) fn features(session: &Session<'_>, args: &Args) -> Result<Box<dyn PictureEncoder>> {
    let flag = "--features onnx needs --onnx-features, the ONNX file of a picture encoder; colour needs no weights";
    let path = args.onnx_features.as_ref().ok_or_else(|| WrongUse(flag.to_owned()))?;
    session.outputs.reads(path)?;
    session.receipt.fingerprint("onnx features", path)?;
    let runtime = runtime(session, args)?;
    let encoder = OnnxEncoder::open(&runtime, path)?;
    // What is beside the file says how pictures are brought to its size, so another one gives other rows.
    let name = format!("onnx {} {encoder:?} {}", sha256_of(path)?.0, runtime.build());
    Ok(Box::new(OnnxCrops::new(encoder, &name)))
}

#[cfg(feature = "onnx")]
fn runtime(session: &Session<'_>, args: &Args) -> Result<OnnxRuntime> {
    let runtime = OnnxRuntime::load(args.onnx_runtime.as_deref()).context("--onnx-runtime")?;
    session.receipt.setting("onnx_runtime", runtime.build(), "the library that was loaded");
    Ok(runtime)
}

#[cfg(not(feature = "onnx"))]
pub(super) fn segments(_: &Session<'_>, _: &Args) -> Result<Box<dyn Segmenter>> {
    Err(not_built("--segments onnx"))
}

#[cfg(not(feature = "onnx"))]
pub(super) fn features(_: &Session<'_>, _: &Args) -> Result<Box<dyn PictureEncoder>> {
    Err(not_built("--features onnx"))
}

#[cfg(not(feature = "onnx"))]
fn not_built(flag: &str) -> anyhow::Error {
    WrongUse(format!(
        "{flag}: this program was built without it; cargo build --release -p scenesplat-cli --features onnx has it (it needs \
         no further library to build, and ONNX Runtime's to run)"
    ))
    .into()
}
