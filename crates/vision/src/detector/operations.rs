//! What layers of a graph do. Pictures are rows of pixels, channels last, where a layer has neighbors of pixels.

use super::attributes::Attributes;
use rayon::prelude::*;
use scenesplat_kernels::activation::exp_in_place;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm};
use std::sync::Arc;

/// Values of a block of work for one thread.
const BLOCK: usize = 1 << 15;
/// Side of the tiles in which matrices are transposed.
const TILE: usize = 32;

/// Values of a tensor.
#[derive(Debug, Clone, PartialEq)]
enum Values {
    Floats(Vec<f32>),
    /// Shapes and axes.
    Ints(Vec<i64>),
}

/// An array of any rank, the last axis fastest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tensor {
    pub(super) shape: Vec<usize>,
    values: Values,
}

impl Tensor {
    pub(super) fn floats(shape: Vec<usize>, values: Vec<f32>) -> Self {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len());
        Self { shape, values: Values::Floats(values) }
    }

    pub(super) fn ints(shape: Vec<usize>, values: Vec<i64>) -> Self {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len());
        Self { shape, values: Values::Ints(values) }
    }

    pub(super) fn len(&self) -> usize {
        match &self.values {
            Values::Floats(values) => values.len(),
            Values::Ints(values) => values.len(),
        }
    }

    /// Its values, if they are floats.
    pub(super) fn as_floats(&self) -> Result<&[f32], String> {
        match &self.values {
            Values::Floats(values) => Ok(values),
            Values::Ints(_) => Err("whole numbers are where floats should be".to_owned()),
        }
    }

    fn as_ints(&self) -> Result<&[i64], String> {
        match &self.values {
            Values::Ints(values) => Ok(values),
            Values::Floats(_) => Err("floats are where whole numbers should be".to_owned()),
        }
    }

    fn as_sizes(&self) -> Result<Vec<usize>, String> {
        let size = |v: &i64| usize::try_from(*v).map_err(|_| format!("{v} is no size"));
        self.as_ints()?.iter().map(size).collect()
    }

    /// Height, width and channels of one picture, channels last.
    fn picture(&self) -> Result<[usize; 3], String> {
        match &*self.shape {
            &[1, height, width, channels] => Ok([height, width, channels]),
            other => Err(format!("{other:?} is no shape [1, H, W, C]")),
        }
    }
}

/// Takes the values out, or copies them where somebody else has them too.
fn own(tensor: Arc<Tensor>) -> Tensor {
    Arc::try_unwrap(tensor).unwrap_or_else(|shared| (*shared).clone())
}

/// How far a window moves, and whether the picture is padded so that it fits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Windows {
    strides: [usize; 2],
    same: bool,
}

impl Windows {
    fn of(attributes: &Attributes<'_>) -> Result<Self, String> {
        let list = |name: &str| {
            let sizes = attributes.sizes(name).unwrap_or_else(|| vec![1; 4]);
            let fits =
                sizes.len() == 4 && sizes[0] == 1 && sizes[3] == 1 && sizes[1] > 0 && sizes[2] > 0;
            if fits { Ok([sizes[1], sizes[2]]) } else { Err(format!("{name} is {sizes:?}")) }
        };
        let format = attributes.text("data_format").unwrap_or_else(|| "NHWC".to_owned());
        if format != "NHWC" {
            return Err(format!("data_format is {format:?}; NHWC is read"));
        }
        if list("dilations")? != [1, 1] {
            return Err("dilations are not read".to_owned());
        }
        let same = match attributes.text("padding").as_deref() {
            Some("SAME") => true,
            Some("VALID") => false,
            other => return Err(format!("padding is {other:?}; SAME and VALID are read")),
        };
        Ok(Self { strides: list("strides")?, same })
    }

