//! The texts, and the table of all kernels.

use crate::launch::{KernelEntry, KernelModule};
use crate::ops;

/// A text with what it is built on before it.
macro_rules! text {
    ($file:literal $(, $define:literal)?) => {
        concat!(
            $("#define ", $define, "\n",)?
            include_str!("../cuda/grid.h"),
            include_str!("../cuda/numbers.h"),
            "#line 1 \"",
            $file,
            "\"\n",
            include_str!(concat!("../cuda/", $file))
        )
    };
}

macro_rules! modules {
    ($($name:literal, $($kernels:ident)::+, $file:literal $(, $define:literal)?;)*) => {
        static MODULES: &[KernelModule] = &[
            $(KernelModule {
                name: $name,
                source: text!($file $(, $define)?),
                entries: ops::$($kernels)::+::KERNELS,
            }),*
        ];
    };
}

modules! {
    "rows", rows, "rows.cu";
    "segment", segment, "segment.cu";
    "curves", curves, "curves.cu";
    "scan", scan, "scan.cu";
    "radix_sort", radix_sort, "radix_sort.cu";
    "grid_sample", grid_sample, "grid_sample.cu";
    "kernel_map", kernel_map, "kernel_map.cu";
    "columns", columns, "columns.cu";
    "sparse_conv", sparse_conv, "sparse_conv.cu";
    "layer_norm", layer_norm, "layer_norm.cu";
    "batch_norm", batch_norm, "batch_norm.cu";
    "activation", activation, "activation.cu";
    "point_rope", point_rope, "point_rope.cu";
    "classify", classify, "classify.cu";
    "neighbors", neighbors, "neighbors.cu";
    "rasterize", rasterize, "rasterize.cu";
    "patch_attention_16", patch_attention::width_16, "patch_attention.cu", "WIDE 16";
    "patch_attention_24", patch_attention::width_24, "patch_attention.cu", "WIDE 24";
    "patch_attention_32", patch_attention::width_32, "patch_attention.cu", "WIDE 32";
    "patch_attention_48", patch_attention::width_48, "patch_attention.cu", "WIDE 48";
    "patch_attention_64", patch_attention::width_64, "patch_attention.cu", "WIDE 64";
    "patch_attention_bf16_16", patch_attention::bf16_width_16, "patch_attention_bf16.cu", "WIDE 16";
    "patch_attention_bf16_32", patch_attention::bf16_width_32, "patch_attention_bf16.cu", "WIDE 32";
    "patch_attention_bf16_48", patch_attention::bf16_width_48, "patch_attention_bf16.cu", "WIDE 48";
    "patch_attention_bf16_64", patch_attention::bf16_width_64, "patch_attention_bf16.cu", "WIDE 64";
}

/// All texts.
pub fn modules() -> &'static [KernelModule] {
    MODULES
}

/// The text that holds a kernel.
pub fn module_of(kernel: &KernelEntry) -> Option<&'static KernelModule> {
    MODULES.iter().find(|m| m.name == kernel.module)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Names and numbers of threads as a text states them.
    fn declared(text: &'static str) -> BTreeMap<&'static str, u32> {
        let kernel = |rest: &'static str| {
            let (threads, rest) = rest.split_once(')')?;
            let (name, _) = rest.split_once('(')?;
            Some((name.trim(), threads.parse().ok()?))
        };
        let body = &text[text.rfind("#line 1").unwrap()..];
        body.split("\nKERNEL(").skip(1).map(|rest| kernel(rest).unwrap()).collect()
    }

    #[test]
    fn the_table_says_what_the_texts_say() {
        for module in modules() {
            let table: BTreeMap<&str, u32> =
                module.entries.iter().map(|k| (k.name, k.threads)).collect();
            assert_eq!(table.len(), module.entries.len(), "{}: a name twice", module.name);
            assert_eq!(table, declared(module.source), "{}", module.name);
            for kernel in module.entries {
                assert_eq!(kernel.module, module.name);
                assert_eq!(module_of(kernel), Some(module));
                assert!(
                    kernel.threads % 32 == 0 && kernel.items_per_block() > 0,
                    "{}",
                    kernel.name
                );
                assert!(
                    module.source.contains(&format!("\nENTRY({})", kernel.name)),
                    "{}",
                    kernel.name
                );
            }
        }
        let names: std::collections::BTreeSet<&str> = modules().iter().map(|m| m.name).collect();
        assert_eq!(names.len(), modules().len());
    }
}
