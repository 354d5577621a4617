//! The prims of a text layer: which are Gaussians, where they are, and what their attributes say.

use super::text::Text;
use super::{
    ANTIALIASED, CODEBOOK_AXES, CODEBOOK_MEAN, DEGREE, HARMONICS, INSTANCE, LANG_CODE, SEGMENT,
    SEGMENT_SCORE, TYPE,
};
use crate::SceneError;
use crate::formats::gltf::Affine;
use crate::frame::{Matrix3, transposed};
use crate::vector::rotation;
use half::f16;
use std::collections::BTreeMap;
use std::path::Path;

/// Deepest nesting of prims.
const MAX_DEPTH: usize = 64;

/// Gaussians as a prim has them.
#[derive(Default)]
pub(super) struct Prim {
    /// Where it is in the layer, such as `/World/Room`.
    pub place: String,
    /// From its coordinates to those of the layer.
    pub world: Affine,
    pub positions: Option<Vec<[f32; 3]>>,
    pub orientations: Option<Vec<[f32; 4]>>,
    pub scales: Option<Vec<[f32; 3]>>,
    pub opacities: Option<Vec<[f32; 1]>>,
    pub degree: Option<u32>,
    pub harmonics: Option<Vec<[f32; 3]>>,
    pub segment: Option<Vec<[i32; 1]>>,
    pub instance: Option<Vec<[i32; 1]>>,
    pub segment_score: Option<Vec<[f32; 1]>>,
    pub lang_code: Option<Vec<[f16; 1]>>,
    pub codebook_mean: Option<Vec<[f32; 1]>>,
    pub codebook_axes: Option<Vec<[f32; 1]>>,
    pub antialiased: bool,
    /// Arrays besides, which nothing here reads.
    pub unread: Vec<String>,
    /// Arrays that change with time, of which nothing is read.
    pub animated: Vec<String>,
}

/// What a layer holds.
#[derive(Default)]
pub(super) struct Layer {
    /// Meters a unit, if it says so.
    pub meters_per_unit: Option<f64>,
    /// `Y` or `Z`, if it says so.
    pub up_axis: Option<String>,
    pub prims: Vec<Prim>,
    /// Whether it refers to other files.
    pub refers: bool,
}

/// Transformations of a prim by name, and their order.
#[derive(Default)]
struct Moves {
    by_name: BTreeMap<String, Affine>,
    order: Vec<String>,
}

impl Layer {
    /// Reads the text of a layer.
    pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Self, SceneError> {
        let mut text = Text::new(bytes, path);
        let mut layer = Self::default();
        if text.take(b'(') {
            layer.read_about(&mut text)?;
        }
        while text.peek().is_some() {
            match text.word()? {
                "def" => layer.read_prim(&mut text, "", Affine::IDENTITY, true, 0)?,
                "over" | "class" => layer.read_prim(&mut text, "", Affine::IDENTITY, false, 0)?,
                _ => text.skip_value()?,
            }
        }
        Ok(layer)
    }

    /// What the layer says of itself.
    fn read_about(&mut self, text: &mut Text<'_>) -> Result<(), SceneError> {
        while !text.take(b')') {
            if matches!(text.peek(), Some(b'"' | b'\'')) {
                text.string()?;
                continue;
            }
            let name = text.word()?;
            if !text.take(b'=') {
                continue;
            }
            match name {
                "metersPerUnit" => self.meters_per_unit = Some(text.number()?),
                "upAxis" => {
                    self.up_axis = Some(String::from_utf8_lossy(text.string()?).into_owned());
                }
                _ => {
                    self.refers |= name == "subLayers";
                    text.skip_value()?;
                }
            }
        }
        Ok(())
    }

