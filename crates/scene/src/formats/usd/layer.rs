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
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Deepest nesting of prims.
const MAX_DEPTH: usize = 64;
/// Longest name of a prim, bytes.
const MAX_NAME: usize = 1024;

/// Gaussians as a prim has them.
pub(super) struct Prim {
    /// Where it is in the layer, such as `/World/Room`.
    pub place: String,
    /// From its coordinates to those of the layer, or why that cannot be said.
    pub world: World,
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
    /// Arrays besides, which nothing here reads: name and type.
    pub unread: Vec<[String; 2]>,
    /// Arrays that change with time, of which nothing is read.
    pub animated: Vec<String>,
}

/// Where a prim is, or why that cannot be said.
pub(super) type World = Result<Affine, String>;

/// What a layer holds.
#[derive(Default)]
pub(super) struct Layer {
    /// Meters a unit, if it says so.
    pub meters_per_unit: Option<f64>,
    /// `Y` or `Z`, if it says so.
    pub up_axis: Option<String>,
    /// The first prim of Gaussians.
    pub first: Option<Prim>,
    /// How many there are.
    pub count: usize,
    /// Whether it refers to other files or prims, or has variants.
    pub refers: bool,
}

/// Transformations of a prim by name, and their order.
#[derive(Default)]
struct Moves {
    by_name: BTreeMap<String, Affine>,
    /// Those that change with time or follow another attribute.
    driven: BTreeSet<String>,
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
                word @ ("def" | "over" | "class") => {
                    layer.read_prim(&mut text, "", &Ok(Affine::IDENTITY), word == "def", 0)?;
                }
                "reorder" => skip_order(&mut text)?,
                word => return Err(text.error(format!("expected a prim, found {word:?}"))),
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
        world: &World,
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
        let name = text.string()?;
        if name.len() > MAX_NAME {
            return Err(text.error(format!("the name of a prim is longer than {MAX_NAME} bytes")));
        }
        let place = format!("{parent}/{}", String::from_utf8_lossy(name));
        let is_defined = is_defined & (text.peek() != Some(b'(') || self.read_composition(text)?);
        text.expect(b'{')?;
        let is_gaussians = is_defined && ty == TYPE;
        let mut prim = Prim::new();
        let (mut moves, mut below) = (Moves::default(), Vec::new());
        while !text.take(b'}') {
            match text.word()? {
                word @ ("def" | "over" | "class") => {
                    // Where it is stands perhaps behind it.
                    below.push((text.clone(), is_defined && word == "def"));
                    skip_prim(text)?;
                }
                "variantSet" => {
                    self.refers = true;
                    text.string()?;
                    text.expect(b'=')?;
                    text.skip_value()?;
                }
                "reorder" => skip_order(text)?,
                word => read_property(text, word, is_gaussians.then_some(&mut prim), &mut moves)?,
            }
        }
        let world = moves.world(&place, world);
        if is_gaussians {
            self.count += 1;
            (prim.place, prim.world) = (place.clone(), world.clone());
            self.first.get_or_insert(prim);
        }
        for (mut text, is_defined) in below {
            self.read_prim(&mut text, &place, &world, is_defined, depth + 1)?;
        }
        Ok(())
    }

    /// What stands in parentheses behind the name of a prim; gives whether it is active.
    fn read_composition(&mut self, text: &mut Text<'_>) -> Result<bool, SceneError> {
        let mut is_active = true;
        text.expect(b'(')?;
        while !text.take(b')') {
            if matches!(text.peek(), Some(b'"' | b'\'')) {
                text.string()?;
                continue;
            }
            let name = text.word()?;
            self.refers |= ["references", "payload", "inherits", "specializes"].contains(&name);
            if text.take(b'=') {
                is_active &= name != "active" || !(text.next_is("false") || text.next_is("0"));
                text.skip_arc()?;
            }
        }
        Ok(is_active)
    }
}

/// Goes behind an order of prims or properties whose first word was read.
fn skip_order(text: &mut Text<'_>) -> Result<(), SceneError> {
    text.word()?;
    text.expect(b'=')?;
    text.skip_value()
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
        match prim {
            _ if text.next_is("None") => text.skip_value()?,
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
    fn new() -> Self {
        Self {
            place: String::new(),
            world: Ok(Affine::IDENTITY),
            positions: None,
            orientations: None,
            scales: None,
            opacities: None,
            degree: None,
            harmonics: None,
            segment: None,
            instance: None,
            segment_score: None,
            lang_code: None,
            codebook_mean: None,
            codebook_axes: None,
            antialiased: false,
            unread: Vec::new(),
            animated: Vec::new(),
        }
    }

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
            SEGMENT if ty == "int[]" => self.segment = Some(text.array()?),
            INSTANCE if ty == "int[]" => self.instance = Some(text.array()?),
            SEGMENT_SCORE if ty == "float[]" => self.segment_score = Some(text.array()?),
            LANG_CODE if ty == "half[]" => self.lang_code = Some(text.array()?),
            CODEBOOK_MEAN if ty == "float[]" => self.codebook_mean = Some(text.array()?),
            CODEBOOK_AXES if ty == "float[]" => self.codebook_axes = Some(text.array()?),
            ANTIALIASED => self.antialiased = ["1", "true"].contains(&text.word()?),
            _ => {
                if name.ends_with(".timeSamples") {
                    self.animated.push(name.to_owned());
                } else if ty.ends_with("[]") && !["extent", "xformOpOrder"].contains(&name) {
                    self.unread.push([name, ty].map(str::to_owned));
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
        if let Some((name, _)) = name.rsplit_once('.') {
            self.driven.insert(name.to_owned());
            return text.skip_value();
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
            // The error comes where it is used.
            _ => return text.skip_value(),
        };
        self.by_name.insert(name.to_owned(), by);
        Ok(())
    }

    /// From the coordinates of the prim to those of the layer; `parent`: from its parent's.
    fn world(&self, place: &str, parent: &World) -> World {
        let mut world = parent.clone();
        for name in &self.order {
            if name == "!resetXformStack!" {
                world = Ok(Affine::IDENTITY);
                continue;
            }
            let (name, is_inverse) = match name.strip_prefix("!invert!") {
                Some(name) => (name, true),
                None => (name.as_str(), false),
            };
            let by = match self.by_name.get(name) {
                _ if self.driven.contains(name) => {
                    Err(format!("{place} is moved by {name}, which changes with time"))
                }
                Some(by) if is_inverse => Ok(inverse(by)),
                Some(by) => Ok(*by),
                None => Err(format!("{place} is moved by {name}, which is not read")),
            };
            world = world.and_then(|world| by.map(|by| world.after(&by)));
        }
        world
    }
}

/// Not finite if there is none.
fn inverse(by: &Affine) -> Affine {
    let inverse = crate::frame::matrix(&by.linear).inverse();
    let linear = transposed(&inverse.to_cols_array_2d());
    let only = Affine { linear, translation: [0.0; 3] };
    Affine { linear, translation: only.apply(by.translation).map(|v| -v) }
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
