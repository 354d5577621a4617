//! Language features as small codes, and texts that are compared with them.

use super::{PageError, PageInput, blocks};
use crate::inference::SceneFeatures;
use crate::labels::ComparableTexts;
use crate::language_codes::compress_features;
use half::f16;
use scenesplat_rooms::{ClassId, ColorName};
use scenesplat_scene::{LanguageCodebook, LanguageFeatures, TextTable};

/// Rows read at a time.
const BLOCK: usize = 4096;

/// Codes of a page.
pub(super) struct PageCodes {
    /// Numbers of a code.
    pub(super) width: usize,
    /// Rows of codes.
    pub(super) count: usize,
    /// Which row each Gaussian has, four planes of bytes; 2³² − 1 = none.
    pub(super) slots: Vec<u8>,
    /// `[count, width]` i8
    pub(super) values: Vec<u8>,
    /// What a code has to be multiplied with for the cosine with each text: an offset and `width` weights, f32.
    pub(super) texts: Vec<u8>,
    /// Names of the texts: the classes, then others.
    pub(super) names: Vec<String>,
    /// Mean cosine of features with what their codes say, before they are rounded to 8 bits.
    pub(super) mean_cosine: f64,
}

/// Packs the features of the rows that a page shows.
pub(super) fn pack_codes(
    features: &SceneFeatures,
    texts: &TextTable,
    input: &PageInput<'_>,
    rows: &[usize],
    width: usize,
) -> Result<PageCodes, PageError> {
    let (count, dim) = (features.num_slots(), features.width());
    let is_coded = features.codes().is_some();
    let mut values: Vec<f16> = Vec::with_capacity(count * dim);
    for start in (0..count).step_by(BLOCK) {
        for row in features.slot_rows(start..(start + BLOCK).min(count))?.chunks_exact(dim) {
            // Features that were brought down to codes have the length that belongs to them.
            let norm = if is_coded { 1.0 } else { row.iter().map(|v| v * v).sum::<f32>().sqrt() };
            let factor = if norm > 0.0 && norm.is_finite() { 1.0 / norm } else { 0.0 };
            // What is not finite has no feature.
            values.extend(
                row.iter().map(|v| f16::from_f32(if factor > 0.0 { v * factor } else { 0.0 })),
            );
        }
    }
    let done = compress_features(
        &LanguageFeatures { values, dim },
        None,
        width.clamp(1, 32.min(dim)),
        0,
        &mut |_| true,
    )?;
    let code = &done.code;
    let width = code.width();
    let mut largest = vec![0f32; width];
    for row in code.values.chunks_exact(width) {
        largest.iter_mut().zip(row).for_each(|(m, v)| *m = m.max(v.to_f32().abs()));
    }
    let steps: Vec<f32> = largest.iter().map(|m| if *m > 0.0 { m / 127.0 } else { 1.0 }).collect();
    let values = code.values.chunks_exact(width).flat_map(|row| {
        row.iter()
            .zip(&steps)
            .map(|(v, step)| (v.to_f32() / step).round().clamp(-127.0, 127.0) as i8 as u8)
    });
    let values = values.collect();
    let has: Vec<bool> =
        code.values.chunks_exact(width).map(|row| row.iter().any(|v| *v != f16::ZERO)).collect();
    let slot = rows.iter().map(|&row| {
        let slot = features.inverse()[row];
        if has[slot as usize] { slot } else { u32::MAX }
    });
    let slots = blocks::planes(slot, 4);

    let table = asked_for(texts, input)?;
    Ok(PageCodes {
        width,
        count,
        slots,
        values,
        texts: pack_texts(features, &table, &code.codebook, &steps)?,
        names: table.names,
        mean_cosine: done.mean_cosine,
    })
}

/// For each text the offset and weights by which codes give their cosine, f32.
fn pack_texts(
    features: &SceneFeatures,
    table: &TextTable,
    codebook: &LanguageCodebook,
    steps: &[f32],
) -> Result<Vec<u8>, PageError> {
    let comparable = ComparableTexts::new(features, table)?;
    let mut out = Vec::with_capacity(table.len() * (steps.len() + 1) * 4);
    for text in 0..table.len() {
        let row = comparable.row(text).unwrap_or_default();
        let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
        let norm = if features.codes().is_some() { 1.0 } else { norm };
        let dot = |other: &[f32]| row.iter().zip(other).map(|(a, b)| a * b).sum::<f32>() / norm;
        out.extend(dot(&codebook.mean).to_le_bytes());
        for (axis, step) in codebook.axes.chunks_exact(features.width()).zip(steps) {
            out.extend((dot(axis) * step).to_le_bytes());
        }
    }
    Ok(out)
}

/// The classes, and each of them in each color where a vocabulary knows colors.
fn asked_for(texts: &TextTable, input: &PageInput<'_>) -> Result<TextTable, PageError> {
    let mut table = texts.clone();
    if let Some(vocabulary) = input.vocabulary.filter(|v| v.dim() == table.dim) {
        for class in ClassId::ALL {
            for color in ColorName::ALL {
                table.names.push(format!("{} {}", color.word(), class.about().name));
                table.values.extend(vocabulary.object_target(*class, color));
            }
        }
    }
    Ok(table)
}