    /// Windows along an axis, and pixels before the first.
    fn along(&self, axis: usize, length: usize, window: usize) -> Result<(usize, usize), String> {
        let stride = self.strides[axis];
        if self.same {
            let count = length.div_ceil(stride);
            let missing = ((count.max(1) - 1) * stride + window).saturating_sub(length);
            return Ok((count, missing / 2));
        }
        let room = length.checked_sub(window);
        let room =
            room.ok_or_else(|| format!("a window of {window} is wider than {length} pixels"))?;
        Ok((room / stride + 1, 0))
    }
}

/// A convolution with its weights packed.
pub(super) struct Convolution {
    windows: Windows,
    /// Height, width and channels of a window.
    size: [usize; 3],
    /// `[height * width * channels, out]`
    weights: PackedMatrix,
}

/// What a node does.
pub(super) enum Operation {
    Picture,
    Constant(Arc<Tensor>),
    Identity,
    Add,
    LeakyRelu(f32),
    Sigmoid,
    Transpose,
    Reshape,
    Concat,
    /// Into so many parts.
    Split(usize),
    /// With zeros, or with the value of the third input.
    Pad,
    /// Only what shapes are computed with: no index, a constant.
    SparseToDense,
    /// Bilinear, pixels at their middles.
    Resize,
    MaxPool(Windows, [usize; 2]),
    /// Before its weights are known.
    Windows(Windows),
    Convolution(Box<Convolution>),
}

impl Operation {
    /// By its name in TensorFlow.
    pub(super) fn of(name: &str, attributes: &Attributes<'_>) -> Result<Self, String> {
        Ok(match name {
            "Identity" => Self::Identity,
            "Add" | "AddV2" => Self::Add,
            "LeakyRelu" => Self::LeakyRelu(attributes.float("alpha").unwrap_or(0.2)),
            "Sigmoid" => Self::Sigmoid,
            "Transpose" => Self::Transpose,
            "Reshape" => Self::Reshape,
            "ConcatV2" => Self::Concat,
            "SplitV" => {
                let parts = attributes.number("num_split");
                Self::Split(parts.ok_or("num_split is missing")?)
            }
            "Pad" | "PadV2" => Self::Pad,
            "SparseToDense" => Self::SparseToDense,
            "ResizeBilinear" => {
                if attributes.is("align_corners") || !attributes.is("half_pixel_centers") {
                    return Err("only half_pixel_centers without align_corners is read".to_owned());
                }
                Self::Resize
            }
            "MaxPool" => {
                let size = attributes.sizes("ksize").unwrap_or_default();
                let &[1, height, width, 1] = &*size else {
                    return Err(format!("ksize is {size:?}"));
                };
                Self::MaxPool(Windows::of(attributes)?, [height, width])
            }
            "Conv2D" => Self::Windows(Windows::of(attributes)?),
            _ => return Err("this kind of layer is not read".to_owned()),
        })
    }

    /// Whether its results can be named by one position.
    pub(super) fn has_one_result(&self) -> bool {
        !matches!(self, Self::Split(_))
    }

    /// The same with its weights packed, where it is a product.
    pub(super) fn packed(&self, weights: &Tensor) -> Result<Option<Self>, String> {
        let Self::Windows(windows) = self else { return Ok(None) };
        let &[height, width, channels, out] = &*weights.shape else {
            return Err(format!("{:?} is no shape [height, width, in, out]", weights.shape));
        };
        if weights.len() == 0 {
            return Err(format!("weights of shape {:?} have no values", weights.shape));
        }
        let (values, k) = (weights.as_floats()?, height * width * channels);
        let weights = PackedMatrix::from_strided(values, k, out, out, 1);
        let size = [height, width, channels];
        let convolution = Convolution { windows: windows.clone(), size, weights };
        Ok(Some(Self::Convolution(Box::new(convolution))))
    }

