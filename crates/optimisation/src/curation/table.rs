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
}
