//! Where a network's values come from.

use super::wrapper::wrappers;
use super::{WeightFile, hashed_parameter};
use crate::convert::{Branch, ConvLayout, Renamed, rename};
use candle_core::{Result, Tensor, bail};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Shapes of a checkpoint's weights, by our names, in our layout.
pub type Shapes = BTreeMap<String, Vec<usize>>;

/// Values by our names.
#[derive(Debug, Clone)]
pub struct WeightSource(Kind);

#[derive(Debug, Clone)]
enum Kind {
    Empty,
    Hashed {
        seed: u64,
        prefix: String,
    },
    Files {
        entries: BTreeMap<String, (usize, String)>,
        files: Arc<Vec<WeightFile>>,
        ignored: Vec<(String, String)>,
        wrapper: Option<String>,
        options: SourceOptions,
    },
    Tensors(BTreeMap<String, Tensor>),
}

/// Answer of [`WeightSource::take`].
pub(crate) enum Found {
    Nothing,
    Value(Tensor),
    /// It is there with these dimensions.
    OtherShape(Vec<usize>),
}

/// Choices in reading a checkpoint.
#[derive(Debug, Clone, Copy, Default)]
pub struct SourceOptions {
    /// Which half of a self-supervised checkpoint.
    pub branch: Branch,
    /// How sparse convolutions are stored.
    pub conv_layout: ConvLayout,
}

impl WeightSource {
    /// Nothing: every value is initial.
    pub fn empty() -> Self {
        Self(Kind::Empty)
    }

    /// Values from an integer hash of `prefix` + name: for tests and benchmarks, without meaning.
    pub fn hashed(seed: u64, prefix: &str) -> Self {
        Self(Kind::Hashed { seed, prefix: prefix.to_owned() })
    }

    /// Given tensors by our names.
    pub fn tensors(tensors: BTreeMap<String, Tensor>) -> Self {
        Self(Kind::Tensors(tensors))
    }

    /// Opened files, their names turned into ours by the table in [`crate::convert`].
    ///
    /// # Errors
    /// If two entries end up with the same name.
    pub fn files(files: Vec<WeightFile>, options: SourceOptions) -> Result<Self> {
        let mut entries = BTreeMap::new();
        let mut ignored = Vec::new();
        for (index, file) in files.iter().enumerate() {
            for name in file.entries().keys() {
                match rename(name, options.branch) {
                    Renamed::Weight(ours) => {
                        if let Some((_, other)) =
                            entries.insert(ours.clone(), (index, name.clone()))
                        {
                            bail!("{}: {other} and {name} both name {ours}", file.path().display());
                        }
                    }
                    Renamed::Ignored(origin) => ignored.push((name.clone(), origin.to_owned())),
                }
            }
            ignored.extend(file.skipped().iter().map(|n| (n.clone(), "not a tensor".to_owned())));
        }
        let files = Arc::new(files);
        Ok(Self(Kind::Files { entries, files, ignored, wrapper: None, options }))
    }

    /// The same by the names of a network that stands behind a prefix of another program (`model.net.`): the one behind
    /// which names and shapes are a network. Without change where they are one as they stand, or nowhere.
    ///
    /// # Errors
    /// If there is a network behind two prefixes and neither or both of them name the half that was chosen
    /// ([`SourceOptions::branch`]), or two entries end up with the same name.
    pub fn unwrapped(mut self, is_network: impl Fn(&Shapes) -> bool) -> Result<Self> {
        let shapes = self.shapes();
        let Kind::Files { entries, ignored, wrapper, options, .. } = &mut self.0 else {
            return Ok(self);
        };
        let branch = options.branch;
        let name_behind =
            |name: &str, prefix: &str| match rename(name.strip_prefix(prefix)?, branch) {
                Renamed::Weight(ours) => Some(ours),
                Renamed::Ignored(_) => None,
            };
        let behind = |prefix: &str| -> Shapes {
            let named =
                shapes.iter().filter_map(|(n, s)| Some((name_behind(n, prefix)?, s.clone())));
            named.collect()
        };
        let found = wrappers(&shapes, behind, is_network);
        let Some(prefix) = chosen(&found, branch)? else { return Ok(self) };
        for (name, entry) in std::mem::take(entries) {
            match name.strip_prefix(prefix).map(|rest| rename(rest, branch)) {
                None => _ = entries.insert(name, entry),
                Some(Renamed::Ignored(origin)) => ignored.push((entry.1, origin.to_owned())),
                Some(Renamed::Weight(ours)) => {
                    let text = entry.1.clone();
                    if let Some((_, other)) = entries.insert(ours.clone(), entry) {
                        bail!("{other} and {text} both name {ours}");
                    }
                }
            }
        }
        *wrapper = Some(prefix.to_owned());
        Ok(self)
    }

