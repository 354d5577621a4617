//! Statistics over scenes, as the paper prints them.

use super::SceneQuality;
use std::fmt::Write;

/// Means over scenes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct QualityTable {
    /// All scenes.
    pub scenes: usize,
    /// Those that are kept.
    pub kept: usize,
}

/// A Markdown table: a row for each scene, and a row of means over those that are kept.
pub fn markdown(scenes: &[SceneQuality]) -> (QualityTable, String) {
    let kept: Vec<&SceneQuality> = scenes.iter().filter(|s| s.keep).collect();
    let mut text = String::from(
        "| scene | frames | Gaussians | PSNR, dB | SSIM | LPIPS | depth L1 | storage, MB | mIoU | kept |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    let number = |v: Option<f64>, digits: usize| {
        v.filter(|v| v.is_finite()).map_or("-".to_owned(), |v| format!("{v:.digits$}"))
    };
    let mut row = |name: &str, s: [Option<f64>; 8], kept: &str| {
        let [frames, gaussians, psnr, ssim, lpips, depth, bytes, miou] = s;
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {kept} |",
            name.replace('|', "\\|"),
            number(frames, 0),
            number(gaussians, 0),
            number(psnr, 2),
            number(ssim, 3),
            number(lpips, 3),
            number(depth, 4),
            number(bytes.map(|b| b / 1e6), 1),
            number(miou, 3),
        );
    };
    let values = |s: &SceneQuality| {
        [
            s.frames.map(|v| v as f64),
            s.gaussians.map(|v| v as f64),
            s.psnr,
            s.ssim,
            s.lpips,
            s.depth_l1,
            s.bytes.map(|v| v as f64),
            s.miou,
        ]
    };
    for scene in scenes {
        let why: Vec<&str> = scene.reasons.iter().map(|r| r.gate.as_str()).collect();
        let kept = if scene.keep { "yes".to_owned() } else { format!("no: {}", why.join(", ")) };
        row(&scene.name, values(scene), &kept);
    }
    let mean: [Option<f64>; 8] = std::array::from_fn(|k| {
        let all: Vec<f64> =
            kept.iter().filter_map(|s| values(s)[k]).filter(|v| v.is_finite()).collect();
        (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
    });
    row("**mean of those kept**", mean, &format!("{} of {}", kept.len(), scenes.len()));
    (QualityTable { scenes: scenes.len(), kept: kept.len() }, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_means_by_hand() {
        let scene = |name: &str, psnr: f64, keep: bool| SceneQuality {
            name: name.to_owned(),
            psnr: Some(psnr),
            keep,
            ..SceneQuality::default()
        };
        let (table, text) =
            markdown(&[scene("a", 30.0, true), scene("b|c", 10.0, false), scene("d", 32.0, true)]);
        assert_eq!(table, QualityTable { scenes: 3, kept: 2 });
        assert!(text.contains("| b\\|c | - | - | 10.00 |"), "{text}");
        assert!(text.contains("| **mean of those kept** | - | - | 31.00 |"), "{text}");
        assert!(text.ends_with("2 of 3 |\n"));
    }

    #[test]
    fn every_figure_stands_below_its_name_with_its_digits() {
        let whole = SceneQuality {
            name: "a".to_owned(),
            frames: Some(596),
            gaussians: Some(1_420_000),
            psnr: Some(29.644),
            ssim: Some(0.8974),
            lpips: Some(0.2125),
            depth_l1: Some(0.03504),
            bytes: Some(12_340_000),
            miou: Some(0.5),
            keep: true,
            ..SceneQuality::default()
        };
        let reason = |gate: &str| super::super::Reason {
            gate: gate.to_owned(),
            value: 0.0,
            limit: 0.0,
            text: String::new(),
        };
        let bad = SceneQuality {
            name: "b".to_owned(),
            psnr: Some(f64::NAN),
            frames: Some(4),
            reasons: vec![reason("psnr"), reason("holes")],
            ..SceneQuality::default()
        };
        let half = SceneQuality {
            frames: Some(404),
            psnr: Some(f64::INFINITY),
            bytes: None,
            ..whole.clone()
        };
        let (_, text) = markdown(&[whole, bad, half]);
        let lines: Vec<&str> = text.lines().collect();
        let want = [
            "| scene | frames | Gaussians | PSNR, dB | SSIM | LPIPS | depth L1 | storage, MB | mIoU | kept |",
            "|---|---|---|---|---|---|---|---|---|---|",
            "| a | 596 | 1420000 | 29.64 | 0.897 | 0.212 | 0.0350 | 12.3 | 0.500 | yes |",
            "| b | 4 | - | - | - | - | - | - | - | no: psnr, holes |",
            "| a | 404 | 1420000 | - | 0.897 | 0.212 | 0.0350 | - | 0.500 | yes |",
            "| **mean of those kept** | 500 | 1420000 | 29.64 | 0.897 | 0.212 | 0.0350 | 12.3 | 0.500 | 2 of 3 |",
        ];
        assert_eq!(lines, want);
        let (table, none) = markdown(&[]);
        assert_eq!(table, QualityTable::default());
        assert!(
            none.ends_with("| **mean of those kept** | - | - | - | - | - | - | - | - | 0 of 0 |\n")
        );
    }
}
