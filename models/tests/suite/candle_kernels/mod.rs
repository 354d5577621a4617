//! The kernels behind candle's CUDA tensors, compiled for the CPU and started as candle starts them, against candle's
//! CPU tensors. What they are compiled to for a device is not executed here.
// Each call starts a kernel with arrays of the lengths that it is told, which outlive it.
#![allow(clippy::undocumented_unsafe_blocks, clippy::semicolon_if_nothing_returned)]

use candle_core::{D, DType, Device, Result, Tensor, WithDType};
use half::{bf16, f16};
use libloading::Library;
use std::path::PathBuf;
use std::process::Command;
use std::ptr::null;
use std::sync::{Barrier, LazyLock, Mutex, MutexGuard, PoisonError, RwLock};

type Of1 = fn(&Tensor) -> Result<Tensor>;
type Of2 = fn(&Tensor, &Tensor) -> Result<Tensor>;

/// All texts in one library; `None` without a C++ compiler.
static LIBRARY: LazyLock<Option<Library>> = LazyLock::new(|| {
    let here = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let texts = here.join("../patches/candle-kernels/src/cuda");
    let folder = tempfile::tempdir().unwrap();
    let mut all = std::fs::read_to_string(here.join("tests/suite/candle_kernels/grid.h")).unwrap();
    for name in [
        "prelude.cuh",
        "affine.cu",
        "binary.cu",
        "cast.cu",
        "fill.cu",
        "indexing.cu",
        "reduce.cu",
        "ternary.cu",
        "unary.cu",
    ] {
        all += &std::fs::read_to_string(texts.join(name)).unwrap();
    }
    let (source, library) = (folder.path().join("all.cpp"), folder.path().join("all.so"));
    std::fs::write(&source, all).unwrap();
    let flags = ["-std=c++17", "-O1", "-fPIC", "-shared", "-ffp-contract=off", "-w", "-o"];
    let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".to_owned());
    let ran = Command::new(compiler).args(flags).arg(&library).arg(&source).output();
    let Ok(ran) = ran else {
        println!("NOT RUN: no C++ compiler");
        return None;
    };
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    // SAFETY: the library has no initialisers.
    Some(unsafe { Library::new(&library) }.unwrap())
});

/// One grid at a time: the threads of a block share memory of the library.
static GRID: Mutex<()> = Mutex::new(());
static BARRIER: RwLock<Option<Barrier>> = RwLock::new(None);

extern "C" fn wait() {
    let barrier = BARRIER.read().unwrap();
    barrier.as_ref().unwrap().wait();
}

fn alone() -> MutexGuard<'static, ()> {
    GRID.lock().unwrap_or_else(PoisonError::into_inner)
}

fn address(name: &str) -> *const () {
    let library = LIBRARY.as_ref().unwrap();
    // SAFETY: read as a bare address.
    *unsafe { library.get(name.as_bytes()) }.unwrap_or_else(|_| panic!("no kernel {name}"))
}

/// The function of this name; `F` is its type.
fn symbol<F: Copy>(name: &str) -> F {
    let address = address(name);
    assert_eq!(size_of::<F>(), size_of_val(&address));
    // SAFETY: a function pointer from an address; types are checked by the results.
    unsafe { std::mem::transmute_copy(&address) }
}

/// Calls `one` for each thread of a grid; threads of a block that `meet` run at once. Not generic: hundreds of kernels would
/// each compile it again.
fn grid(blocks: u32, threads: u32, meet: bool, one: &(dyn Fn() + Sync)) {
    let place = symbol::<unsafe extern "C" fn(u32, u32, u32, u32)>("place");
    // SAFETY: as declared in grid.h.
    let place = |block, thread| unsafe { place(block, thread, blocks, threads) };
    // SAFETY: as declared in grid.h.
    unsafe { symbol::<unsafe extern "C" fn(extern "C" fn())>("set_barrier")(wait) };
    for block in 0..blocks {
        if !meet {
            for thread in 0..threads {
                place(block, thread);
                one();
            }
            continue;
        }
        *BARRIER.write().unwrap() = Some(Barrier::new(threads as usize));
        std::thread::scope(|scope| {
            for thread in 0..threads {
                let place = &place;
                std::thread::Builder::new()
                    .stack_size(64 << 10)
                    .spawn_scoped(scope, move || {
                        place(block, thread);
                        one();
                    })
                    .unwrap();
            }
        });
    }
}

