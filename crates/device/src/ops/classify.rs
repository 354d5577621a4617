//! The class whose text is nearest to a row, by cosine.

use super::kernels;
use crate::launch::{
    Items::PerWarp,
    Launcher,
    Scalar::{F32, U32},
};

kernels! { "classify":
    /// Best class, its cosine and its lead.
    CLASSIFY_ROWS = classify_rows, 256, PerWarp;
}

/// Labels of rows, on the device.
#[derive(Debug)]
pub struct Labels<B> {
    /// Class, −1 for rows without a direction and for withheld labels. `[N]` of `i32`
    pub labels: B,
    /// Cosine with the best class, 0 for rows without a direction. `[N]`
    pub scores: B,
    /// Lead over the second best candidate, +∞ if there is only one. `[N]`
    pub margins: B,
}

/// Sizes and thresholds of [`classify`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Classes {
    /// Rows, N.
    pub rows: u32,
    /// Channels, D.
    pub dim: u32,
    /// Classes, C.
    pub classes: u32,
    /// Withhold when the best cosine is below this.
    pub min_cosine: Option<f32>,
    /// Withhold when the lead is below this.
    pub min_margin: Option<f32>,
}

/// The best matching class of each row; ties to the smallest class. Cosines differ from the CPU's in the last
/// bits, so that classes nearer to each other than 1e-6 may be exchanged.
///
/// # Shapes
/// `features`: `[N, D]`, any norm · `text`: `[C, D]`, unit rows · `candidates`: `[C]` of `u32`, 0 for classes that
/// do not compete
///
/// # Errors
/// Those of the launcher.
pub fn classify<L: Launcher>(
    l: &L,
    features: &L::Buffer,
    text: &L::Buffer,
    candidates: &L::Buffer,
    sizes: Classes,
) -> Result<Labels<L::Buffer>, L::Error> {
    let Classes { rows, dim, classes, min_cosine, min_margin } = sizes;
    l.expect::<f32>("features", features, u64::from(rows) * u64::from(dim));
    l.expect::<f32>("texts", text, u64::from(classes) * u64::from(dim));
    l.expect::<u32>("candidates", candidates, classes.into());
    let mut found = Labels {
        labels: l.alloc_values::<i32>(rows as usize)?,
        scores: l.alloc_values::<f32>(rows as usize)?,
        margins: l.alloc_values::<f32>(rows as usize)?,
    };
    l.run(
        &CLASSIFY_ROWS,
        rows.into(),
        &[features, text, candidates],
        &mut [&mut found.labels, &mut found.scores, &mut found.margins],
        &[
            U32(rows),
            U32(dim),
            U32(classes),
            F32(min_cosine.unwrap_or(f32::NEG_INFINITY)),
            F32(min_margin.unwrap_or(f32::NEG_INFINITY)),
        ],
    )?;
    Ok(found)
}