    /// The results for some inputs.
    pub(super) fn run(&self, inputs: Vec<Arc<Tensor>>) -> Result<Vec<Arc<Tensor>>, String> {
        if let Self::Split(parts) = self {
            let [tensor, sizes, axis] = exactly(inputs)?;
            return split(&tensor, &sizes.as_sizes()?, &axis, *parts);
        }
        let tensor = match self {
            Self::Picture | Self::Constant(_) | Self::Split(_) => {
                return Err("has no inputs to be run with".to_owned());
            }
            Self::Identity => {
                let [tensor] = exactly(inputs)?;
                return Ok(vec![tensor]);
            }
            Self::Add => {
                let [a, b] = exactly(inputs)?;
                add(a, b)?
            }
            Self::LeakyRelu(alpha) => {
                let [tensor] = exactly(inputs)?;
                in_place(tensor, |values| {
                    values.iter_mut().for_each(|v| *v = if *v < 0.0 { *v * alpha } else { *v });
                })?
            }
            Self::Sigmoid => {
                let [tensor] = exactly(inputs)?;
                in_place(tensor, |values| {
                    values.iter_mut().for_each(|v| *v = -*v);
                    exp_in_place(values);
                    values.iter_mut().for_each(|v| *v = 1.0 / (1.0 + *v));
                })?
            }
            Self::Transpose => {
                let [tensor, axes] = exactly(inputs)?;
                transpose(&tensor, &axes.as_sizes()?)?
            }
            Self::Reshape => {
                let [tensor, shape] = exactly(inputs)?;
                reshape(tensor, shape.as_ints()?)?
            }
            Self::Concat => concat(&inputs)?,
            Self::Pad => pad(&inputs)?,
            Self::SparseToDense => {
                let [indices, shape, values, default] = exactly(inputs)?;
                if indices.len() != 0 || values.len() != 0 {
                    return Err("only a constant without an index is read".to_owned());
                }
                let (shape, default) = (shape.as_sizes()?, default.as_ints()?);
                let &[default] = default else { return Err("has no single default".to_owned()) };
                let count = checked(&shape)?;
                Tensor::ints(shape, vec![default; count])
            }
            Self::Resize => {
                let [tensor, size] = exactly(inputs)?;
                resize(&tensor, &size.as_sizes()?)?
            }
            Self::MaxPool(windows, size) => {
                let [tensor] = exactly(inputs)?;
                max_pool(&tensor, windows, *size)?
            }
            Self::Windows(_) => return Err("its weights are no constant".to_owned()),
            Self::Convolution(convolution) => {
                let [tensor] = exactly(inputs)?;
                convolution.run(&tensor)?
            }
        };
        Ok(vec![Arc::new(tensor)])
    }
}

fn exactly<const N: usize>(inputs: Vec<Arc<Tensor>>) -> Result<[Arc<Tensor>; N], String> {
    let count = inputs.len();
    inputs.try_into().map_err(|_| format!("has {count} inputs; {N} were expected"))
}

/// The number of elements, where memory for them can be had at all.
fn checked(shape: &[usize]) -> Result<usize, String> {
    let count = shape.iter().try_fold(1usize, |n, side| n.checked_mul(*side));
    // More than any layer of a detector of pictures.
    count.filter(|n| *n <= 1 << 28).ok_or_else(|| format!("shape {shape:?} is too large"))
}

fn in_place(tensor: Arc<Tensor>, of: impl Fn(&mut [f32]) + Send + Sync) -> Result<Tensor, String> {
    let mut tensor = own(tensor);
    match &mut tensor.values {
        Values::Floats(values) => values.par_chunks_mut(BLOCK).for_each(of),
        Values::Ints(_) => return Err("whole numbers are where floats should be".to_owned()),
    }
    Ok(tensor)
}