/// Starts a kernel that goes over `count` elements, on the grid that candle sizes for them, and compares what it makes of `out`.
fn check<F: Copy + Sync, O: WithDType>(
    name: &str,
    mut out: Vec<O>,
    count: usize,
    expected: &[O],
    call: impl Fn(F, *mut O) + Sync,
) {
    let kernel = symbol::<F>(name.split(',').next().unwrap());
    let to = out.as_mut_ptr() as usize;
    grid((count as u32).div_ceil(1024), 1024, false, &|| call(kernel, to as *mut O));
    close(name, &out, expected);
}

/// As [`check`] of a new array.
fn made<F: Copy + Sync, O: WithDType>(
    name: &str,
    expected: candle_core::Result<Tensor>,
    call: impl Fn(F, *mut O) + Sync,
) {
    let expected = flat::<O>(&expected.unwrap());
    check(name, vec![O::zero(); expected.len()], expected.len(), &expected, call);
}

/// Values that are small whole numbers and quarters, of both signs where the type has them; none is 0.
fn values<T: WithDType>(count: usize, salt: usize) -> Vec<T> {
    let signed = !matches!(T::DTYPE, DType::U8 | DType::U32);
    let value = |i: usize| {
        let size = 1.0 + ((i * 7 + salt * 3) % 11) as f64;
        let size = if T::DTYPE.is_float() { size * 0.25 } else { size };
        T::from_f64(if signed && (i + salt).is_multiple_of(3) { -size } else { size })
    };
    (0..count).map(value).collect()
}

fn tensor<T: WithDType>(values: &[T], dims: &[usize]) -> Tensor {
    Tensor::from_slice(values, dims, &Device::Cpu).unwrap()
}

/// Dimensions and strides of tensors of one shape, as candle hands them over.
fn info(of: &[&Tensor]) -> Vec<u64> {
    let strides = of.iter().flat_map(|t| t.layout().stride()).copied();
    of[0].dims().iter().copied().chain(strides).map(|n| n as u64).collect()
}