    /// Reads a prim behind its first word, and what is below it. `is_defined`: not of a class or an override.
    fn read_prim(
        &mut self,
        text: &mut Text<'_>,
        parent: &str,
        world: Affine,
        is_defined: bool,
        depth: usize,
    ) -> Result<(), SceneError> {
        if depth > MAX_DEPTH {
            return Err(text.error(format!("prims are nested deeper than {MAX_DEPTH}")));
        }
        let ty = match text.peek() {
            Some(b'"') => "",
            _ => text.word()?,
        };
        let name = String::from_utf8_lossy(text.string()?).into_owned();
        let place = format!("{parent}/{name}");
        if text.peek() == Some(b'(') {
            self.read_composition(text)?;
        }
        text.expect(b'{')?;
        let is_gaussians = is_defined && ty == TYPE;
        let mut prim = Prim { place: place.clone(), ..Prim::default() };
        let (mut moves, mut below) = (Moves::default(), Vec::new());
        while !text.take(b'}') {
            match text.word()? {
                word @ ("def" | "over" | "class") => {
                    // Where it is stands perhaps behind it.
                    below.push((text.clone(), is_defined && word == "def"));
                    skip_prim(text)?;
                }
                "variantSet" => {
                    text.string()?;
                    text.expect(b'=')?;
                    text.skip_value()?;
                }
                "reorder" => {
                    text.word()?;
                    text.expect(b'=')?;
                    text.skip_value()?;
                }
                word => read_property(text, word, is_gaussians.then_some(&mut prim), &mut moves)?,
            }
        }
        let world = moves.world(text, &place, world)?;
        for (mut text, is_defined) in below {
            self.read_prim(&mut text, &place, world, is_defined, depth + 1)?;
        }
        if is_gaussians {
            prim.world = world;
            self.prims.push(prim);
        }
        Ok(())
    }

    /// What stands in parentheses behind the name of a prim.
    fn read_composition(&mut self, text: &mut Text<'_>) -> Result<(), SceneError> {
        text.expect(b'(')?;
        while !text.take(b')') {
            if matches!(text.peek(), Some(b'"' | b'\'')) {
                text.string()?;
                continue;
            }
            let name = text.word()?;
            self.refers |= ["references", "payload", "inherits", "specializes"].contains(&name);
            if text.take(b'=') {
                text.skip_value()?;
            }
        }
        Ok(())
    }
}

/// Goes behind a prim whose first word was read.
fn skip_prim(text: &mut Text<'_>) -> Result<(), SceneError> {
    if text.peek() != Some(b'"') {
        text.word()?;
    }
    text.string()?;
    if text.peek() == Some(b'(') {
        text.skip_brackets()?;
    }
    text.skip_brackets()
}

/// Reads a property whose first word was read, into the Gaussians if it is one of theirs.
fn read_property(
    text: &mut Text<'_>,
    first: &str,
    prim: Option<&mut Prim>,
    moves: &mut Moves,
) -> Result<(), SceneError> {
    let mut ty = first;
    while ["custom", "uniform", "varying", "config", "prepend", "append", "add", "delete"]
        .contains(&ty)
    {
        ty = text.word()?;
    }
    let name = text.word()?;
    if text.take(b'=') {
        let is_none = text.clone().word().is_ok_and(|word| word == "None");
        match prim {
            _ if is_none => text.skip_value()?,
            _ if name.starts_with("xformOp") => moves.read(text, name)?,
            Some(prim) => prim.read(text, ty, name)?,
            None => text.skip_value()?,
        }
    }
    if text.peek() == Some(b'(') {
        text.skip_brackets()?;
    }
    Ok(())
}

impl Prim {
    /// Reads the value of an attribute. Of numbers in two precisions the better ones are kept.
    fn read(&mut self, text: &mut Text<'_>, ty: &str, name: &str) -> Result<(), SceneError> {
        match name {
            "positions" => self.positions = Some(text.array()?),
            "orientations" => self.orientations = Some(text.array()?),
            "scales" => self.scales = Some(text.array()?),
            "opacities" => self.opacities = Some(text.array()?),
            HARMONICS => self.harmonics = Some(text.array()?),
            "positionsh" => or_half(&mut self.positions, text)?,
            "orientationsh" => or_half(&mut self.orientations, text)?,
            "scalesh" => or_half(&mut self.scales, text)?,
            "opacitiesh" => or_half(&mut self.opacities, text)?,
            "radiance:sphericalHarmonicsCoefficientsh" => or_half(&mut self.harmonics, text)?,
            DEGREE => self.degree = Some(text.number()?),
            SEGMENT => self.segment = Some(text.array()?),
            INSTANCE => self.instance = Some(text.array()?),
            SEGMENT_SCORE => self.segment_score = Some(text.array()?),
            LANG_CODE => self.lang_code = Some(text.array()?),
            CODEBOOK_MEAN => self.codebook_mean = Some(text.array()?),
            CODEBOOK_AXES => self.codebook_axes = Some(text.array()?),
            ANTIALIASED => self.antialiased = ["1", "true"].contains(&text.word()?),
            _ => {
                if name.ends_with(".timeSamples") {
                    self.animated.push(name.to_owned());
                } else if ty.ends_with("[]") && !["extent", "xformOpOrder"].contains(&name) {
                    self.unread.push(name.to_owned());
                }
                text.skip_value()?;
            }
        }
        Ok(())
    }
}

