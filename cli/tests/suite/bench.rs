//! `bench`: every row can be measured, says what it should, and stops when asked to.

use crate::support::*;
use serde_json::Value;

/// Fields of a row that are always there.
const FIELDS: [&str; 16] = [
    "name",
    "precision",
    "threads",
    "quick",
    "size",
    "median_s",
    "min_s",
    "samples",
    "peak_bytes",
    "flop",
    "bytes",
    "max_error",
    "error_against",
    "floor_s",
    "ratio",
    "steady",
];

/// Runs some rows with small inputs and checks what holds for all of them.
fn rows(only: &[&str], more: &str) -> Vec<Value> {
    let folder = Folder::new();
    let file = folder.at("speeds.json");
    let only: String = only.iter().map(|name| format!(" --only {name}")).collect();
    let line = format!("bench --quick --json {file}{only} {more}");
    let table = printed(&process(&words(&line)));
    let report = json(file);
    assert_eq!(folder.count(), 1, "only the report is left");
    assert_eq!(report["quick"], true);
    assert_eq!(report["failed"].as_array().unwrap().len(), 0);
    for speed in ["peak_f32_flop_s", "bandwidth_bytes_s"] {
        assert!(report["machine"][speed].as_f64().unwrap() > 1e8, "{speed}: {report}");
    }
    let rows = report["rows"].as_array().unwrap().clone();
    for row in &rows {
        has(&table, &[row["name"].as_str().unwrap()]);
        for field in FIELDS {
            assert!(row.get(field).is_some(), "{field} of {row}");
        }
        let number = |field: &str| row[field].as_f64().unwrap();
        assert!(number("median_s") >= number("min_s") && number("min_s") > 0.0, "{row}");
        // A long row is timed once.
        assert!(number("samples") >= if number("median_s") < 0.6 { 5.0 } else { 1.0 }, "{row}");
        assert!(number("floor_s") > 0.0, "{row}");
        assert!(number("ratio") >= 0.5, "faster than the machine can be: {row}");
        assert!((number("ratio") - number("median_s") / number("floor_s")).abs() < 1e-6, "{row}");
        assert!(number("flop") + number("bytes") > 0.0, "{row}");
        if cfg!(target_os = "linux") {
            assert!(number("peak_bytes") > 4e6, "{row}");
        }
    }
    rows
}

fn error(row: &Value) -> f64 {
    row["max_error"].as_f64().unwrap()
}

#[test]
fn tables_have_no_wrong_entry() {
    let names = ["serialize_4x_1m", "grid_sample_1m", "kernel_map_k3_100k", "knn25_500k"];
    let rows = rows(&names, "--threads 2 --precision bf16");
    let seen: Vec<&str> = rows.iter().map(|r| r["name"].as_str().unwrap()).collect();
    assert_eq!(seen, names);
    for row in &rows {
        assert_eq!((error(row), &row["threads"]), (0.0, &Value::from(2)), "{row}");
        // They have one precision, whatever is asked for.
        assert_eq!((&row["precision"], row["flop"].as_u64()), (&Value::from("f32"), Some(0)));
    }
    assert_eq!(rows[0]["size"], 20_000);
}

#[test]
fn products_are_as_exact_as_their_precision() {
    let names = ["gemm_c768_100k", "conv3_c32_100k"];
    let precisions = "--precision bf16 --precision f32 --precision split --precision int8";
    let rows = rows(&names, precisions);
    assert_eq!(rows.len(), 8);
    for row in &rows {
        // About eight bits of mantissa, both of two such parts, or all 24.
        let (low, high) = match row["precision"].as_str().unwrap() {
            "bf16" => (1e-4, 1e-2),
            "split" => (1e-9, 1e-4),
            // 32 channels are too few for integers.
            "int8" if row["name"] == "gemm_c768_100k" => (1e-3, 2e-2),
            _ => (1e-9, 1e-6),
        };
        assert!((low..high).contains(&error(row)), "{row}");
        assert!(row["error_against"].as_str().unwrap().starts_with("f64"), "{row}");
    }
    // [2000, 768] · [768, 768]
    assert_eq!(rows[0]["flop"], 2 * 2000 * 768 * 768_u64);
}

#[test]
fn attention_and_networks() {
    let names = ["attention_c64_100k", "train_step_semseg_50k", "forward_semseg_100k"];
    let rows = rows(&names, "");
    let of = |i: usize| [&rows[2 * i], &rows[2 * i + 1]];
    let precisions =
        |[a, b]: [&Value; 2]| assert!(a["precision"] == "f32" && b["precision"] == "bf16");
    (0..3).map(of).for_each(precisions);
    let [f32, bf16] = of(0);
    assert!((1e-9..1e-5).contains(&error(f32)) && (1e-4..2e-2).contains(&error(bf16)), "{rows:?}");
    for i in [1, 2] {
        let [f32, bf16] = of(i);
        // There is nothing better to compare a network in f32 with.
        assert!(f32["max_error"].is_null() && f32["error_against"].is_null(), "{f32}");
        assert!((1e-4..0.3).contains(&error(bf16)), "{bf16}");
        let [low, middle] = ["cosine_p01", "cosine_median"].map(|c| bf16[c].as_f64().unwrap());
        assert!(0.9 < low && low <= middle && middle <= 1.0, "{bf16}");
    }
    let flop = |row: &Value| row["flop"].as_f64().unwrap();
    let times = flop(of(1)[0]) / flop(of(2)[0]);
    assert!((2.5..3.5).contains(&times), "twice as much backward, on as many voxels: {times}");
}

/// What is compared with f32 finds it, also where f32 was not asked for.
#[test]
fn integers_are_for_inference() {
    let rows = rows(&["forward_litept_s_language_100k"], "--precision int8");
    assert_eq!((rows.len(), &rows[0]["precision"]), (1, &Value::from("int8")));
    let [low, middle] = ["cosine_p01", "cosine_median"].map(|c| rows[0][c].as_f64().unwrap());
    assert!(0.9 < low && low <= middle && middle < 0.999_999, "{rows:?}");
    let line = "bench --quick --only train_step_semseg_50k --precision int8";
    refused(&process(&words(line)), 1, &["int8 is for inference"]);
}

#[test]
fn the_machine_itself() {
    let rows = rows(&["peak_f32", "bandwidth"], "");
    let seen: Vec<&str> = rows.iter().map(|r| r["name"].as_str().unwrap()).collect();
    assert_eq!(seen, ["peak_f32", "bandwidth"]);
    assert!(rows.iter().all(|row| row["ratio"].as_f64().unwrap() >= 0.999), "{rows:?}");
}

#[test]
fn wrong_use_is_refused_before_anything_is_measured() {
    let cases = [
        ("--only conv3 --quick", 2, "conv3_c768_100k"),
        ("--only conv3 --quick", 2, "forward_language_100k"),
        ("--threads 0", 2, ""),
        ("--precision f16", 2, ""),
        ("--json no/such/folder/speeds.json", 1, "speeds.json"),
        ("--measure {}", 2, ""),
    ];
    all_refused(cases, |more| run!("bench {more}"));
}

/// Ctrl-C to the command alone: it ends its row's process, says so, and leaves nothing behind.
#[cfg(target_os = "linux")]
#[test]
fn ctrl_c_stops_it() {
    let name = "forward_language_100k";
    interrupted(&format!("bench --only {name} --precision f32"), name);
}
