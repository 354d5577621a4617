//! Attacks on whole commands, each with the case or the test of the program that is it.

use std::fmt::Write;

/// An attack that once succeeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attack {
    /// What was tried.
    pub attempt: &'static str,
    /// What it did.
    pub harm: &'static str,
    /// Cases of the catalogue that try it on the library.
    pub cases: &'static [&'static str],
    /// Tests that try it on the program, `file::function` in the tests of its crate.
    pub tests: &'static [&'static str],
}

/// All of them.
pub const ATTACKS: &[Attack] = &[
    Attack {
        attempt: "a device or a pipe named as `--json` or `--receipt`",
        harm: "was replaced by a regular file",
        cases: &["device-in-place-of-an-output", "folder-in-place-of-an-output"],
        tests: &["cli/tests/suite/outputs.rs::devices_and_pipes_are_not_replaced"],
    },
    Attack {
        attempt: "`--receipt`, `--json`, `--sheet` or a result of `--out` that is the input",
        harm: "the scene was gone",
        // Which files a command reads and writes, only the command knows.
        cases: &[],
        tests: &[
            "cli/tests/suite/outputs.rs::inputs_are_not_replaced_under_any_name",
            "cli/tests/suite/outputs.rs::an_output_folder_with_the_input_in_it",
        ],
    },
    Attack {
        attempt: "`weights FILE --receipt FILE`",
        harm: "the checkpoint was gone",
        cases: &[],
        tests: &["cli/tests/suite/outputs.rs::a_checkpoint_in_use_is_not_replaced"],
    },
    Attack {
        attempt: "links under the names of unfinished files",
        harm: "what they lead to was written over",
        cases: &["link-with-a-waiting-name"],
        tests: &["cli/tests/suite/outputs.rs::planted_links_lead_nowhere"],
    },
    Attack {
        attempt: "`config.json` beside weights with sizes of 10⁶ and 2⁶²",
        harm: "sums wrapped; all memory was taken",
        cases: &[
            "config-in-channels-2-to-62",
            "config-in-channels-a-million",
            "config-mlp-ratio-a-million",
        ],
        tests: &["cli/tests/suite/inputs.rs::sizes_in_a_configuration_are_not_believed"],
    },
    Attack {
        attempt: "a PNG of 470 kB with 22,000 × 22,000 pixels",
        harm: "took 1.5 GB",
        cases: &["png-bomb", "png-of-4-billion-pixels"],
        tests: &["crates/scene/tests/suite/pictures.rs::sizes_are_not_believed"],
    },
    Attack {
        attempt: "a feature table of 128 bytes that claims 2²⁴ values a row",
        harm: "all memory was taken",
        cases: &["feature-table-without-rows"],
        tests: &[],
    },
    Attack {
        attempt: "a checkpoint without its average, with a NaN in it, or of another experiment; training on nothing",
        harm: "training went on to other bits, or exported NaN, in silence",
        cases: &[
            "resumed-without-its-average",
            "resumed-with-a-nan-in-its-average",
            "resumed-with-another-patch",
            "resumed-with-another-loss",
            "resumed-with-another-voxels",
            "resumed-with-another-seed",
            "training-on-nothing",
            "weights-cut-short",
        ],
        tests: &[],
    },
    Attack {
        attempt: "results to a full disk",
        harm: "exit code 0",
        cases: &["output-that-is-not-finished"],
        tests: &["cli/tests/suite/outputs.rs::results_that_do_not_get_out_are_an_error"],
    },
    Attack {
        attempt: "a pipe as a scene or as weights",
        harm: "waited for ever",
        cases: &["device-in-place-of-an-input", "folder-in-place-of-a-scene"],
        tests: &["cli/tests/suite/inputs.rs::pipes_and_devices_are_refused_at_once"],
    },
    Attack {
        attempt: "`--threads 2000`, `--text vocabulary:18446744073709551615`",
        harm: "2,000 threads; an allocation that fails",
        cases: &["vocabulary-of-2-to-64"],
        tests: &["cli/tests/suite/inputs.rs::wrong_values_and_flags_without_effect_are_wrong_use"],
    },
    Attack {
        attempt: "a scene for training with NaN positions, NaN rotations and labels that are none",
        harm: "repaired without a word",
        cases: &["training-data-with-bad-values"],
        tests: &[],
    },
    Attack {
        attempt: "patches, orders and sizes that do not belong together, in safe code",
        harm: "reads and writes out of bounds",
        cases: &["order-that-is-no-permutation", "lengths-that-wrap"],
        tests: &[
            "crates/kernels/tests/suite/soundness.rs::attention_with_another_sequence_than_its_patches",
        ],
    },
];

/// The table as the documentation shows it.
pub(super) fn markdown() -> String {
    let mut text = "## Attacks on whole commands\n\n\
        Attempts on the program that succeeded once; each is a case above, a test of the program, or both.\n\n\
        | attempt | what it did | cases | tests |\n|---|---|---|---|\n"
        .to_owned();
    for Attack { attempt, harm, cases, tests } in ATTACKS {
        let list = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
            names.join(", ")
        };
        // Writing to a string does not fail.
        let _ = writeln!(text, "| {attempt} | {harm} | {} | {} |", list(cases), list(tests));
    }
    text
}
