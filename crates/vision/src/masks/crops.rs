//! The crops and points at which the generator asks.

use super::settings::MaskSettings;

/// Left, top, right and bottom of a crop, the last two beyond it, and its layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Crop {
    pub bounds: [u32; 4],
    pub layer: usize,
}

/// The whole picture, then its crops: layer i has 2ⁱ × 2ⁱ that overlap, column by column.
pub(super) fn crops(width: u32, height: u32, settings: &MaskSettings) -> Vec<Crop> {
    let mut all = vec![Crop { bounds: [0, 0, width, height], layer: 0 }];
    let short = f64::from(width.min(height));
    for layer in 1..=settings.crop_layers {
        let count = 1u32 << layer;
        let overlap = (settings.crop_overlap * short * (2.0 / f64::from(count))) as u32;
        let length = |side: u32| (overlap * (count - 1) + side).div_ceil(count);
        let (wide, high) = (length(width), length(height));
        for i in 0..count {
            for j in 0..count {
                let (left, top) = ((wide - overlap) * i, (high - overlap) * j);
                let bounds = [left, top, (left + wide).min(width), (top + high).min(height)];
                // A picture of a few pixels has crops without any.
                if bounds[0] < bounds[2] && bounds[1] < bounds[3] {
                    all.push(Crop { bounds, layer });
                }
            }
        }
    }
    all
}

/// Points in a crop of this size, pixels: the middles of a grid's cells, row by row.
pub(super) fn points(
    layer: usize,
    width: u32,
    height: u32,
    settings: &MaskSettings,
) -> Vec<[f32; 2]> {
    let fewer = settings.point_downscale.saturating_pow(layer as u32);
    let side = (settings.points_per_side / fewer).max(1);
    let at = |i: usize, length: u32| ((i as f64 + 0.5) / side as f64 * f64::from(length)) as f32;
    (0..side * side).map(|i| [at(i % side, width), at(i / side, height)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crops_by_hand() {
        let settings = MaskSettings::scenesplat();
        // Overlap int(512/1500 · 456) = 155; lengths ⌈(155 + 616)/2⌉ = 386 and ⌈(155 + 456)/2⌉ = 306.
        let boxes: Vec<[u32; 4]> = crops(616, 456, &settings).iter().map(|c| c.bounds).collect();
        let want = [
            [0, 0, 616, 456],
            [0, 0, 386, 306],
            [0, 151, 386, 456],
            [231, 0, 616, 306],
            [231, 151, 616, 456],
        ];
        assert_eq!(boxes, want);
        assert_eq!(crops(616, 456, &MaskSettings::original()).len(), 1);
        let deep = MaskSettings { crop_layers: 2, ..settings };
        assert_eq!(crops(616, 456, &deep).len(), 1 + 4 + 16);
        for crop in crops(1, 1, &deep).iter().chain(&crops(3, 2, &deep)) {
            assert!(crop.bounds[0] < crop.bounds[2] && crop.bounds[1] < crop.bounds[3]);
        }
    }

    #[test]
    fn points_by_hand() {
        let settings =
            MaskSettings { points_per_side: 4, point_downscale: 2, ..Default::default() };
        let all = points(0, 80, 40, &settings);
        assert_eq!(
            (all.len(), all[0], all[1], all[4]),
            (16, [10.0, 5.0], [30.0, 5.0], [10.0, 15.0])
        );
        assert_eq!(
            points(1, 80, 40, &settings),
            [[20.0, 10.0], [60.0, 10.0], [20.0, 30.0], [60.0, 30.0]]
        );
        assert_eq!(points(5, 8, 4, &settings), [[4.0, 2.0]]);
    }

    #[test]
    fn the_overlap_of_a_layer_is_halved_with_its_sides() {
        let settings = MaskSettings { crop_layers: 2, crop_overlap: 0.3, ..Default::default() };
        // Of the shorter side 100 the first layer takes int(0.3 · 100) = 30, the second int(0.3 · 100 / 2) = 15.
        let found = crops(240, 100, &settings);
        let layer = |layer| found.iter().filter(move |c| c.layer == layer).map(|c| c.bounds);
        // ⌈(30 + 240)/2⌉ = 135 by ⌈(30 + 100)/2⌉ = 65, in steps of 105 and 35.
        let first: Vec<_> = layer(1).collect();
        assert_eq!(
            first,
            [[0, 0, 135, 65], [0, 35, 135, 100], [105, 0, 240, 65], [105, 35, 240, 100]]
        );
        // ⌈(45 + 240)/4⌉ = 72 by ⌈(45 + 100)/4⌉ = 37, in steps of 57 and 22; cut at the right and the bottom.
        let second: Vec<_> = layer(2).collect();
        assert_eq!((second.len(), second[0], second[1]), (16, [0, 0, 72, 37], [0, 22, 72, 59]));
        assert_eq!((second[3], second[4]), ([0, 66, 72, 100], [57, 0, 129, 37]));
        assert_eq!(second[15], [171, 66, 240, 100]);
        assert_eq!(layer(0).collect::<Vec<_>>(), [[0, 0, 240, 100]]);
    }
}