    /// With one of the language heads that a checkpoint has under names, `projection.NAME.weight` and `.bias`, as the
    /// head `projection`; the others are ignored. Without change where there are none.
    ///
    /// # Errors
    /// If there are several and none is chosen, or the chosen one is not among them; names all with their widths.
    pub fn with_head(mut self, head: Option<&str>) -> Result<Self> {
        let shapes = self.shapes();
        let name_of = |entry: &str| {
            entry.strip_prefix("projection.")?.strip_suffix(".weight").map(str::to_owned)
        };
        let heads: BTreeMap<String, usize> = shapes
            .iter()
            .filter_map(|(entry, shape)| Some((name_of(entry)?, *shape.first()?)))
            .collect();
        let list = || {
            let each: Vec<String> =
                heads.iter().map(|(name, wide)| format!("{name} ({wide})")).collect();
            each.join(", ")
        };
        let chosen = match (head, heads.len()) {
            (None, 0) => return Ok(self),
            (None, 1) => heads.keys().next().cloned().unwrap_or_default(),
            (None, _) => bail!(
                "the weights have several language heads, {}: choose one with --head NAME",
                list()
            ),
            (Some(head), 0) => {
                bail!("--head {head}: the weights have no named heads (projection.NAME.weight)")
            }
            (Some(head), _) if !heads.contains_key(head) => {
                bail!("--head {head}: the weights have the language heads {}", list())
            }
            (Some(head), _) => head.to_owned(),
        };
        if let Kind::Files { entries, ignored, .. } = &mut self.0 {
            for (name, entry) in std::mem::take(entries) {
                let own = name.strip_prefix("projection.").and_then(|rest| rest.rsplit_once('.'));
                match own {
                    Some((head, _)) if heads.contains_key(head) && head != chosen => {
                        ignored.push((entry.1, "another language head".to_owned()));
                    }
                    Some((head, part)) if head == chosen => {
                        if let Some((_, other)) =
                            entries.insert(format!("projection.{part}"), entry)
                        {
                            bail!("{other} and {name} both name the head of language features");
                        }
                    }
                    _ => _ = entries.insert(name, entry),
                }
            }
        }
        Ok(self)
    }

    /// The prefix that [`unwrapped`](Self::unwrapped) found.
    pub(crate) fn wrapper(&self) -> Option<&str> {
        match &self.0 {
            Kind::Files { wrapper, .. } => wrapper.as_deref(),
            _ => None,
        }
    }

    /// Shapes of all weights; none for hashed values, which have every shape.
    pub fn shapes(&self) -> Shapes {
        match &self.0 {
            Kind::Empty | Kind::Hashed { .. } => Shapes::new(),
            Kind::Tensors(tensors) => {
                tensors.iter().map(|(name, t)| (name.clone(), t.dims().to_vec())).collect()
            }
            Kind::Files { entries, files, options, .. } => entries
                .iter()
                .map(|(name, (file, original))| {
                    (name.clone(), stored_shape(&files[*file], original, options.conv_layout))
                })
                .collect(),
        }
    }