/// Steps of each axis of `shape` in a tensor of shape `of`, axes aligned at the last; 0 where it is repeated.
fn steps(of: &[usize], shape: &[usize]) -> Result<Vec<usize>, String> {
    let missing = shape.len().checked_sub(of.len()).ok_or("has too many axes")?;
    let (mut steps, mut step) = (vec![0; shape.len()], 1);
    for (axis, &side) in of.iter().enumerate().rev() {
        match side {
            1 => {}
            side if side == shape[missing + axis] => steps[missing + axis] = step,
            _ => return Err(format!("shapes {of:?} and {shape:?} do not fit")),
        }
        step *= side;
    }
    Ok(steps)
}

/// The sum; axes of length 1 are repeated.
fn add(a: Arc<Tensor>, b: Arc<Tensor>) -> Result<Tensor, String> {
    let (a, b) = if a.shape.len() >= b.shape.len() && a.len() >= b.len() { (a, b) } else { (b, a) };
    let rank = a.shape.len();
    let side = |axis: usize| {
        let other = (axis + b.shape.len()).checked_sub(rank).map_or(1, |axis| b.shape[axis]);
        if a.shape[axis] == 1 { other } else { a.shape[axis] }
    };
    let shape: Vec<usize> = (0..rank).map(side).collect();
    let (from_a, from_b) = (steps(&a.shape, &shape)?, steps(&b.shape, &shape)?);
    checked(&shape)?;
    if let (Values::Ints(x), Values::Ints(y)) = (&a.values, &b.values) {
        if shape != a.shape || b.shape != shape {
            return Err("whole numbers are added in one shape only".to_owned());
        }
        let sum: Option<Vec<i64>> = x.iter().zip(y).map(|(x, y)| x.checked_add(*y)).collect();
        return Ok(Tensor::ints(shape, sum.ok_or("a size is too large")?));
    }
    let width = shape.last().copied().unwrap_or(1).max(1);
    let offset = |mut row: usize, steps: &[usize]| {
        let mut offset = 0;
        for axis in (0..rank.saturating_sub(1)).rev() {
            offset += row % shape[axis] * steps[axis];
            row /= shape[axis];
        }
        offset
    };
    let last = |steps: &[usize]| steps.last().copied().unwrap_or(0);
    let (step_a, step_b) = (last(&from_a), last(&from_b));
    let mut sum =
        if shape == a.shape { own(a) } else { spread(&a, &shape, (&from_a, step_a), offset)? };
    let Values::Floats(out) = &mut sum.values else {
        return Err("whole numbers and floats are not added".to_owned());
    };
    let added = b.as_floats()?;
    out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
        let from = &added[offset(row, &from_b)..];
        match step_b {
            0 => out.iter_mut().for_each(|v| *v += from[0]),
            _ => out.iter_mut().zip(from).for_each(|(v, more)| *v += more),
        }
    });
    Ok(sum)
}

/// A tensor repeated along axes.
fn spread(
    tensor: &Tensor,
    shape: &[usize],
    (steps, last): (&[usize], usize),
    offset: impl Fn(usize, &[usize]) -> usize,
) -> Result<Tensor, String> {
    let values = tensor.as_floats()?;
    let width = shape.last().copied().unwrap_or(1).max(1);
    let mut out = Vec::with_capacity(checked(shape)?);
    for row in 0..shape.iter().product::<usize>() / width {
        let from = offset(row, steps);
        out.extend((0..width).map(|column| values[from + column * last]));
    }
    Ok(Tensor::floats(shape.to_vec(), out))
}

