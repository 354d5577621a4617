//! Pictures as vectors, by an ONNX file.

use super::OnnxRuntime;
use super::model::{Array, Model, Port};
use crate::VisionError;
use crate::layers::to_directions;
use crate::siglip::Preprocessor;
use scenesplat_scene::picture::RgbPicture;
use std::path::Path;

/// Pictures that go through the network together, where the file takes any number.
const AT_ONCE: usize = 8;
/// Side of the pictures where neither the file nor `preprocessor_config.json` says it.
const SIDE: usize = 224;
/// Names of outputs that are vectors of pictures, the best first.
const OUTPUTS: [&str; 2] = ["image_embeds", "pooler_output"];

/// A picture encoder in an ONNX file: input `[N, 3, side, side]`, output `image_embeds` or `pooler_output`, or a single one,
/// `[N, D]`.
///
/// Pictures are squashed to the square with Pillow's rounding; `preprocessor_config.json` beside the file says filter, mean
/// and spread, without it they are SigLIP's.
pub struct OnnxEncoder {
    model: Model,
    input: Port,
    output: String,
    side: usize,
    width: usize,
    preprocessor: Preprocessor,
}

impl std::fmt::Debug for OnnxEncoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { side, width, output, preprocessor, .. } = self;
        let mut out = f.debug_struct("OnnxEncoder");
        out.field("side", side)
            .field("width", width)
            .field("output", output)
            .field("preprocessor", preprocessor)
            .finish_non_exhaustive()
    }
}

impl OnnxEncoder {
    /// Reads the file, and tries it on one picture.
    ///
    /// # Errors
    /// If the file is missing, ONNX Runtime refuses it, or an input or output has another name, shape or type.
    pub fn open(runtime: &OnnxRuntime, path: &Path) -> Result<Self, VisionError> {
        let model = Model::open(runtime, path)?;
        let [input] = model.inputs.as_slice() else {
            return Err(
                model.bad(format!("has {} inputs, expected one picture", model.inputs.len()))
            );
        };
        let input = input.clone();
        let named = |name: &&str| model.outputs.iter().any(|port| port.name == **name);
        let output = match (OUTPUTS.into_iter().find(|name| named(name)), model.outputs.as_slice())
        {
            (Some(name), _) => name.to_owned(),
            (None, [only]) => only.name.clone(),
            (None, several) => {
                let names: Vec<&str> = several.iter().map(|port| port.name.as_str()).collect();
                let problem = format!(
                    "its outputs are {}; one of them has to be {}",
                    names.join(", "),
                    OUTPUTS.join(" or ")
                );
                return Err(model.bad(problem));
            }
        };
        let folder = path.parent().unwrap_or(Path::new("."));
        let fixed = model.picture_side(&input)?;
        let (preprocessor, side) = Preprocessor::beside(folder, fixed, SIDE)?;
        let mut encoder = Self { model, input, output, side, width: 0, preprocessor };
        let rows = encoder.run(&[RgbPicture::filled(8, 8, [127; 3])])?;
        encoder.width = rows.len();
        Ok(encoder)
    }

    /// Length of a vector.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Side of the square that pictures are squashed to, pixels.
    pub fn image_size(&self) -> usize {
        self.side
    }

    /// The vectors of some pictures, of unit length. `[pictures, width]`
    ///
    /// # Errors
    /// If a picture has no pixels or no direction, or the network fails; the message counts from 0.
    pub fn encode(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, VisionError> {
        let lot = if self.input.shape[0] == 1 { 1 } else { AT_ONCE };
        let mut rows = Vec::with_capacity(pictures.len() * self.width);
        for pictures in pictures.chunks(lot) {
            rows.extend(self.run(pictures)?);
        }
        to_directions(&mut rows, self.width).map_err(|index| {
            let problem = "has no vector: the network gives it no direction";
            VisionError::input("picture", format!("number {index} {problem}"))
        })?;
        Ok(rows)
    }

    fn run(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, VisionError> {
        let mut values = Vec::with_capacity(pictures.len() * 3 * self.side * self.side);
        for picture in pictures {
            values.extend(self.preprocessor.planes(picture, self.side, true)?);
        }
        let side = self.side as i64;
        let input = Array { shape: vec![pictures.len() as i64, 3, side, side], values };
        let found = self.model.run(&[(&self.input.name, &input)], &[&self.output])?;
        let Some(array) = found.into_iter().next() else {
            return Err(self.model.bad("gave nothing"));
        };
        let is_rows = matches!(array.shape[..], [n, d] if n == pictures.len() as i64 && d > 0
            && (self.width == 0 || d == self.width as i64));
        if !is_rows {
            let problem = format!(
                "its output {:?} is {:?} for {} pictures, expected one row each",
                self.output,
                array.shape,
                pictures.len()
            );
            return Err(self.model.bad(problem));
        }
        Ok(array.values)
    }
}
