//! SigLIP's text tower reads the names of classes, and phrases.

use crate::support::*;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::text::read_text_table;
use scenesplat_test_support::small_siglip;
use std::process::Output;

const NAMES: &str = "chair\ntable\nfloor\nwall\n";

struct Case {
    folder: Folder,
    model: tempfile::TempDir,
    room: String,
}

impl Case {
    fn new() -> Self {
        let folder = Folder::new();
        folder.write("names.txt", NAMES);
        Self { folder, model: small_siglip(64), room: asset_at("room.ply") }
    }

    /// Runs a line in which `@` stands for the folder and `%` for the model.
    fn run(&self, line: &str) -> Output {
        let model = self.model.path().display().to_string();
        run!("{}", line.replace('@', &self.folder.at("")).replace('%', &model))
    }

    fn query(&self, phrase: &str, more: &str, out: &str) -> Output {
        self.run(&format!("query {} '{phrase}' {TINY} {more} --out @{out}", self.room))
    }

    fn found(&self, out: &str) -> [Vec<u8>; 2] {
        ["scores.npy", "selection.npy"].map(|name| bytes(self.folder.path(out).join(name)))
    }
}

#[test]
fn a_phrase_finds_what_its_vector_finds_to_the_bit() {
    let case = Case::new();
    done(&case.run("text chair table floor wall --text-model % --out @names.safetensors"));
    done(&case.run("text 'robot arm' --text-model % --out @arm.safetensors"));
    let arm = read_text_table(&case.folder.path("arm.safetensors"), None).unwrap();
    write_npy(&case.folder.path("arm.npy"), &[64], &arm.values).unwrap();
    let given = "--text @names.safetensors --embedding @arm.npy";
    done(&case.query("robot arm", given, "given"));
    for (out, more) in [
        ("table", "--text @names.safetensors --text-model %"),
        ("list", "--text @names.txt --text-model %"),
    ] {
        done(&case.query("robot arm", more, out));
        assert!(case.found(out) == case.found("given"), "{out}");
        has(&text(case.folder.path(out).join("receipt.json")), &["\"text_model\"", "\"read\""]);
    }
    // Written once, the vectors serve without the model.
    done(&case.run("text --names @names.txt 'robot arm' --text-model % --out @pack.safetensors"));
    done(&case.query("robot arm", "--text @pack.safetensors", "pack"));
    assert!(case.found("pack")[1] == case.found("given")[1]);
    // Other words around a name are another vector.
    done(&case.query("robot arm", "--text @names.txt --text-model % --template 'red {}'", "red"));
    assert!(case.found("red") != case.found("given"));
    // A name of the list, and what denies one, need no vector of the phrase.
    done(&case.query("chair", "--text @names.txt --text-model %", "chair"));
    has(&told(&case.query("not a chair", "--text @names.txt --text-model %", "no")), &["chair"]);
    done(&case.query("robot arm", "--text-model % --min-score -1", "alone"));
}

#[test]
fn classes_are_named_in_a_list() {
    let case = Case::new();
    done(&case.run("text --names @names.txt --text-model % --out @names.safetensors"));
    let segment = |more: &str, out: &str| {
        done(&case.run(&format!("segment {} {TINY} {more} --out @{out}", case.room)));
        bytes(case.folder.path(out).join("labels.npy"))
    };
    let table = segment("--text @names.safetensors", "table");
    assert!(table == segment("--text @names.txt --text-model %", "list"));
    let several = "--text @names.txt --text-model % --template '{}' --template 'red {}'";
    assert!(table != segment(several, "several"));
    has(&text(case.folder.path("several/receipt.json")), &["{} | red {}"]);
}

#[test]
fn what_a_text_model_cannot_read_is_refused() {
    let case = Case::new();
    done(&case.run("text --names @names.txt --text-model % --out @names.safetensors"));
    let segment = |more: &str| case.run(&format!("segment {} {TINY} {more} --out @o", case.room));
    for (more, part) in [
        ("--text-model %", "--text is missing"),
        ("--text @names.safetensors --text-model %", "is none"),
        ("--text @names.txt", "needs --text-model DIR"),
        ("--text @names.txt --template 'a {}'", "--text-model"),
        ("--text @names.txt --text-model % --template chair", "has no {}"),
        ("--text @names.txt --text-model % --text-names @names.txt", "--text-names"),
    ] {
        refused(&segment(more), 2, &[part]);
    }
    for (phrase, more, part) in [
        ("robot arm", "--text-model %", "--min-score"),
        ("not a chair", "--text-model % --min-score 0", "denies"),
        ("lamp left of a wall", "--text-model % --min-score 0", "left of"),
        ("robot arm", "--text-model % --embedding @names.txt", "nothing to read"),
        ("robot arm", "--text vocabulary:64 --text-model %", "is SigLIP"),
        ("chair", "--text vocabulary:64 --text-model %", "is SigLIP"),
    ] {
        refused(&case.query(phrase, more, "o"), 2, &[part]);
    }
    refused(&case.run("text chair --text-model %"), 2, &["--out"]);
    refused(
        &case.run("text chair --text-model % --out @t.safetensors --json @j.json"),
        2,
        &["--json"],
    );
    // Of another width than the network.
    let narrow = Case { model: small_siglip(24), ..case };
    let asked = narrow.query("robot arm", "--text @names.txt --text-model %", "o");
    refused(&asked, 2, &["24 values", "64"]);
    let long = "chair ".repeat(40);
    narrow.folder.write("long.txt", format!("{long}\nwall\n"));
    let line = format!("segment {} {TINY} --text @long.txt --text-model % --out @o", narrow.room);
    refused(&narrow.run(&line), 2, &["longer than the text model reads"]);
}
