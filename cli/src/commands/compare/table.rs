//! The numbers as a table.

use super::measure::{Measured, Summary};

/// Column titles and whether any picture has the number.
const TITLES: [&str; 6] =
    ["PSNR dB", "SSIM valid", "SSIM reflect", "SSIM zero", "LPIPS", "depth L1"];

/// One line per picture and one of the means; columns that are empty throughout are left out.
pub(super) fn table(measured: &[Measured], summary: &Summary) -> String {
    let rows: Vec<[String; 6]> = measured.iter().map(cells).collect();
    let means = mean_cells(summary);
    let used: Vec<usize> = (0..6).filter(|&c| rows.iter().any(|row| !row[c].is_empty())).collect();
    let widest = measured.iter().map(|m| m.name.chars().count()).max().unwrap_or(0).max(5);
    let line = |name: &str, cells: &[String; 6]| {
        let pad = widest - name.chars().count().min(widest);
        let mut line = format!("{name}{:pad$}", "");
        for &c in &used {
            line.push_str(&format!("  {:>12}", cells[c]));
        }
        line.trim_end().to_owned()
    };
    let titles = TITLES.map(str::to_owned);
    let mut lines = vec![line("image", &titles)];
    lines.extend(measured.iter().zip(&rows).map(|(m, row)| line(&m.name, row)));
    if measured.len() > 1 {
        lines.push(line("mean", &means));
    }
    if summary.identical > 0 && measured.len() > 1 {
        let n = summary.identical;
        lines.push(format!("{n} identical, not in the mean of the PSNRs"));
    }
    lines.join("\n")
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(String::new, |v| format!("{v:.digits$}"))
}

fn cells(m: &Measured) -> [String; 6] {
    let psnr = if m.identical { "identical".to_owned() } else { number(m.psnr, 3) };
    let depth = match m.depth_pixels {
        Some(0) => "no pixels".to_owned(),
        _ => number(m.depth_l1, 5),
    };
    [
        psnr,
        number(m.ssim_valid, 5),
        number(m.ssim_reflect, 5),
        number(m.ssim_zero, 5),
        number(m.lpips, 5),
        depth,
    ]
}

fn mean_cells(s: &Summary) -> [String; 6] {
    [
        number(s.psnr, 3),
        number(s.ssim_valid, 5),
        number(s.ssim_reflect, 5),
        number(s.ssim_zero, 5),
        number(s.lpips, 5),
        number(s.depth_l1, 5),
    ]
}