/// Reads an array in half precision, unless there is one in single precision.
fn or_half<const W: usize>(
    into: &mut Option<Vec<[f32; W]>>,
    text: &mut Text<'_>,
) -> Result<(), SceneError> {
    let values = text.array()?;
    into.get_or_insert(values);
    Ok(())
}

impl Moves {
    fn read(&mut self, text: &mut Text<'_>, name: &str) -> Result<(), SceneError> {
        if name == "xformOpOrder" {
            text.expect(b'[')?;
            while !text.take(b']') {
                self.order.push(String::from_utf8_lossy(text.string()?).into_owned());
                text.take(b',');
            }
            return Ok(());
        }
        let kind = name.split(':').nth(1).unwrap_or_default();
        let linear = |linear| Affine { linear, ..Affine::IDENTITY };
        let about = |axis: usize, degrees: f64| {
            let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
            let mut quat = [cos, 0.0, 0.0, 0.0];
            quat[1 + axis] = sin;
            linear(rotation(quat))
        };
        let by = match kind {
            "translate" => Affine { translation: text.tuple()?, ..Affine::IDENTITY },
            "scale" => {
                let factors: [f64; 3] = text.tuple()?;
                let mut by = Affine::IDENTITY;
                (0..3).for_each(|i| by.linear[i][i] = factors[i]);
                by
            }
            "orient" => {
                let quat: [f64; 4] = text.tuple()?;
                let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt();
                linear(rotation(quat.map(|v| v / norm)))
            }
            "rotateX" => about(0, text.number()?),
            "rotateY" => about(1, text.number()?),
            "rotateZ" => about(2, text.number()?),
            "transform" => matrix(text)?,
            kind if is_three_turns(kind) => {
                let degrees: [f64; 3] = text.tuple()?;
                let axes = kind.bytes().skip("rotate".len()).map(|axis| usize::from(axis - b'X'));
                // The first turn of the name is the first that is made.
                axes.fold(Affine::IDENTITY, |before, axis| {
                    about(axis, degrees[axis]).after(&before)
                })
            }
            // Of animated ones the error comes where they are used.
            _ => return text.skip_value(),
        };
        self.by_name.insert(name.to_owned(), by);
        Ok(())
    }

    /// From the coordinates of the prim to those of the layer; `parent`: from its parent's.
    fn world(&self, text: &Text<'_>, place: &str, parent: Affine) -> Result<Affine, SceneError> {
        let mut world = parent;
        for name in &self.order {
            if name == "!resetXformStack!" {
                world = Affine::IDENTITY;
                continue;
            }
            let Some(by) = self.by_name.get(name) else {
                return Err(text.error(format!("{place} is moved by {name}, which is not read")));
            };
            world = world.after(by);
        }
        Ok(world)
    }
}

fn is_three_turns(kind: &str) -> bool {
    let Some(axes) = kind.strip_prefix("rotate") else { return false };
    let mut sorted: Vec<u8> = axes.bytes().collect();
    sorted.sort_unstable();
    sorted == b"XYZ"
}

/// A matrix of four rows, by which rows are multiplied.
fn matrix(text: &mut Text<'_>) -> Result<Affine, SceneError> {
    let mut rows = [[0.0; 4]; 4];
    text.expect(b'(')?;
    for (i, row) in rows.iter_mut().enumerate() {
        if i > 0 {
            text.expect(b',')?;
        }
        *row = text.tuple()?;
    }
    text.expect(b')')?;
    let linear: Matrix3 = [0, 1, 2].map(|i| [rows[i][0], rows[i][1], rows[i][2]]);
    let [x, y, z, _] = rows[3];
    if rows.map(|row| row[3]) != [0.0, 0.0, 0.0, 1.0] {
        return Err(text.error("a matrix has a last column that is not 0, 0, 0, 1"));
    }
    Ok(Affine { linear: transposed(&linear), translation: [x, y, z] })
}