fn flat<T: WithDType>(t: &Tensor) -> Vec<T> {
    t.contiguous().unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// Equal, or for floats within a few steps of the type.
fn close<T: WithDType>(what: &str, got: &[T], expected: &[T]) {
    assert_eq!(got.len(), expected.len(), "{what}");
    let step = match T::DTYPE {
        DType::F32 => 4e-7,
        DType::F64 => 1e-15,
        DType::F16 => 1e-3,
        DType::BF16 => 8e-3,
        _ => 0.0,
    };
    for (i, (g, e)) in got.iter().zip(expected).enumerate() {
        let (g, e) = (g.to_f64(), e.to_f64());
        let same = g == e || (g.is_nan() && e.is_nan());
        assert!(
            same || (g - e).abs() <= step * e.abs().max(1.0),
            "{what}: {g} at {i}, expected {e}"
        );
    }
}

type Unary<T> = unsafe extern "C" fn(u64, u64, *const u64, *const T, *mut T);

/// Runs a kernel of one input, contiguous and transposed.
fn unary<T: WithDType>(name: &str, input: &[T], of: fn(&Tensor) -> Result<Tensor>) {
    let name = format!("{name}_{}", T::DTYPE.as_str());
    let n = input.len();
    // SAFETY: lengths as the text reads and writes them; so in all that follows.
    made::<Unary<T>, T>(&name, of(&tensor(input, &[n])), |kernel, to| unsafe {
        kernel(n as u64, 1, null(), input.as_ptr(), to)
    });
    let turned = tensor(&input[..60], &[3, 4, 5]).transpose(0, 2).unwrap();
    let shape = info(&[&turned]);
    let name = format!("{name}, turned");
    made::<Unary<T>, T>(&name, of(&turned), |kernel, to| unsafe {
        kernel(60, 3, shape.as_ptr(), input.as_ptr(), to)
    });
}

fn unary_functions<T: WithDType>() {
    // Past one block, so that the second is needed.
    let all = values::<T>(1500, 1);
    let above: Vec<T> = all.iter().map(|v| T::from_f64(v.to_f64().abs())).collect();
    unary("uneg", &all, Tensor::neg);
    unary("urecip", &all, Tensor::recip);
    unary("uexp", &all, Tensor::exp);
    unary("ulog", &above, Tensor::log);
    unary("usin", &all, Tensor::sin);
    unary("ucos", &all, Tensor::cos);
    unary("utanh", &all, Tensor::tanh);
    unary("uerf", &all, Tensor::erf);
    unary("uceil", &all, Tensor::ceil);
    unary("ufloor", &all, Tensor::floor);
    unary("uround", &all, Tensor::round);
    unary("uabs", &all, Tensor::abs);
    unary("usqr", &all, Tensor::sqr);
    unary("usqrt", &above, Tensor::sqrt);
    unary("urelu", &all, Tensor::relu);
    unary("usilu", &all, Tensor::silu);
    unary("usign", &all, Tensor::sign);
    unary("ugelu", &all, Tensor::gelu);
    unary("ugelu_erf", &all, Tensor::gelu_erf);
    unary("usigmoid", &all, |x| (x.neg()?.exp()? + 1.0)?.recip());
    type With<T> = unsafe extern "C" fn(u64, u64, *const u64, T, *const T, *mut T);
    let half = T::from_f64(1.5);
    let two: [(&str, &[T], Of1); 2] =
        [("upowf", &above, |x| x.powf(1.5)), ("uelu", &all, |x| x.elu(1.5))];
    for (name, input, of) in two {
        let (name, n) = (format!("{name}_{}", T::DTYPE.as_str()), input.len());
        made::<With<T>, T>(&name, of(&tensor(input, &[n])), |kernel, to| unsafe {
            kernel(n as u64, 1, null(), half, input.as_ptr(), to);
        });
    }
}

/// Calls a function for each of the types that kernels are compiled for.
macro_rules! for_types {
    ($function:ident: $($t:ty),*) => {{
        let _alone = alone();
        if LIBRARY.is_none() {
            return;
        }
        $($function::<$t>();)*
    }};
}

#[test]
fn functions_of_one_value() {
    for_types!(unary_functions: f32, f64, f16, bf16);
}

fn of_all_types<T: WithDType>() {
    let name = |root: &str| format!("{root}_{}", T::DTYPE.as_str());
    let all = values::<T>(1500, 2);
    unary("ucopy", &all, |x| Ok(x.clone()));
    type Affine<T> = unsafe extern "C" fn(u64, u64, *const u64, *const T, *mut T, T, T);
    let turned = tensor(&all[..12], &[3, 4]).t().unwrap();
    let shape = info(&[&turned]);
    let (factor, shift) = (T::from_f64(2.0), T::from_f64(3.0));
    made::<Affine<T>, T>(&name("affine"), turned.affine(2.0, 3.0), |kernel, to| unsafe {
        kernel(12, 2, shape.as_ptr(), all.as_ptr(), to, factor, shift)
    });
    // One value everywhere, in a part of a matrix.
    type Fill<T> = unsafe extern "C" fn(u64, u64, *const u64, T, *mut T);
    let before = values::<T>(20, 0);
    let mut expected = before.clone();
    (0..3).for_each(|row| expected[1 + 5 * row..3 + 5 * row].fill(factor));
    let part = [3_u64, 2, 5, 1];
    check::<Fill<T>, T>(&name("const_set"), before, 6, &expected, |kernel, to| unsafe {
        kernel(6, 2, part.as_ptr(), factor, to.add(1))
    });
    // A rectangle.
    type Copy2d<T> = unsafe extern "C" fn(*const T, *mut T, u32, u32, u32, u32);
    let mut expected = vec![T::zero(); 40];
    for row in 0..5 {
        expected[7 * row..7 * row + 3].copy_from_slice(&all[4 * row..4 * row + 3]);
    }
    let zeros = vec![T::zero(); 40];
    check::<Copy2d<T>, T>(&name("copy2d"), zeros, 15, &expected, |kernel, to| unsafe {
        kernel(all.as_ptr(), to, 5, 3, 4, 7)
    });
    binary::<T>();
    chosen::<T, u8>();
    chosen::<T, u32>();
    chosen::<T, i64>();
    by_number::<T, u8>();
    by_number::<T, u32>();
    by_number::<T, i64>();
    reduced::<T>();
}

fn binary<T: WithDType>() {
    type Binary<T, O> = unsafe extern "C" fn(u64, u64, *const u64, *const T, *const T, *mut O);
    let (mut a, mut b) = (values::<T>(1100, 5), values::<T>(1100, 4));
    let n = a.len();
    let arithmetic: [(&str, Of2); 6] = [
        ("badd", |a, b| a + b),
        ("bsub", |a, b| a - b),
        ("bmul", |a, b| a * b),
        ("bdiv", |a, b| a / b),
        ("bminimum", |a, b| a.minimum(b)),
        ("bmaximum", |a, b| a.maximum(b)),
    ];
    // Of whole numbers without sign no difference below 0.
    if !T::DTYPE.is_float() && T::DTYPE != DType::I64 {
        a.iter_mut().for_each(|v| *v = T::from_f64(v.to_f64() + 11.0));
    }
    for (root, of) in arithmetic {
        let name = format!("{root}_{}", T::DTYPE.as_str());
        let expected = of(&tensor(&a, &[n]), &tensor(&b, &[n]));
        made::<Binary<T, T>, T>(&name, expected, |kernel, to| unsafe {
            kernel(n as u64, 1, null(), a.as_ptr(), b.as_ptr(), to);
        });
        // One input turned, the other one row for all.
        let x = tensor(&a[..12], &[3, 4]).t().unwrap();
        let y = tensor(&b[..3], &[3]).broadcast_as((4, 3)).unwrap();
        let (shape, name) = (info(&[&x, &y]), format!("{name}, strided"));
        made::<Binary<T, T>, T>(&name, of(&x, &y), |kernel, to| unsafe {
            kernel(12, 2, shape.as_ptr(), a.as_ptr(), b.as_ptr(), to);
        });
    }
    let comparisons: [(&str, Of2); 6] = [
        ("eq", |a, b| a.eq(b)),
        ("ne", |a, b| a.ne(b)),
        ("lt", |a, b| a.lt(b)),
        ("le", |a, b| a.le(b)),
        ("gt", |a, b| a.gt(b)),
        ("ge", |a, b| a.ge(b)),
    ];
    b.iter_mut().zip(&a).step_by(2).for_each(|(b, a)| *b = *a);
    for (root, of) in comparisons {
        let name = format!("{root}_{}", T::DTYPE.as_str());
        let expected = flat::<u8>(&of(&tensor(&a, &[n]), &tensor(&b, &[n])).unwrap());
        check::<Binary<T, u8>, u8>(&name, vec![7; n], n, &expected, |kernel, to| unsafe {
            kernel(n as u64, 1, null(), a.as_ptr(), b.as_ptr(), to);
        });
    }
}

fn chosen<T: WithDType, C: WithDType>() {
    type Where<T, C> =
        unsafe extern "C" fn(u64, u64, *const u64, *const C, *const T, *const T, *mut T);
    let name = format!("where_{}_{}", C::DTYPE.as_str(), T::DTYPE.as_str());
    let (a, b) = (values::<T>(12, 1), values::<T>(12, 2));
    let c: Vec<C> = (0..12).map(|i| C::from_f64([0.0, 1.0, 3.0][i % 3])).collect();
    let condition = tensor(&c, &[3, 4]).t().unwrap();
    let (x, y) = (tensor(&a, &[4, 3]), tensor(&b, &[3, 4]).t().unwrap());
    let shape = info(&[&condition, &x, &y]);
    made::<Where<T, C>, T>(&name, condition.where_cond(&x, &y), |kernel, to| unsafe {
        kernel(12, 2, shape.as_ptr(), c.as_ptr(), a.as_ptr(), b.as_ptr(), to);
    });
}

/// Whether a kernel met a number outside since the last call.
fn was_outside() -> bool {
    unsafe { symbol::<unsafe extern "C" fn() -> bool>("was_outside")() }
}

/// Rows by number. `x`: `[2, 5, 3]`, by the middle
fn selected<T: WithDType, I: WithDType>(name: &str, x: &Tensor, source: &[T]) {
    type Select<T, I> =
        unsafe extern "C" fn(u64, u64, *const u64, *const I, *const T, *mut T, u64, u64, u64, u64);
    let ids: Vec<I> = [4, 0, 0, 2, 4, 1, 3].map(|i| I::from_f64(f64::from(i))).to_vec();
    let n = ids.len();
    let index = tensor(&ids, &[n]);
    let shape = info(&[&index]);
    let mut expected = flat::<T>(&x.index_select(&index, 1).unwrap());
    let count = expected.len();
    let select = |ids: &[I], expected: &[T]| {
        let zeros = vec![T::zero(); count];
        check::<Select<T, I>, T>(name, zeros, count, expected, |kernel, to| unsafe {
            let (c, n) = (count as u64, n as u64);
            kernel(c, 1, shape.as_ptr(), ids.as_ptr(), source.as_ptr(), to, 2, 5, n, 3);
        });
    };
    select(&ids, &expected);
    // A number outside is noticed, and "none" is not; rows of both are 0.
    assert!(!was_outside());
    for row in [6, 6 + 3 * n] {
        expected[row..row + 3].fill(T::zero());
    }
    let none = match I::DTYPE {
        DType::U8 => 255.0,
        DType::U32 => f64::from(u32::MAX),
        _ => i64::MAX as f64,
    };
    let mut wrong = ids;
    wrong[2] = I::from_f64(none);
    select(&wrong, &expected);
    assert!(!was_outside(), "{name}");
    wrong[2] = I::from_f64(5.0);
    let kernel = symbol::<Select<T, I>>(name);
    let mut out = vec![T::zero(); count];
    let to = out.as_mut_ptr() as usize;
    grid(1, 1024, false, &|| unsafe {
        let (c, n, to) = (count as u64, n as u64, to as *mut T);
        kernel(c, 1, shape.as_ptr(), wrong.as_ptr(), source.as_ptr(), to, 2, 5, n, 3);
    });
    assert!(was_outside(), "{name}");
}

fn by_number<T: WithDType, I: WithDType>() {
    let name = |root: &str| format!("{root}_{}_{}", I::DTYPE.as_str(), T::DTYPE.as_str());
    let source = values::<T>(30, 3);
    let x = tensor(&source, &[2, 5, 3]);
    selected::<T, I>(&name("is"), &x, &source);

    // Numbers for each element of 2 × 2 × 3.
    let ids: Vec<I> = (0..12).map(|i| I::from_f64(((i * 3 + 1) % 5) as f64)).collect();
    let index = tensor(&ids, &[2, 2, 3]);
    type Gather<T, I> = unsafe extern "C" fn(u64, *const I, *const T, *mut T, u64, u64, u64, u64);
    made::<Gather<T, I>, T>(&name("gather"), x.gather(&index, 1), |kernel, to| unsafe {
        kernel(12, ids.as_ptr(), source.as_ptr(), to, 2, 5, 2, 3)
    });

    // Sums and writes into 2 × 5 × 3.
    let added = values::<T>(12, 8);
    let addend = tensor(&added, &[2, 2, 3]);
    let twice: Vec<I> = [3.0, 3.0].map(I::from_f64).to_vec();
    type Add<T, I> = unsafe extern "C" fn(*const I, u64, *const T, *mut T, u64, u64, u64, u64);
    let expected = flat(&x.index_add(&tensor(&twice, &[2]), &addend, 1).unwrap());
    check::<Add<T, I>, T>(&name("ia"), source.clone(), 6, &expected, |kernel, to| unsafe {
        kernel(twice.as_ptr(), 2, added.as_ptr(), to, 2, 2, 5, 3)
    });
    type Scatter<T, I> = unsafe extern "C" fn(*const I, *const T, *mut T, u64, u64, u64, u64);
    for (root, expected) in
        [("s", x.scatter(&index, &addend, 1)), ("sa", x.scatter_add(&index, &addend, 1))]
    {
        let expected = flat(&expected.unwrap());
        check::<Scatter<T, I>, T>(&name(root), source.clone(), 6, &expected, |kernel, to| unsafe {
            kernel(ids.as_ptr(), added.as_ptr(), to, 2, 2, 5, 3)
        });
    }
}

type Reduce<T, O> = unsafe extern "C" fn(u64, u64, u64, *const u64, *const T, *mut O);

/// One value for each row of a turned matrix, by blocks of threads that meet or, in groups of 256 threads, alone.
fn over_rows<T: WithDType, O: WithDType>(root: &str, all: &[T], x: &Tensor, of: Of1, meet: bool) {
    let (kept, over) = x.dims2().unwrap();
    let (name, shape) = (format!("{root}_{}", T::DTYPE.as_str()), info(&[x]));
    let kernel = symbol::<Reduce<T, O>>(&name);
    let mut out = vec![O::zero(); kept];
    let to = out.as_mut_ptr() as usize;
    let (blocks, threads, count) = match meet {
        true => (kept as u32, over.min(1024).next_power_of_two() as u32, all.len()),
        false => (1, 256, kept),
    };
    grid(blocks, threads, meet, &|| unsafe {
        kernel(count as u64, over as u64, 2, shape.as_ptr(), all.as_ptr(), to as *mut O);
    });
    close(&format!("{name} of {over}"), &out, &flat(&of(x).unwrap()));
}

fn reduced<T: WithDType>() {
    // So many values that a thread takes two, or that some take none.
    for (kept, over) in [(3, 1), (2, 5), (3, 33), (2, 100), (1, 1500)] {
        let all = values::<T>(kept * over, 6);
        let x = tensor(&all, &[over, kept]).t().unwrap();
        // Of small whole numbers the sum of many is another one in the types that hold few.
        if over <= 33 || !matches!(T::DTYPE, DType::U8 | DType::F16 | DType::BF16) {
            over_rows::<T, T>("fast_sum", &all, &x, |x| x.sum(D::Minus1), true);
        }
        over_rows::<T, T>("fast_min", &all, &x, |x| x.min(D::Minus1), true);
        over_rows::<T, T>("fast_max", &all, &x, |x| x.max(D::Minus1), true);
        over_rows::<T, u32>("fast_argmin", &all, &x, |x| x.argmin(D::Minus1), true);
        over_rows::<T, u32>("fast_argmax", &all, &x, |x| x.argmax(D::Minus1), true);
        if over <= 32 {
            over_rows::<T, T>("fast_sum_small", &all, &x, |x| x.sum(D::Minus1), false);
        }
    }
}

#[test]
fn operations_of_all_types() {
    for_types!(of_all_types: f32, f64, f16, bf16, u8, u32, i64);
}

type Cast<A, B> = unsafe extern "C" fn(u64, u64, *const u64, *const A, *mut B);

fn cast<A: WithDType, B: WithDType>() {
    let name = format!("cast_{}_{}", A::DTYPE.as_str(), B::DTYPE.as_str());
    let mut input = values::<A>(58, 1);
    let last = if A::DTYPE.is_float() { [f64::NAN, -1e9, 1e30] } else { [200.0, 0.0, 255.0] };
    input.extend(last.map(A::from_f64));
    let turned = tensor(&input[1..], &[3, 20]).t().unwrap();
    let shape = info(&[&turned]);
    made::<Cast<A, B>, B>(&name, turned.to_dtype(B::DTYPE), |kernel, to| unsafe {
        kernel(60, 2, shape.as_ptr(), input[1..].as_ptr(), to)
    });
}

fn casts<A: WithDType>() {
    cast::<A, f32>();
    cast::<A, f64>();
    cast::<A, f16>();
    cast::<A, bf16>();
    cast::<A, u8>();
    cast::<A, u32>();
    cast::<A, i64>();
}

#[test]
fn from_type_to_type() {
    for_types!(casts: f32, f64, f16, bf16, u8, u32, i64);
}

/// Casts all of `input`, and compares the bits with those of `want`.
fn same_bits<A: WithDType + std::fmt::Debug, B: WithDType + std::fmt::Debug>(
    input: &[A],
    want: impl Fn(A) -> B,
    bits: fn(B) -> u32,
) {
    let name = format!("cast_{}_{}", A::DTYPE.as_str(), B::DTYPE.as_str());
    let kernel = symbol::<Cast<A, B>>(&name);
    let mut out = vec![B::zero(); input.len()];
    let (n, to) = (input.len(), out.as_mut_ptr() as usize);
    grid((n as u32).div_ceil(1024), 1024, false, &|| unsafe {
        kernel(n as u64, 1, null(), input.as_ptr(), to as *mut B)
    });
    for (got, v) in out.iter().zip(input) {
        let nan = v.to_f64().is_nan() && got.to_f64().is_nan();
        assert!(nan || bits(*got) == bits(want(*v)), "{name}: {v:?}: {got:?}");
    }
}

/// All values of 16 bits, and f32 values between and beside them.
#[test]
fn halves_are_rounded_to_the_nearest() {
    let _alone = alone();
    if LIBRARY.is_none() {
        return;
    }
    let (halves, brains): (Vec<f16>, Vec<bf16>) =
        (0..=u16::MAX).map(|b| (f16::from_bits(b), bf16::from_bits(b))).unzip();
    same_bits(&halves, f16::to_f32, f32::to_bits);
    let near =
        |v: f32| [v, v.next_up(), v.next_down(), v * 1.000_244_1, v * 1.001_953_1, v * 0.999_9];
    let all = halves.iter().map(|h| h.to_f32()).chain(brains.iter().map(|b| b.to_f32()));
    let inputs: Vec<f32> = all.flat_map(near).collect();
    same_bits(&inputs, f16::from_f32, |v: f16| v.to_bits().into());
    same_bits(&inputs, bf16::from_f32, |v: bf16| v.to_bits().into());
}
