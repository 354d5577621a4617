//! Files whose bytes are in another order than usual, cut short, or say what is not so.

use super::files::{Encoding, ROWS, columns, cut_header, little, open, open_legal, ply, refused};
use super::input;
use crate::doctor::case::{Case, Policy};
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::Policy as ReadPolicy;
use scenesplat_scene::value_policy::Rule;

/// What has to become of a file.
enum Fate {
    /// The same scene as of the plain file.
    Same,
    /// An error with these words.
    Refused(&'static [&'static str]),
    /// The same scene, and what is behind it is reported.
    Trailing,
}
use Fate::{Refused, Same, Trailing};

/// Name, origin, fate and bytes of a file.
type Container = (&'static str, &'static str, Fate, fn() -> Vec<u8>);

const LEVEL_1: &str =
    "demands 2a, level 1: truncated file, wrong header count, list property, big-endian, CRLF";
const HOSTILE: &str = "docs/bad_values.md: what is never believed";

static CONTAINERS: [Container; 22] = [
    ("big-endian", LEVEL_1, Same, || ply(&columns(ROWS), Encoding::Big, "\n")),
    ("ascii", LEVEL_1, Same, || ply(&columns(ROWS), Encoding::Ascii, "\n")),
    ("crlf-header", LEVEL_1, Same, || ply(&columns(ROWS), Encoding::Little, "\r\n")),
    ("crlf-ascii", LEVEL_1, Same, || ply(&columns(ROWS), Encoding::Ascii, "\r\n")),
    ("comments", "PLY format: comment and obj_info lines anywhere in a header", Same, || {
        edited("format", "comment NaN inf end_header?\nobj_info 7\nformat")
    }),
    ("cut-in-a-row", LEVEL_1, Refused(&["vertex"]), || cut(1)),
    ("cut-in-the-header", LEVEL_1, Refused(&["scene.ply"]), || {
        little(&columns(ROWS))[..100].to_vec()
    }),
    ("no-rows-behind-the-header", LEVEL_1, Refused(&["vertex"]), || {
        cut_header(&little(&columns(ROWS))).0.into_bytes()
    }),
    ("one-row-too-many", LEVEL_1, Refused(&["vertex", "7"]), || edited("vertex 6", "vertex 7")),
    ("count-2-to-62", HOSTILE, Refused(&["vertex", "4611686018427387904", "should have"]), || {
        edited("vertex 6", "vertex 4611686018427387904")
    }),
    ("count-negative", HOSTILE, Refused(&["-6"]), || edited("vertex 6", "vertex -6")),
    ("bytes-behind-the-rows", LEVEL_1, Trailing, || [little(&columns(ROWS)), vec![1; 17]].concat()),
    ("list-property", LEVEL_1, Refused(&["scene.ply", "vertex"]), || {
        edited("float opacity", "list uchar float opacity")
    }),
    ("no-end-of-header", HOSTILE, Refused(&["scene.ply"]), || edited("end_header\n", "")),
    ("header-of-2-mib", HOSTILE, Refused(&["scene.ply"]), || {
        edited("format", &format!("comment {}\nformat", "x".repeat(2 << 20)))
    }),
    ("17000-properties", HOSTILE, Refused(&["propert"]), || {
        let many: String = (0..17_000).map(|i| format!("property float p{i}\n")).collect();
        edited("property float x\n", &format!("property float x\n{many}"))
    }),
    (
        "word-for-a-number",
        "docs/bad_values.md: text that is no number is refused",
        Refused(&["wall"]),
        || {
            let bytes = ply(&columns(ROWS), Encoding::Ascii, "\n");
            let (head, _) = cut_header(&bytes);
            let row = vec!["wall"; columns(1).len()].join(" ") + "\n";
            [head.into_bytes(), row.repeat(ROWS).into_bytes()].concat()
        },
    ),
    ("no-gaussian", "demands 2a, level 1: 0 Gaussians", Refused(&["no Gaussian at all"]), || {
        little(&columns(0))
    }),
    (
        "no-usable-gaussian",
        "docs/bad_values.md: no Gaussian is usable",
        Refused(&["no Gaussian is usable"]),
        || {
            let mut columns = columns(ROWS);
            columns[0].1.fill(f32::NAN);
            little(&columns)
        },
    ),
    ("empty", HOSTILE, Refused(&["is empty"]), Vec::new),
    ("git-lfs-pointer", HOSTILE, Refused(&["git-lfs"]), || {
        b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345\n".to_vec()
    }),
    ("no-scene-at-all", HOSTILE, Refused(&["scene.ply"]), || vec![7; 4000]),
];

pub(super) fn cases() -> Vec<Case> {
    let case = |(name, origin, fate, bytes): &'static Container| {
        input(format!("ply-{name}"), origin, move |t| check(t, &bytes(), fate))
            .because("the same numbers in another order are the same scene, bit for bit")
            .expects(match fate {
                Same => Policy::Exact,
                Refused(_) => Policy::Refused,
                Trailing => Policy::Repaired,
            })
    };
    CONTAINERS.iter().map(case).collect()
}

/// The plain file with its header changed.
fn edited(from: &str, to: &str) -> Vec<u8> {
    let bytes = little(&columns(ROWS));
    let (head, body) = cut_header(&bytes);
    [head.replacen(from, to, 1).as_bytes(), body].concat()
}

/// The plain file without its last bytes.
fn cut(bytes: usize) -> Vec<u8> {
    let mut whole = little(&columns(ROWS));
    whole.truncate(whole.len() - bytes);
    whole
}

fn check(trial: &Trial<'_>, bytes: &[u8], fate: &Fate) -> Result<(), Failure> {
    let path = trial.file("scene.ply", bytes)?;
    let plain = || -> Result<_, Failure> {
        Ok(open_legal(&trial.file("plain.ply", &little(&columns(ROWS)))?)?.scene)
    };
    match *fate {
        Refused(words) => refused(open(&path, ReadPolicy::Repair), words)?,
        Same => ensure!(open_legal(&path)?.scene == plain()?, "another scene was read"),
        Trailing => {
            let loaded = open(&path, ReadPolicy::Repair)?;
            ensure!(loaded.scene == plain()?, "another scene was read");
            ensure!(loaded.report.count(Rule::FileTrailing) > 0, "not reported: {}", loaded.report);
            refused(open(&path, ReadPolicy::Strict), &["scene.ply"])?;
        }
    }
    Ok(())
}
