//! `meta.json`: which texture holds what, and how its bytes become values.

use super::codes::ByteTable;
use super::json::Field;
use crate::SceneError;
use crate::formats::packed_values::alpha_logits;
use serde_json::Value;
use std::path::{Component, Path};

/// Longest `meta.json` that is looked at. One holds three lists of 256 numbers, about 16 KiB.
pub(super) const MAX_META_BYTES: usize = 4 << 20;
/// The key, beside those of the format, under which the file of labels is named.
pub(super) const OWN_KEY: &str = "scenesplat";

/// A `meta.json` of either version; both come down to one table for each channel.
pub(super) struct SogMeta {
    /// Gaussians.
    pub(super) count: usize,
    /// Bounds of the logarithmic positions, and the textures of their low and high bytes.
    pub(super) mins: [f64; 3],
    pub(super) maxs: [f64; 3],
    pub(super) means: [String; 2],
    pub(super) quats: String,
    /// Logarithm of the scale along each axis.
    pub(super) scale_tables: Box<[ByteTable; 3]>,
    pub(super) scales: String,
    /// DC coefficient of each channel, and opacity logit.
    pub(super) color_tables: Box<[ByteTable; 4]>,
    pub(super) sh0: String,
    pub(super) sh_rest: Option<ShRestMeta>,
    /// Whether the scene was trained for antialiased rendering.
    pub(super) antialiased: bool,
    /// The block of labels that this program wrote beside the textures.
    pub(super) labels: Option<String>,
}

/// The palette of higher coefficients.
pub(super) struct ShRestMeta {
    /// Entries of the palette; version 1 does not say.
    pub(super) entries: Option<usize>,
    /// Degree; version 1 does not say, the width of the centroids does.
    pub(super) degree: Option<u8>,
    pub(super) table: Box<ByteTable>,
    pub(super) centroids: String,
    pub(super) labels: String,
}

/// Parses the text; `None` if it is no JSON or too long to be a `meta.json`.
pub(super) fn parse_json(bytes: &[u8], limit: usize) -> Option<Value> {
    let begins_like_json = bytes.iter().find(|b| !b.is_ascii_whitespace()) == Some(&b'{');
    if !begins_like_json || bytes.len() > limit {
        return None;
    }
    serde_json::from_slice(bytes).ok()
}

/// Whether a JSON text describes the textures of a scene.
///
/// Version 2 says so by `version` and `count`, version 1 by the shape of its means.
pub fn is_sog_meta_json(bytes: &[u8]) -> bool {
    let Some(value) = parse_json(bytes, MAX_META_BYTES) else { return false };
    let means = &value["means"];
    let counted = value["version"].is_number() && value["count"].is_number();
    means["files"].is_array() && (counted || means["shape"].is_array())
}

impl SogMeta {
    /// Reads the text of a `meta.json`; `path` is for messages.
    pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Self, SceneError> {
        let help = "export the scene again";
        if bytes.len() > MAX_META_BYTES {
            let problem = format!("is {} bytes long, more than any meta.json", bytes.len());
            return Err(SceneError::format(path, problem, help));
        }
        let value: Value = serde_json::from_slice(bytes)
            .map_err(|e| SceneError::format(path, format!("is no JSON: {e}"), help))?;
        let root = Field::root(path, &value);
        let version = match root.opt("version") {
            Some(version) => version.count()?,
            None => 1,
        };
        match version {
            1 => parse_v1(&root),
            2 => parse_v2(&root),
            _ => {
                let problem = format!("is of version {version}; only 1 and 2 are known");
                Err(SceneError::format(path, problem, "export the scene as version 2"))
            }
        }
    }
}

impl SogMeta {
    /// The files it names.
    pub(super) fn files(&self) -> Vec<&str> {
        let rest = self.sh_rest.iter().flat_map(|rest| [&rest.centroids, &rest.labels]);
        let files = self.means.iter().chain([&self.quats, &self.scales, &self.sh0]);
        files.chain(rest).chain(&self.labels).map(String::as_str).collect()
    }
}

fn parse_v1(root: &Field<'_>) -> Result<SogMeta, SceneError> {
    let scales = root.get("scales")?;
    let (mins, maxs) = (scales.get("mins")?.numbers::<3>()?, scales.get("maxs")?.numbers::<3>()?);
    let scale_tables = Box::new([0, 1, 2].map(|i| ramp(mins[i], maxs[i])));
    let sh0 = root.get("sh0")?;
    // The fourth channel is the logit itself here.
    let (mins, maxs) = (sh0.get("mins")?.numbers::<4>()?, sh0.get("maxs")?.numbers::<4>()?);
    let color_tables = Box::new([0, 1, 2, 3].map(|i| ramp(mins[i], maxs[i])));
    let count = {
        let shape = root.get("means")?.get("shape")?;
        let rows = shape.elements()?.into_iter().next();
        rows.ok_or_else(|| shape.bad("a shape"))?.count()?
    };
    let sh_rest = match root.opt("shN") {
        None => None,
        Some(rest) => {
            let [centroids, labels] = file_names(&rest)?;
            let bound = |key: &str| -> Result<f64, SceneError> {
                let field = rest.get(key)?;
                // A number, or a list of one.
                field.number().or_else(|e| field.numbers::<1>().map(|[v]| v).map_err(|_| e))
            };
            let table = Box::new(ramp(bound("mins")?, bound("maxs")?));
            Some(ShRestMeta { entries: None, degree: None, table, centroids, labels })
        }
    };
    parse_common(root, count, scale_tables, color_tables, sh_rest)
}

