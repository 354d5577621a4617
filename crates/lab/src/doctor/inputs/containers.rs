//! Files whose bytes are in another order than usual, cut short, or say what is not so.

use super::files::{Encoding, ROWS, columns, cut_header, little, open, open_legal, ply, refused};
use crate::doctor::case::{Case, Finding, Level, Policy};
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

struct Container {
    name: &'static str,
    origin: &'static str,
    bytes: fn() -> Vec<u8>,
    fate: Fate,
}

const LEVEL_1: &str =
    "demands 2a, level 1: truncated file, wrong header count, list property, big-endian, CRLF";
const HOSTILE: &str = "docs/bad_values.md: what is never believed";

const CONTAINERS: &[Container] = &[
    Container {
        name: "big-endian",
        origin: LEVEL_1,
        bytes: || ply(&columns(ROWS), Encoding::Big, "\n"),
        fate: Same,
    },
    Container {
        name: "ascii",
        origin: LEVEL_1,
        bytes: || ply(&columns(ROWS), Encoding::Ascii, "\n"),
        fate: Same,
    },
    Container {
        name: "crlf-header",
        origin: LEVEL_1,
        bytes: || ply(&columns(ROWS), Encoding::Little, "\r\n"),
        fate: Same,
    },
    Container {
        name: "crlf-ascii",
        origin: LEVEL_1,
        bytes: || ply(&columns(ROWS), Encoding::Ascii, "\r\n"),
        fate: Same,
    },
    Container {
        name: "comments",
        origin: "PLY format: comment and obj_info lines anywhere in a header",
        bytes: || edited("format", "comment NaN inf end_header?\nobj_info 7\nformat"),
        fate: Same,
    },
    Container {
        name: "cut-in-a-row",
        origin: LEVEL_1,
        bytes: || cut(1),
        fate: Refused(&["vertex"]),
    },
    Container {
        name: "cut-in-the-header",
        origin: LEVEL_1,
        bytes: || little(&columns(ROWS))[..100].to_vec(),
        fate: Refused(&["scene.ply"]),
    },
    Container {
        name: "no-rows-behind-the-header",
        origin: LEVEL_1,
        bytes: || cut_header(&little(&columns(ROWS))).0.into_bytes(),
        fate: Refused(&["vertex"]),
    },
    Container {
        name: "one-row-too-many",
        origin: LEVEL_1,
        bytes: || edited("vertex 6", "vertex 7"),
        fate: Refused(&["vertex", "7"]),
    },
    Container {
        name: "count-2-to-62",
        origin: HOSTILE,
        bytes: || edited("vertex 6", "vertex 4611686018427387904"),
        fate: Refused(&["vertex", "4611686018427387904", "should have"]),
    },
    Container {
        name: "count-negative",
        origin: HOSTILE,
        bytes: || edited("vertex 6", "vertex -6"),
        fate: Refused(&["-6"]),
    },
    Container {
        name: "bytes-behind-the-rows",
        origin: LEVEL_1,
        bytes: || [little(&columns(ROWS)), vec![1; 17]].concat(),
        fate: Trailing,
    },
    Container {
        name: "list-property",
        origin: LEVEL_1,
        bytes: || edited("float opacity", "list uchar float opacity"),
        fate: Refused(&["scene.ply", "vertex"]),
    },
    Container {
        name: "no-end-of-header",
        origin: HOSTILE,
        bytes: || edited("end_header\n", ""),
        fate: Refused(&["scene.ply"]),
    },
    Container {
        name: "header-of-2-mib",
        origin: HOSTILE,
        bytes: || edited("format", &format!("comment {}\nformat", "x".repeat(2 << 20))),
        fate: Refused(&["scene.ply"]),
    },
    Container {
        name: "17000-properties",
        origin: HOSTILE,
        bytes: || {
            let many: String = (0..17_000).map(|i| format!("property float p{i}\n")).collect();
            edited("property float x\n", &format!("property float x\n{many}"))
        },
        fate: Refused(&["propert"]),
    },
    Container {
        name: "word-for-a-number",
        origin: "docs/bad_values.md: text that is no number is refused",
        bytes: || {
            let bytes = ply(&columns(ROWS), Encoding::Ascii, "\n");
            let (head, _) = cut_header(&bytes);
            let row = vec!["wall"; columns(1).len()].join(" ") + "\n";
            [head.into_bytes(), row.repeat(ROWS).into_bytes()].concat()
        },
        fate: Refused(&["wall"]),
    },
    Container {
        name: "no-gaussian",
        origin: "demands 2a, level 1: 0 Gaussians",
        bytes: || little(&columns(0)),
        fate: Refused(&["no Gaussian at all"]),
    },
    Container {
        name: "no-usable-gaussian",
        origin: "docs/bad_values.md: no Gaussian is usable",
        bytes: || {
            let mut columns = columns(ROWS);
            columns[0].1.fill(f32::NAN);
            little(&columns)
        },
        fate: Refused(&["no Gaussian is usable"]),
    },
    Container { name: "empty", origin: HOSTILE, bytes: Vec::new, fate: Refused(&["is empty"]) },
    Container {
        name: "git-lfs-pointer",
        origin: HOSTILE,
        bytes: || {
            b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345\n".to_vec()
        },
        fate: Refused(&["git-lfs"]),
    },
    Container {
        name: "no-scene-at-all",
        origin: HOSTILE,
        bytes: || vec![7; 4000],
        fate: Refused(&["scene.ply"]),
    },
];

pub(super) fn cases() -> Vec<Case> {
    CONTAINERS
        .iter()
        .map(|container| Case {
            area: "containers",
            origin: container.origin,
            policy: match container.fate {
                Same => Policy::Exact,
                Refused(_) => Policy::Refused,
                Trailing => Policy::Repaired,
            },
            reason: "the same numbers in another order are the same scene, bit for bit",
            ..Case::new(format!("ply-{}", container.name), Level::Inputs, move |t| {
                check(t, container)
            })
        })
        .collect()
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

fn check(trial: &Trial<'_>, container: &Container) -> Result<Finding, Failure> {
    let path = trial.file("scene.ply", &(container.bytes)())?;
    let plain = || -> Result<_, Failure> {
        Ok(open_legal(&trial.file("plain.ply", &little(&columns(ROWS)))?)?.scene)
    };
    match container.fate {
        Refused(words) => refused(open(&path, ReadPolicy::Repair), words)?,
        Same => ensure!(open_legal(&path)?.scene == plain()?, "another scene was read"),
        Trailing => {
            let loaded = open(&path, ReadPolicy::Repair)?;
            ensure!(loaded.scene == plain()?, "another scene was read");
            ensure!(loaded.report.count(Rule::FileTrailing) > 0, "not reported: {}", loaded.report);
            refused(open(&path, ReadPolicy::Strict), &["scene.ply"])?;
        }
    }
    Ok(Finding::right())
}