/// The axes in another order.
fn transpose(tensor: &Tensor, axes: &[usize]) -> Result<Tensor, String> {
    let rank = tensor.shape.len();
    let mut sorted = axes.to_vec();
    sorted.sort_unstable();
    if sorted.iter().copied().ne(0..rank) {
        return Err(format!("{axes:?} is no order of {rank} axes"));
    }
    let values = tensor.as_floats()?;
    let shape: Vec<usize> = axes.iter().map(|axis| tensor.shape[*axis]).collect();
    // Axes that stay neighbors are one; of those that are left, two exchanged ones are a matrix.
    let mut groups: Vec<(usize, usize)> = Vec::new();
    for &axis in axes.iter().filter(|axis| tensor.shape[**axis] != 1) {
        let follows =
            |end: usize| end < axis && tensor.shape[end + 1..axis].iter().all(|s| *s == 1);
        match groups.last_mut() {
            Some((_, end)) if follows(*end) => *end = axis,
            _ => groups.push((axis, axis)),
        }
    }
    let size = |(from, to): (usize, usize)| tensor.shape[from..=to].iter().product::<usize>();
    let out = match *groups {
        [] | [_] => values.to_vec(),
        [a, b] => matrix_transposed(values, size(b), size(a)),
        _ => return Err(format!("{axes:?} exchanges more than two parts of {:?}", tensor.shape)),
    };
    Ok(Tensor::floats(shape, out))
}

/// `[rows, columns] → [columns, rows]`
fn matrix_transposed(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let mut out = vec![0.0; values.len()];
    out.par_chunks_mut((rows * TILE).max(1)).enumerate().for_each(|(band, out)| {
        let first = band * TILE;
        let wide = out.len() / rows;
        for top in (0..rows).step_by(TILE) {
            for column in 0..wide {
                let until = (top + TILE).min(rows);
                for row in top..until {
                    out[column * rows + row] = values[row * columns + first + column];
                }
            }
        }
    });
    out
}

/// The same values in another shape; −1 is what is left.
fn reshape(tensor: Arc<Tensor>, shape: &[i64]) -> Result<Tensor, String> {
    let count = tensor.len();
    let given = shape.iter().filter(|side| **side != -1).map(|side| usize::try_from(*side));
    let given: Vec<usize> =
        given.collect::<Result<_, _>>().map_err(|_| format!("{shape:?} is no shape"))?;
    let known = checked(&given)?.max(1);
    let side = |side: &i64| if *side == -1 { count / known } else { *side as usize };
    let new: Vec<usize> = shape.iter().map(side).collect();
    if shape.len() > given.len() + 1 || new.iter().product::<usize>() != count {
        return Err(format!("{count} values do not make shape {shape:?}"));
    }
    let mut tensor = own(tensor);
    tensor.shape = new;
    Ok(tensor)
}

/// An axis that may be counted from the end.
fn axis_of(axis: &Tensor, rank: usize) -> Result<usize, String> {
    let &[axis] = axis.as_ints()? else { return Err("has no single axis".to_owned()) };
    let found = if axis < 0 { axis + rank as i64 } else { axis };
    let found = usize::try_from(found).ok().filter(|axis| *axis < rank);
    found.ok_or_else(|| format!("axis {axis} of {rank}"))
}

fn concat(inputs: &[Arc<Tensor>]) -> Result<Tensor, String> {
    let (axis, parts) = inputs.split_last().ok_or("has no inputs")?;
    let first = parts.first().ok_or("has no inputs")?;
    let axis = axis_of(axis, first.shape.len())?;
    let mut shape = first.shape.clone();
    shape[axis] = parts.iter().map(|part| part.shape.get(axis).copied().unwrap_or(0)).sum();
    for part in parts {
        let mut same = part.shape.clone();
        if same.len() > axis {
            same[axis] = shape[axis];
        }
        if same != shape {
            return Err(format!("shapes {:?} and {:?} do not fit", first.shape, part.shape));
        }
    }
    if first.as_ints().is_ok() {
        let ints: Vec<&[i64]> =
            parts.iter().map(|part| part.as_ints()).collect::<Result<_, _>>()?;
        if shape.len() != 1 {
            return Err("whole numbers are joined in one row only".to_owned());
        }
        return Ok(Tensor::ints(shape, ints.concat()));
    }
    let outer: usize = shape[..axis].iter().product();
    let mut out = Vec::with_capacity(checked(&shape)?);
    for block in 0..outer {
        for part in parts {
            let values = part.as_floats()?;
            let size = values.len() / outer;
            out.extend_from_slice(&values[block * size..][..size]);
        }
    }
    Ok(Tensor::floats(shape, out))
}