fn parse_v2(root: &Field<'_>) -> Result<SogMeta, SceneError> {
    let scale = codebook(&root.get("scales")?.get("codebook")?)?;
    let color = codebook(&root.get("sh0")?.get("codebook")?)?;
    let sh_rest = match root.opt("shN") {
        None => None,
        Some(rest) => {
            let degree = match rest.opt("bands") {
                None => None,
                Some(bands) => match bands.count()? {
                    degree @ 0..=3 => Some(degree as u8),
                    _ => return Err(bands.bad("0 to 3 bands")),
                },
            };
            let entries = Some(rest.get("count")?.count()?);
            let [centroids, labels] = file_names(&rest)?;
            let table = Box::new(codebook(&rest.get("codebook")?)?);
            let rest = ShRestMeta { entries, degree, table, centroids, labels };
            (degree != Some(0)).then_some(rest)
        }
    };
    let count = root.get("count")?.count()?;
    let color_tables = Box::new([color, color, color, alpha_logits()]);
    parse_common(root, count, Box::new([scale; 3]), color_tables, sh_rest)
}

/// The parts that both versions have.
fn parse_common(
    root: &Field<'_>,
    count: usize,
    scale_tables: Box<[ByteTable; 3]>,
    color_tables: Box<[ByteTable; 4]>,
    sh_rest: Option<ShRestMeta>,
) -> Result<SogMeta, SceneError> {
    let means = root.get("means")?;
    let one_file = |key: &str| -> Result<String, SceneError> {
        let [name] = file_names(&root.get(key)?)?;
        Ok(name)
    };
    let labels = root.opt(OWN_KEY).and_then(|own| own.opt("labels"));
    Ok(SogMeta {
        count,
        mins: means.get("mins")?.numbers()?,
        maxs: means.get("maxs")?.numbers()?,
        means: file_names(&means)?,
        quats: one_file("quats")?,
        scale_tables,
        scales: one_file("scales")?,
        color_tables,
        sh0: one_file("sh0")?,
        sh_rest,
        antialiased: says_antialiased(root),
        labels: labels.map(|name| file_name(&name)).transpose()?,
    })
}

/// Whether the scene is marked: by `antialias`, or by the `model` that newer writers name.
fn says_antialiased(root: &Field<'_>) -> bool {
    let model = root.opt("model");
    root.opt("antialias").is_some_and(|field| field.is_true())
        || model.is_some_and(|model| model.text().is_ok_and(|name| name == "antialiased"))
}

/// The list `files` of a field.
fn file_names<const N: usize>(of: &Field<'_>) -> Result<[String; N], SceneError> {
    let fields = of.get("files")?.array::<N>()?;
    let mut names = [const { String::new() }; N];
    for (name, field) in names.iter_mut().zip(&fields) {
        *name = file_name(field)?;
    }
    Ok(names)
}

fn file_name(field: &Field<'_>) -> Result<String, SceneError> {
    let name = field.text()?;
    if is_inside(name) { Ok(name.to_owned()) } else { Err(field.bad("a file of this folder")) }
}

/// Whether a name in a file leads to a file below the folder it is in.
pub(super) fn is_inside(name: &str) -> bool {
    let strange = |c: char| matches!(c, '\0' | '\\' | ':');
    let path = Path::new(name);
    !name.is_empty()
        && !name.contains(strange)
        && path.components().all(|part| matches!(part, Component::Normal(_)))
}

/// 256 values in equal steps.
fn ramp(min: f64, max: f64) -> ByteTable {
    std::array::from_fn(|byte| {
        let t = byte as f64 / 255.0;
        (min * (1.0 - t) + max * t) as f32
    })
}

/// A list of 256 values. An early encoder wrote `null` for the first; it is one step below the second.
fn codebook(field: &Field<'_>) -> Result<ByteTable, SceneError> {
    let entries = field.array::<256>()?;
    let mut table = [0.0f64; 256];
    for (value, entry) in table.iter_mut().zip(&entries).skip(1) {
        *value = entry.number()?;
    }
    table[0] = if entries[0].is_null() {
        table[1] + (table[1] - table[255]) / 255.0
    } else {
        entries[0].number()?
    };
    Ok(table.map(|v| v as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_leave_the_folder() {
        for name in ["means_l.webp", "0_0/meta.json", "a b.webp"] {
            assert!(is_inside(name), "{name}");
        }
        for name in ["", "..", "../a", "a/../../b", "/etc/passwd", "./a", "c:\\a", "a\\b", "a\0"] {
            assert!(!is_inside(name), "{name}");
        }
    }

    #[test]
    fn a_first_entry_of_null_is_one_step_below_the_second() {
        let mut list: Vec<Value> = (0..256).map(Value::from).collect();
        list[0] = Value::Null;
        let value = Value::from(list);
        let table = codebook(&Field::root(Path::new("x"), &value)).unwrap();
        assert!((table[0] - 1.0 / 255.0).abs() < 1e-8);
        assert_eq!((table[1], table[255]), (1.0, 255.0));
        let value = Value::from(vec![Value::Null; 256]);
        let error = codebook(&Field::root(Path::new("x"), &value)).unwrap_err().to_string();
        assert!(error.contains("[1] is null"), "{error}");
    }
}
