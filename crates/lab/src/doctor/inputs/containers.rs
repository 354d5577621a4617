//! Files whose bytes are in another order than usual, cut short, or say what is not so.

use super::files::{Encoding, ROWS, columns, cut_header, little, open, open_legal, ply, refused};
use crate::doctor::case::Case;
use crate::doctor::table::case;
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

/// Name, fate and bytes of a file.
type Container = (&'static str, Fate, fn() -> Vec<u8>);

static CONTAINERS: [Container; 22] = [
    ("big-endian", Same, || ply(&columns(ROWS), Encoding::Big, "\n")),
    ("ascii", Same, || ply(&columns(ROWS), Encoding::Ascii, "\n")),
    ("crlf-header", Same, || ply(&columns(ROWS), Encoding::Little, "\r\n")),
    ("crlf-ascii", Same, || ply(&columns(ROWS), Encoding::Ascii, "\r\n")),
    ("comments", Same, || edited("format", "comment NaN inf end_header?\nobj_info 7\nformat")),
    ("cut-in-a-row", Refused(&["vertex"]), || cut(1)),
    ("cut-in-the-header", Refused(&["scene.ply"]), || little(&columns(ROWS))[..100].to_vec()),
    ("no-rows-behind-the-header", Refused(&["vertex"]), || {
        cut_header(&little(&columns(ROWS))).0.into_bytes()
    }),
    ("one-row-too-many", Refused(&["vertex", "7"]), || edited("vertex 6", "vertex 7")),
    ("count-2-to-62", Refused(&["vertex", "4611686018427387904", "should have"]), || {
        edited("vertex 6", "vertex 4611686018427387904")
    }),
    ("count-negative", Refused(&["-6"]), || edited("vertex 6", "vertex -6")),
    ("bytes-behind-the-rows", Trailing, || [little(&columns(ROWS)), vec![1; 17]].concat()),
    ("list-property", Refused(&["scene.ply", "vertex"]), || {
        edited("float opacity", "list uchar float opacity")
    }),
    ("no-end-of-header", Refused(&["scene.ply"]), || edited("end_header\n", "")),
    ("header-of-2-mib", Refused(&["scene.ply"]), || {
        edited("format", &format!("comment {}\nformat", "x".repeat(2 << 20)))
    }),
    ("17000-properties", Refused(&["propert"]), || {
        let many: String = (0..17_000).map(|i| format!("property float p{i}\n")).collect();
        edited("property float x\n", &format!("property float x\n{many}"))
    }),
    ("word-for-a-number", Refused(&["wall"]), || {
        let bytes = ply(&columns(ROWS), Encoding::Ascii, "\n");
        let (head, _) = cut_header(&bytes);
        let row = vec!["wall"; columns(1).len()].join(" ") + "\n";
        [head.into_bytes(), row.repeat(ROWS).into_bytes()].concat()
    }),
    ("no-gaussian", Refused(&["no Gaussian at all"]), || little(&columns(0))),
    ("no-usable-gaussian", Refused(&["no Gaussian is usable"]), || {
        let mut columns = columns(ROWS);
        columns[0].1.fill(f32::NAN);
        little(&columns)
    }),
    ("empty", Refused(&["is empty"]), Vec::new),
    ("git-lfs-pointer", Refused(&["git-lfs"]), || {
        b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345\n".to_vec()
    }),
    ("no-scene-at-all", Refused(&["scene.ply"]), || vec![7; 4000]),
];

pub(super) fn cases() -> Vec<Case> {
    let container = |(name, fate, bytes): &'static Container| {
        case(format!("ply-{name}"), move |t| check(t, &bytes(), fate))
    };
    CONTAINERS.iter().map(container).collect()
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
