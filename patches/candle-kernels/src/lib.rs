//! What candle's CUDA tensors are computed with: kernels of our own, as text.
//!
//! candle-core asks a [`Module`] for its PTX and then for a kernel by name. The real crate has the PTX from
//! nvcc, which its build needs; here it is handed in by [`provide`], once a device was found and NVRTC has compiled the
//! text, so that a program with this crate is built without any toolkit and runs without any device.
//!
//! What is here: [`TEXTS`], for `u8`, `u32`, `i16`, `i32`, `i64`, `f16`, `bf16`, `f32` and `f64`. What is not: convolutions,
//! sorting and quantised products ([`ABSENT`], [`ffi`]), and the type `f8e4m3`. Who asks for a module that is absent
//! gets an error of the driver, and [`asked_in_vain`] its name; who asks for `f8e4m3`, "named symbol not found".

#![deny(missing_docs)]

pub mod ffi;

use std::sync::{Mutex, OnceLock, PoisonError};

/// The modules that candle-core names.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Id {
    /// `x · factor + shift`
    Affine,
    /// Functions of two values, comparisons.
    Binary,
    /// From type to type.
    Cast,
    /// Convolutions, pooling, resampling: absent.
    Conv,
    /// One value everywhere, copies of rectangles.
    Fill,
    /// Rows by number.
    Indexing,
    /// Products of quantised matrices: absent.
    Quantized,
    /// Sums and extremes.
    Reduce,
    /// Sorting: absent.
    Sort,
    /// Choices.
    Ternary,
    /// Functions of one value, strided copies.
    Unary,
}

/// All of them.
pub const ALL_IDS: [Id; 11] = [
    Id::Affine,
    Id::Binary,
    Id::Cast,
    Id::Conv,
    Id::Fill,
    Id::Indexing,
    Id::Quantized,
    Id::Reduce,
    Id::Sort,
    Id::Ternary,
    Id::Unary,
];

/// Those that have no kernels here.
pub const ABSENT: [Id; 3] = [Id::Conv, Id::Quantized, Id::Sort];

impl Id {
    /// Its name, that of its text.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Affine => "affine",
            Self::Binary => "binary",
            Self::Cast => "cast",
            Self::Conv => "conv",
            Self::Fill => "fill",
            Self::Indexing => "indexing",
            Self::Quantized => "quantized",
            Self::Reduce => "reduce",
            Self::Sort => "sort",
            Self::Ternary => "ternary",
            Self::Unary => "unary",
        }
    }
}

/// A module, as candle-core knows it.
pub struct Module {
    id: Id,
}

macro_rules! modules {
    ($($name:ident = $id:ident),* $(,)?) => {
        $(#[doc = concat!("Module `", stringify!($id), "`.")] pub const $name: Module = Module { id: Id::$id };)*
    };
}
modules!(
    AFFINE = Affine,
    BINARY = Binary,
    CAST = Cast,
    CONV = Conv,
    FILL = Fill,
    INDEXING = Indexing,
    QUANTIZED = Quantized,
    REDUCE = Reduce,
    SORT = Sort,
    TERNARY = Ternary,
    UNARY = Unary,
);

macro_rules! texts {
    ($($id:ident = $file:literal),* $(,)?) => {
        [$((Id::$id, concat!(include_str!("cuda/prelude.cuh"), "\n#line 1 \"", $file, "\"\n", include_str!(concat!("cuda/", $file))))),*]
    };
}

/// The texts to compile: CUDA C++ that includes nothing.
pub const TEXTS: [(Id, &str); 8] = texts![
    Affine = "affine.cu",
    Binary = "binary.cu",
    Cast = "cast.cu",
    Fill = "fill.cu",
    Indexing = "indexing.cu",
    Reduce = "reduce.cu",
    Ternary = "ternary.cu",
    Unary = "unary.cu",
];

static PTX: [OnceLock<String>; ALL_IDS.len()] = [const { OnceLock::new() }; ALL_IDS.len()];
static IN_VAIN: Mutex<Vec<Id>> = Mutex::new(Vec::new());

/// Hands in what a text was compiled to. What was handed in first stays: all devices of a process get the same.
pub fn provide(id: Id, ptx: String) {
    let _ = PTX[id as usize].set(ptx);
}

/// Whether a module has what it needs.
pub fn is_provided(id: Id) -> bool {
    PTX[id as usize].get().is_some()
}

/// Modules that candle asked for and that have no kernels, in the order in which it first did.
pub fn asked_in_vain() -> Vec<Id> {
    IN_VAIN.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

impl Module {
    /// Place among the modules.
    pub fn index(&self) -> usize {
        self.id as usize
    }

    /// What the driver loads. Of a module without kernels something that it refuses.
    pub fn ptx(&self) -> &'static str {
        PTX[self.index()].get().map_or_else(
            || {
                let mut asked = IN_VAIN.lock().unwrap_or_else(PoisonError::into_inner);
                if !asked.contains(&self.id) {
                    asked.push(self.id);
                }
                "there are no kernels of this module"
            },
            |ptx| ptx,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_module_has_its_place_and_a_text_or_none() {
        for (at, id) in ALL_IDS.into_iter().enumerate() {
            assert_eq!(id as usize, at);
            let there = TEXTS.iter().any(|(with, _)| *with == id);
            assert_ne!(there, ABSENT.contains(&id), "{id:?}");
        }
    }

    #[test]
    fn what_is_absent_is_refused_and_named() {
        assert!(!CONV.ptx().contains(".version"));
        assert_eq!(asked_in_vain(), [Id::Conv]);
        provide(Id::Affine, ".version 8.0".to_owned());
        provide(Id::Affine, "another".to_owned());
        assert_eq!(AFFINE.ptx(), ".version 8.0");
        assert_eq!(asked_in_vain(), [Id::Conv]);
    }
}
