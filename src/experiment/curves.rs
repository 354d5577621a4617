//! Curves of a run as a picture and as a page: one panel for each thing that was measured and changes.

mod picture;
mod shown;

use super::ExperimentError;
use crate::page_kit::{Block, Document, REPORT_STYLE, Rights};
use crate::preview::write_png;
use scenesplat_scene::AtomicFile;
use scenesplat_trainers::Criterion;
use scenesplat_trainers::callbacks::LoggedValue;
use serde::Serialize;
use serde_json::json;
use shown::{Curve, Shown};
pub(super) use shown::{LOSS, values_of};
use std::path::Path;

/// Parts of a long curve, of which the page has two points each.
const PARTS: usize = 1000;

const BODY: &str = include_str!("../../page/src/reports/curves.html");
/// The bundle; made by `npm run build` in the folder `page`.
const SCRIPT: &str = include_str!("../../page/dist/curves.js");

/// Draws the values of a log. The loss and what marks the best checkpoint (`selected`; without, the first evaluation)
/// come first and are large, then the rest of the training, the other evaluations and the rest. Curves that do not
/// change, have one value or are an oracle's have no panel: their last values are written below. Beside each noisy curve
/// runs a smooth one.
///
/// # Errors
/// If the log is empty or the picture cannot be written.
pub fn write_curves(
    log: &[LoggedValue],
    selected: Option<&Criterion>,
    title: &str,
    path: &Path,
) -> Result<(), ExperimentError> {
    let shown = of_log(log, selected, path)?;
    write_png(path, &picture::drawn(&shown, title).to_picture())?;
    Ok(())
}

/// Writes the same as a page that shows the values below the pointer, with a table of what has no panel; it loads
/// nothing. Of long curves it has the least and the largest value of each of a thousand parts, and says so.
///
/// # Errors
/// If the log is empty or the page cannot be written.
pub fn write_curves_page(
    log: &[LoggedValue],
    selected: Option<&Criterion>,
    title: &str,
    path: &Path,
) -> Result<(), ExperimentError> {
    let data = data(&of_log(log, selected, path)?, title);
    let document = Document {
        title,
        class: "",
        style: REPORT_STYLE,
        body: BODY,
        blocks: &[Block::json("data", &data)?],
        script: SCRIPT,
        rights: Rights::None,
    };
    AtomicFile::write(path, document.html().as_bytes())?;
    Ok(())
}

fn of_log(
    log: &[LoggedValue],
    selected: Option<&Criterion>,
    path: &Path,
) -> Result<Shown, ExperimentError> {
    let shown = Shown::of(log, selected);
    if shown.curves.is_empty() && shown.left_out.is_empty() {
        return Err(ExperimentError::EmptyLog { path: path.to_owned() });
    }
    Ok(shown)
}

/// What the page reads.
fn data(shown: &Shown, title: &str) -> serde_json::Value {
    let curves: Vec<DrawnCurve> = shown.curves.iter().map(DrawnCurve::of).collect();
    let left_out = shown.left_out.iter().map(|(reason, curve)| {
        let Curve { name, bad, .. } = curve;
        json!({ "reason": reason.name(), "name": name, "last": curve.last(), "bad": bad })
    });
    let left_out: Vec<_> = left_out.collect();
    json!({ "title": title, "large": shown.large, "curves": curves, "left_out": left_out })
}

/// What the page has of a curve.
#[derive(Serialize)]
struct DrawnCurve {
    name: String,
    points: Vec<[f64; 2]>,
    /// At the same steps; empty for a curve that is not noisy.
    smooth: Vec<[f64; 2]>,
    logged: usize,
    bad: usize,
    last: Option<f64>,
}

impl DrawnCurve {
    fn of(curve: &Curve) -> Self {
        let Curve { name, points, bad } = curve;
        let kept = thinned(points);
        let take = |from: &[[f64; 2]]| kept.iter().map(|&i| from[i]).collect();
        Self {
            name: name.clone(),
            points: take(points),
            smooth: curve.smooth().as_deref().map_or_else(Vec::new, take),
            logged: points.len() + bad,
            bad: *bad,
            last: curve.last(),
        }
    }
}

/// Places of all points, or of the lowest and highest of each of `PARTS` parts, and of the ends.
fn thinned(points: &[[f64; 2]]) -> Vec<usize> {
    if points.len() <= 2 * PARTS {
        return (0..points.len()).collect();
    }
    let mut kept = vec![0, points.len() - 1];
    for part in 0..PARTS {
        let range = part * points.len() / PARTS..(part + 1) * points.len() / PARTS;
        let by_value = |a: &usize, b: &usize| points[*a][1].total_cmp(&points[*b][1]);
        kept.extend(range.clone().min_by(by_value));
        kept.extend(range.max_by(by_value));
    }
    kept.sort_unstable();
    kept.dedup();
    kept
}