    /// Whether this source never has a value.
    pub(crate) fn is_empty(&self) -> bool {
        matches!(self.0, Kind::Empty)
    }

    /// Values of all entries; `None` for hashed values, which are as many as asked for.
    pub(crate) fn num_values(&self) -> Option<usize> {
        let count = |shape: &[usize]| shape.iter().fold(1usize, |n, d| n.saturating_mul(*d));
        let sum = |counts: &mut dyn Iterator<Item = usize>| counts.fold(0, usize::saturating_add);
        match &self.0 {
            Kind::Empty => Some(0),
            Kind::Hashed { .. } => None,
            Kind::Files { files, .. } => {
                let entries = files.iter().flat_map(|file| file.entries().values());
                Some(sum(&mut entries.map(|entry| count(&entry.shape))))
            }
            Kind::Tensors(tensors) => Some(sum(&mut tensors.values().map(Tensor::elem_count))),
        }
    }

    /// Entries that the table knows to be no weights.
    pub(crate) fn ignored(&self) -> &[(String, String)] {
        match &self.0 {
            Kind::Files { ignored, .. } => ignored,
            _ => &[],
        }
    }

    /// The value of a name, read only if its shape is the one asked for.
    pub(crate) fn take(&self, name: &str, shape: &[usize]) -> Result<Found> {
        match &self.0 {
            Kind::Empty => Ok(Found::Nothing),
            Kind::Hashed { seed, prefix } => {
                // Heads stand beside the backbone, not inside it.
                let full = if name.starts_with("seg_head.") {
                    name.to_owned()
                } else {
                    format!("{prefix}{name}")
                };
                hashed_parameter(&full, shape, *seed).map(Found::Value)
            }
            Kind::Tensors(tensors) => Ok(match tensors.get(name) {
                None => Found::Nothing,
                Some(t) if t.dims() == shape => Found::Value(t.clone()),
                Some(t) => Found::OtherShape(t.dims().to_vec()),
            }),
            Kind::Files { entries, files, options, .. } => {
                let layout = options.conv_layout;
                let Some((file, original)) = entries.get(name) else { return Ok(Found::Nothing) };
                let file = &files[*file];
                let stored = stored_shape(file, original, layout);
                let swap = layout == ConvLayout::KernelInOut && stored.len() == 5;
                // Some exports keep single values as [1].
                let single = shape.is_empty() && stored == [1];
                if stored != shape && !single {
                    return Ok(Found::OtherShape(stored));
                }
                let value = file.read(original)?;
                let value = if swap { value.permute((4, 0, 1, 2, 3))? } else { value };
                value.contiguous()?.reshape(shape).map(Found::Value)
            }
        }
    }
}

/// The prefix to take: the only one, or the one that names the half of a pair that was chosen.
fn chosen<'a>(found: &[&'a str], branch: Branch) -> Result<Option<&'a str>> {
    let (wanted, other) = match branch {
        Branch::Teacher => ("teacher", "student"),
        Branch::Student => ("student", "teacher"),
    };
    let of_branch = |p: &&str| p.contains(wanted) && !p.contains(other);
    let named: Vec<&str> = found.iter().copied().filter(of_branch).collect();
    match (found, &named[..]) {
        ([], _) => Ok(None),
        ([only], _) | (_, [only]) => Ok(Some(only)),
        _ => bail!(
            "there is more than one network in the file, behind {}: save the one that is meant by itself",
            found.join(" and ")
        ),
    }
}

/// Shape of an entry, convolutions as ours are laid out.
fn stored_shape(file: &WeightFile, entry: &str, layout: ConvLayout) -> Vec<usize> {
    let stored = file.entries().get(entry).map_or(&[][..], |e| &e.shape);
    match (layout, stored) {
        (ConvLayout::KernelInOut, &[x, y, z, input, output]) => vec![output, x, y, z, input],
        _ => stored.to_vec(),
    }
}