fn split(
    tensor: &Tensor,
    sizes: &[usize],
    axis: &Tensor,
    parts: usize,
) -> Result<Vec<Arc<Tensor>>, String> {
    let axis = axis_of(axis, tensor.shape.len())?;
    let side = tensor.shape[axis];
    if sizes.len() != parts || sizes.iter().try_fold(0usize, |n, s| n.checked_add(*s)) != Some(side)
    {
        return Err(format!("{side} are not split into {sizes:?}"));
    }
    let values = tensor.as_floats()?;
    let inner: usize = tensor.shape[axis + 1..].iter().product();
    let row = (side * inner).max(1);
    let mut from = 0;
    let part = |size: &usize| {
        let mut shape = tensor.shape.clone();
        shape[axis] = *size;
        let columns = from * inner..(from + size) * inner;
        from += size;
        let own = values.chunks_exact(row).flat_map(|row| &row[columns.clone()]).copied().collect();
        Arc::new(Tensor::floats(shape, own))
    };
    Ok(sizes.iter().map(part).collect())
}

/// Values around a tensor.
fn pad(inputs: &[Arc<Tensor>]) -> Result<Tensor, String> {
    let (tensor, widths, value) = match inputs {
        [tensor, widths] => (tensor, widths, 0.0),
        [tensor, widths, value] => match value.as_floats()? {
            &[value] => (tensor, widths, value),
            _ => return Err("has no single value to pad with".to_owned()),
        },
        _ => return Err(format!("has {} inputs; 2 or 3 were expected", inputs.len())),
    };
    let widths = widths.as_sizes()?;
    let rank = tensor.shape.len();
    if widths.len() != 2 * rank {
        return Err(format!("{} widths for {rank} axes", widths.len()));
    }
    let mut out = (**tensor).clone();
    // Axis by axis: all but two have nothing around them.
    for (axis, around) in
        widths.chunks_exact(2).enumerate().filter(|(_, around)| **around != [0, 0])
    {
        let values = out.as_floats()?;
        let inner: usize = out.shape[axis + 1..].iter().product();
        let side = out.shape[axis];
        let mut shape = out.shape.clone();
        shape[axis] =
            around.iter().try_fold(side, |n, more| n.checked_add(*more)).ok_or("is too wide")?;
        let mut padded = Vec::with_capacity(checked(&shape)?);
        for block in values.chunks_exact((side * inner).max(1)) {
            padded.resize(padded.len() + around[0] * inner, value);
            padded.extend_from_slice(block);
            padded.resize(padded.len() + around[1] * inner, value);
        }
        out = Tensor::floats(shape, padded);
    }
    Ok(out)
}

/// Bilinear, pixels at their middles, not antialiased.
fn resize(tensor: &Tensor, size: &[usize]) -> Result<Tensor, String> {
    let [height, width, channels] = tensor.picture()?;
    let &[to_height, to_width] = size else {
        return Err(format!("{size:?} is no height and width"));
    };
    let shape = vec![1, to_height, to_width, channels];
    let count = checked(&shape)?;
    if count == 0 || tensor.len() == 0 {
        return Err(format!("{:?} cannot become {shape:?}", tensor.shape));
    }
    let values = tensor.as_floats()?;
    // Two pixels and the part of the second.
    let between = |at: usize, from: usize, to: usize| {
        let place = ((at as f32 + 0.5) * (from as f32 / to as f32) - 0.5).max(0.0);
        let first = (place.floor() as usize).min(from - 1);
        (first, (first + 1).min(from - 1), place - place.floor())
    };
    let mut out = vec![0.0; count];
    out.par_chunks_mut(to_width * channels).enumerate().for_each(|(y, out)| {
        let (top, bottom, down) = between(y, height, to_height);
        for (x, out) in out.chunks_exact_mut(channels).enumerate() {
            let (left, right, across) = between(x, width, to_width);
            let pixel = |y: usize, x: usize| &values[(y * width + x) * channels..][..channels];
            let (a, b) = (pixel(top, left), pixel(top, right));
            let (c, d) = (pixel(bottom, left), pixel(bottom, right));
            for (k, out) in out.iter_mut().enumerate() {
                let above = a[k] + (b[k] - a[k]) * across;
                let below = c[k] + (d[k] - c[k]) * across;
                *out = above + (below - above) * down;
            }
        }
    });
    Ok(Tensor::floats(shape, out))
}