#[cfg(test)]
mod tests {
    use super::shown::tests::{logged, of_everything};
    use super::*;

    /// The data of a page, read back from it.
    fn read(page: &str) -> serde_json::Value {
        let begin = page.find("id=\"data\">").unwrap() + 10;
        let end = begin + page[begin..].find("</script>").unwrap();
        serde_json::from_str(&page[begin..end]).unwrap()
    }

    #[test]
    fn picture_and_page_have_the_same_panels() {
        let log = of_everything();
        for selected in [None, Some("seen/f-mIoU".into()), Some("seen/once".into())] {
            let shown = Shown::of(&log, selected.as_ref());
            let names: Vec<&str> = shown.curves.iter().map(|c| c.name.as_str()).collect();
            assert_eq!(picture::tests::headings(&picture::drawn(&shown, "a run")), names);
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("curves.html");
            write_curves_page(&log, selected.as_ref(), "a run", &path).unwrap();
            let data = read(&std::fs::read_to_string(&path).unwrap());
            let of = |list: &str| -> Vec<String> {
                let all = data[list].as_array().unwrap().iter();
                all.map(|c| c["name"].as_str().unwrap().to_owned()).collect()
            };
            assert_eq!(of("curves"), names);
            assert_eq!(data["large"].as_u64(), Some(shown.large as u64));
            let left_out: Vec<&str> = shown.left_out.iter().map(|(_, c)| c.name.as_str()).collect();
            assert_eq!(of("left_out"), left_out);
            assert_eq!(data["left_out"][1]["reason"], "constant");
            assert_eq!((data["left_out"][1]["last"].as_f64(), names.len()), (Some(0.0), 8));
            assert_eq!(data["left_out"][4]["last"], json!(null));
        }
    }

    #[test]
    fn a_run_of_one_evaluation_has_a_picture_and_a_page() {
        let dir = tempfile::tempdir().unwrap();
        let [png, html] = ["curves.png", "curves.html"].map(|name| dir.path().join(name));
        let mut log = logged("unseen/f-mIoU", &[0.31]);
        log.extend(logged("train/loss", &[f64::NAN]));
        write_curves(&log, Some(&"unseen/f-mIoU".into()), "a run", &png).unwrap();
        let picture = scenesplat_scene::picture::read_picture(&png).unwrap().to_rgb8();
        let empty = picture::drawn(&Shown::of(&log[..1], None), "a run").to_picture();
        // Another line for what is not finite.
        assert!(picture.height() > empty.height());
        write_curves_page(&log, None, "a run", &html).unwrap();
        let data = read(&std::fs::read_to_string(&html).unwrap());
        assert_eq!((&data["curves"], &data["large"]), (&json!([]), &json!(0)));
        assert_eq!(data["left_out"].as_array().map(Vec::len), Some(2));
        assert!(write_curves(&[], None, "", &png).is_err());
        assert!(write_curves_page(&[], None, "", &html).is_err());
    }

    #[test]
    fn the_page_says_what_it_leaves_out_of_a_long_curve() {
        let noisy: Vec<f64> = (0..5000).map(|i| f64::from(i % 7) + 0.001 * f64::from(i)).collect();
        let mut log = logged("train/</script><script>attacked", &noisy);
        log.extend(logged("eval/mIoU", &[0.25, f64::INFINITY, 0.5]));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("curves.html");
        write_curves_page(&log, None, "<b>run</b>", &path).unwrap();
        let page = std::fs::read_to_string(&path).unwrap();
        crate::page_kit::is_closed(&page, 2);
        assert!(page.contains("<title>&lt;b&gt;run"));
        let data = read(&page);
        let [short, long] = [0, 1].map(|i| &data["curves"][i]);
        let points = long["points"].as_array().unwrap();
        assert!(points.len() <= 2 * PARTS + 2 && points.len() > PARTS, "{}", points.len());
        assert_eq!((long["logged"].as_u64(), long["bad"].as_u64()), (Some(5000), Some(0)));
        assert_eq!(long["smooth"].as_array().unwrap().len(), points.len());
        // The ends and the extremes are there.
        assert_eq!(
            (points[0][0].as_f64(), points[points.len() - 1][0].as_f64()),
            (Some(0.0), Some(4999.0))
        );
        let most = points.iter().filter_map(|p| p[1].as_f64()).fold(0.0, f64::max);
        assert_eq!(most, noisy.iter().copied().fold(0.0, f64::max));
        assert_eq!(short["points"], json!([[0.0, 0.25], [2.0, 0.5]]));
        assert_eq!((short["bad"].as_u64(), short["last"].as_f64()), (Some(1), Some(0.5)));
        assert_eq!(short["smooth"], json!([]));
    }
}
