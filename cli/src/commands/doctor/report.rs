//! `doctor --report`: what a report of a bug needs, without paths and names of users.

use super::run_cases;
use crate::bench::process::Scratch;
use crate::progress::Progress;
use crate::terminal::print;
use crate::{defaults, version};
use anyhow::Result;
use scenesplat::kernels::simd::Isa;
use scenesplat::machine::Machine;
use scenesplat::memory::machine_memory;
use scenesplat_lab::doctor::{Doctor, Level, catalogue};
use std::time::Instant;

/// Variables that the program reads, and whether their values may be shown: others are paths.
pub(super) const VARIABLES: [(&str, bool); 15] = [
    ("SCENESPLAT_CONFIG", false),
    ("SCENESPLAT_FRONTS", false),
    ("SCENESPLAT_FURNITURE", false),
    ("SCENESPLAT_ISA", true),
    ("SCENESPLAT_KERNEL_CACHE", false),
    ("SCENESPLAT_NVRTC", false),
    ("SCENESPLAT_ONNXRUNTIME", false),
    ("CLICOLOR", true),
    ("CLICOLOR_FORCE", true),
    ("CUDA_VISIBLE_DEVICES", true),
    ("NO_COLOR", true),
    ("RAYON_NUM_THREADS", true),
    ("TMPDIR", false),
    ("XDG_CONFIG_HOME", false),
    ("XDG_DATA_HOME", false),
];

/// Prints the report.
pub(super) fn run(progress: &Progress) -> Result<()> {
    let machine = Machine::detect();
    let isa = Isa::current();
    let sets = Isa::ALL.into_iter().filter(|set| *set <= isa).map(Isa::name).collect::<Vec<_>>();
    let memory = machine_memory().map_or_else(|| "unknown".to_owned(), |bytes| bytes.to_string());
    print(&format!("scenesplat {}", version::long()));
    let build = if cfg!(debug_assertions) { "with debug checks" } else { "release" };
    print(&format!("build: {build}"));
    print(&format!("system: {}", machine.os));
    print(&format!(
        "processor: {}, {} cores, {} threads",
        machine.cpu, machine.cores, machine.threads
    ));
    print(&format!("processor features: {}", processor_features()));
    print(&format!("instruction set: {} (of {})", isa.name(), sets.join(", ")));
    print(&format!("memory: {memory}"));
    print(&format!("variables: {}", variables(|name| std::env::var(name).ok())));
    let flags = defaults::taken().map(|(_, taken)| {
        taken.iter().map(|flag| format!("--{}", flag.flag)).collect::<Vec<_>>().join(" ")
    });
    print(&format!("file of defaults: {}", flags.as_deref().unwrap_or("gives nothing")));
    print(&self_check(progress)?);
    Ok(())
}

/// The variables that are set.
fn variables(value: impl Fn(&str) -> Option<String>) -> String {
    let told = |(name, shown): &(&str, bool)| {
        let value = value(name)?;
        Some(if *shown { format!("{name}={value}") } else { format!("{name} (set)") })
    };
    let told: Vec<String> = VARIABLES.iter().filter_map(told).collect();
    if told.is_empty() { "none".to_owned() } else { told.join(", ") }
}

/// What of the processor the kernels ask for.
fn processor_features() -> String {
    #[cfg(target_arch = "x86_64")]
    let known = [
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
        ("f16c", is_x86_feature_detected!("f16c")),
        ("avx512f", is_x86_feature_detected!("avx512f")),
        ("avx512bw", is_x86_feature_detected!("avx512bw")),
        ("avx512vnni", is_x86_feature_detected!("avx512vnni")),
        ("avx512bf16", is_x86_feature_detected!("avx512bf16")),
    ];
    #[cfg(not(target_arch = "x86_64"))]
    let known: [(&str, bool); 0] = [];
    let found: Vec<&str> =
        known.into_iter().filter(|(_, has)| *has).map(|(name, _)| name).collect();
    if found.is_empty() { "none that is looked for".to_owned() } else { found.join(", ") }
}

/// Runs the quick cases of files and operators, and names those that fail.
fn self_check(progress: &Progress) -> Result<String> {
    let began = Instant::now();
    let mut cases = catalogue();
    cases.retain(|case| case.quick && matches!(case.level, Level::Inputs | Level::Operators));
    let scratch = Scratch::new()?;
    let verdicts = run_cases(&Doctor::new(scratch.path())?, &cases, progress)?;
    progress.finish();
    let failed: Vec<&str> =
        verdicts.iter().filter(|v| !v.passed).map(|v| v.name.as_str()).collect();
    let passed = verdicts.len() - failed.len();
    let seconds = began.elapsed().as_secs_f64();
    let mut told =
        format!("self-check: {passed} of {} cases passed, {seconds:.1} s", verdicts.len());
    if !failed.is_empty() {
        told += &format!("; failed: {}", failed.join(", "));
    }
    Ok(told)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variables_are_named_and_paths_in_them_are_not_shown() {
        let value = |name: &str| match name {
            "SCENESPLAT_ISA" => Some("avx2".to_owned()),
            "SCENESPLAT_FRONTS" => Some("/srv/somebody/fronts".to_owned()),
            _ => None,
        };
        assert_eq!(variables(value), "SCENESPLAT_FRONTS (set), SCENESPLAT_ISA=avx2");
        assert_eq!(variables(|_| None), "none");
    }

    #[test]
    fn the_documentation_lists_every_variable() {
        let page = include_str!("../../../../docs/command_line.md");
        for (name, _) in VARIABLES {
            assert!(page.contains(&format!("| `{name}` |")), "{name}");
        }
    }
}