/// The largest value of each window; what is padded has no say.
fn max_pool(tensor: &Tensor, windows: &Windows, size: [usize; 2]) -> Result<Tensor, String> {
    let [height, width, channels] = tensor.picture()?;
    let (rows, above) = windows.along(0, height, size[0])?;
    let (columns, left) = windows.along(1, width, size[1])?;
    let shape = vec![1, rows, columns, channels];
    let mut out = vec![f32::NEG_INFINITY; checked(&shape)?];
    let values = tensor.as_floats()?;
    let strides = windows.strides;
    out.par_chunks_mut((columns * channels).max(1)).enumerate().for_each(|(row, out)| {
        for (column, out) in out.chunks_exact_mut(channels.max(1)).enumerate() {
            for y in inside(row * strides[0], size[0], above, height) {
                for x in inside(column * strides[1], size[1], left, width) {
                    let pixel = &values[(y * width + x) * channels..][..channels];
                    out.iter_mut().zip(pixel).for_each(|(most, v)| *most = most.max(*v));
                }
            }
        }
    });
    Ok(Tensor::floats(shape, out))
}

/// Places of a window that are in the picture.
fn inside(first: usize, window: usize, before: usize, length: usize) -> std::ops::Range<usize> {
    first.saturating_sub(before)..(first + window).saturating_sub(before).min(length)
}

impl Convolution {
    fn run(&self, tensor: &Tensor) -> Result<Tensor, String> {
        let [height, width, channels] = tensor.picture()?;
        let [tall, wide, expected] = self.size;
        if channels != expected {
            return Err(format!("{channels} channels; the weights are for {expected}"));
        }
        let (rows, above) = self.windows.along(0, height, tall)?;
        let (columns, left) = self.windows.along(1, width, wide)?;
        let shape = vec![1, rows, columns, self.weights.n()];
        let mut out = vec![0.0; checked(&shape)?];
        let values = tensor.as_floats()?;
        let strides = self.windows.strides;
        if (tall, wide, strides) == (1, 1, [1, 1]) {
            gemm(values, &self.weights, Epilogue::default(), &mut out);
            return Ok(Tensor::floats(shape, out));
        }
        let k = tall * wide * channels;
        let mut windows = vec![0.0; checked(&[rows, columns, k])?];
        windows.par_chunks_mut((columns * k).max(1)).enumerate().for_each(|(row, out)| {
            for (column, out) in out.chunks_exact_mut(k).enumerate() {
                for (dy, out) in out.chunks_exact_mut(wide * channels).enumerate() {
                    let y = (row * strides[0] + dy).checked_sub(above).filter(|y| *y < height);
                    let Some(y) = y else { continue };
                    let x = inside(column * strides[1], wide, left, width);
                    // Columns of the window before the first of the picture.
                    let before = (x.start + left) - column * strides[1];
                    let from =
                        &values[(y * width + x.start) * channels..(y * width + x.end) * channels];
                    out[before * channels..][..from.len()].copy_from_slice(from);
                }
            }
        });
        gemm(&windows, &self.weights, Epilogue::default(), &mut out);
        Ok(Tensor::floats(shape, out))
    }
}
