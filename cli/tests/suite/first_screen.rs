//! What a command prints unless it is asked for more: the answer, how sure it is, where the files are.

use crate::support::*;

/// Lines of standard output and error together.
const MOST_LINES: usize = 12;

#[test]
fn the_answer_comes_first_and_is_short() {
    let folder = Folder::new();
    let [room, texts] = ["room.ply", "classes.safetensors"].map(asset_at);
    let names = folder.names();
    let own = format!("{TINY} --text {texts}");
    let cases = [
        (format!("segment {room} {own}"), "room.ply: 16 000 of 16 000 Gaussians labeled"),
        (format!("query {room} chair {own}"), "\"chair\": "),
        (format!("features {room} {TINY}"), "room.ply: 16 000 rows of 64 values in features.npy"),
        (
            format!("objects {room} --label-names {names}"),
            " objects (the instances that the scene carries): ",
        ),
        (format!("inspect {room}"), "16 000 (ply) Gaussians, "),
        (format!("evaluate {room}"), "mIoU"),
        (
            format!("render {room} --orbit 2 --size 64x48"),
            "2 pictures, the first of 64 x 48 pixels",
        ),
    ];
    for (line, answer) in cases {
        let output = run!("{line} --out {} --brief", folder.at("out"));
        done(&output);
        let (out, err) = (stdout(&output), stderr(&output));
        let first = out.lines().next().unwrap_or_default();
        assert!(first.contains(answer), "{line}: {out}");
        assert!(out.lines().count() + err.lines().count() <= MOST_LINES, "{line}: {out}{err}");
        // What makes the labels doubtful is a warning, and the line of certainty points to it.
        let is_doubtful = line.contains("seeded");
        assert_eq!(err.contains("warning: *** SEEDED"), is_doubtful, "{line}: {err}");
        if line.starts_with("segment") {
            has(&out, &["read with +z up, one unit as meters; DOUBTFUL, see the warning"]);
            has(
                &out,
                &["in ", ": labels.npy, scores.npy", "receipt.json", "next: scenesplat view "],
            );
        }
        // All of it is there for who asks.
        let more = stdout(&run!("{line} --out {}", folder.at("out")));
        assert!(more.lines().count() > out.lines().count(), "{line}: {more}");
    }
}

#[test]
fn a_quiet_command_prints_what_was_asked_and_no_more() {
    let folder = Folder::new();
    let (room, names) = (asset_at("room.ply"), folder.names());
    let objects = |more: &str| {
        let output = run!("objects {room} --label-names {names} --out {} {more}", folder.at("out"));
        done(&output);
        (stdout(&output), stderr(&output))
    };
    assert_eq!(objects("--quiet"), (String::new(), String::new()));
    let (found, _) = objects("--quiet --find chair");
    assert!(
        found.lines().count() > 0 && found.lines().all(|line| line.starts_with("\"chair\": ")),
        "{found}"
    );
    refused(&run!("objects {room} --quiet --verbose"), 2, &["--quiet", "--verbose"]);
}
