//! The kernels behind candle's CUDA tensors, compiled for the CPU and started as candle starts them, against candle's
//! CPU tensors. What they are compiled to for a device is not executed here.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]
// Each call starts a kernel with arrays of the lengths that it is told, which outlive it.
#![allow(clippy::undocumented_unsafe_blocks, clippy::semicolon_if_nothing_returned)]

use candle_core::{D, DType, Device, Result, Tensor, WithDType};
use half::{bf16, f16};
use libloading::Library;
use std::path::PathBuf;
use std::process::Command;
use std::sync::{Barrier, LazyLock, Mutex, MutexGuard, PoisonError, RwLock};

/// All texts in one library; `None` without a C++ compiler.
static LIBRARY: LazyLock<Option<Library>> = LazyLock::new(|| {
    let here = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let texts = here.join("../patches/candle-kernels/src/cuda");
    let folder = tempfile::tempdir().unwrap();
    let mut all = std::fs::read_to_string(here.join("tests/candle_kernels/grid.h")).unwrap();
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

fn symbol<T>(name: &str) -> libloading::Symbol<'static, T> {
    let library = LIBRARY.as_ref().unwrap();
    // SAFETY: types are checked by the results.
    unsafe { library.get(name.as_bytes()) }.unwrap_or_else(|_| panic!("no kernel {name}"))
}

/// Calls `one` for each thread of a grid; threads of a block that `meet` run at once.
fn grid(blocks: u32, threads: u32, meet: bool, one: impl Fn() + Sync) {
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
                let (place, one) = (&place, &one);
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

/// As candle sizes the grid of kernels that go element by element.
fn each(count: usize, one: impl Fn() + Sync) {
    grid((count as u32).div_ceil(1024), 1024, false, one);
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
fn unary<T: WithDType>(name: &str, input: &[T], of: impl Fn(&Tensor) -> Result<Tensor>) {
    let name = format!("{name}_{}", T::DTYPE.as_str());
    let kernel = symbol::<Unary<T>>(&name);
    let plain = tensor(input, &[input.len()]);
    let mut out = vec![T::zero(); input.len()];
    let to = out.as_mut_ptr() as usize;
    // SAFETY: lengths as the text reads and writes them; so in all that follows.
    each(out.len(), || unsafe {
        kernel(input.len() as u64, 1, std::ptr::null(), input.as_ptr(), to as *mut T)
    });
    close(&name, &out, &flat(&of(&plain).unwrap()));
    let turned = tensor(&input[..60], &[3, 4, 5]).transpose(0, 2).unwrap();
    let (shape, mut out) = (info(&[&turned]), vec![T::zero(); 60]);
    let to = out.as_mut_ptr() as usize;
    each(60, || unsafe { kernel(60, 3, shape.as_ptr(), input.as_ptr(), to as *mut T) });
    close(&format!("{name}, turned"), &out, &flat(&of(&turned).unwrap()));
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
    for (name, of) in [
        ("upowf", (|x: &Tensor| x.powf(1.5)) as fn(&Tensor) -> Result<Tensor>),
        ("uelu", |x| x.elu(1.5)),
    ] {
        let name = format!("{name}_{}", T::DTYPE.as_str());
        let kernel = symbol::<With<T>>(&name);
        let mut out = vec![T::zero(); above.len()];
        let (to, half) = (out.as_mut_ptr() as usize, T::from_f64(1.5));
        let input = if name.starts_with("uelu") { &all } else { &above };
        each(out.len(), || unsafe {
            kernel(input.len() as u64, 1, std::ptr::null(), half, input.as_ptr(), to as *mut T);
        });
        close(&name, &out, &flat(&of(&tensor(input, &[input.len()])).unwrap()));
    }
}

#[test]
fn functions_of_one_value() {
    let _alone = alone();
    if LIBRARY.is_none() {
        return;
    }
    unary_functions::<f32>();
    unary_functions::<f64>();
    unary_functions::<f16>();
    unary_functions::<bf16>();
}

fn of_all_types<T: WithDType>() {
    let name = |root: &str| format!("{root}_{}", T::DTYPE.as_str());
    let all = values::<T>(1500, 2);
    unary("ucopy", &all, |x| Ok(x.clone()));
    // Affine.
    type Affine<T> = unsafe extern "C" fn(u64, u64, *const u64, *const T, *mut T, T, T);
    let kernel = symbol::<Affine<T>>(&name("affine"));
    let turned = tensor(&all[..12], &[3, 4]).t().unwrap();
    let (shape, mut out) = (info(&[&turned]), vec![T::zero(); 12]);
    let to = out.as_mut_ptr() as usize;
    let (factor, shift) = (T::from_f64(2.0), T::from_f64(3.0));
    each(12, || unsafe {
        kernel(12, 2, shape.as_ptr(), all.as_ptr(), to as *mut T, factor, shift)
    });
    close(&name("affine"), &out, &flat(&turned.affine(2.0, 3.0).unwrap()));
    // One value everywhere, in a part of a matrix.
    type Fill<T> = unsafe extern "C" fn(u64, u64, *const u64, T, *mut T);
    let kernel = symbol::<Fill<T>>(&name("const_set"));
    let mut out = values::<T>(20, 0);
    let mut expected = out.clone();
    let to = out[1..].as_mut_ptr() as usize;
    let part = [3_u64, 2, 5, 1];
    each(6, || unsafe { kernel(6, 2, part.as_ptr(), factor, to as *mut T) });
    for row in 0..3 {
        expected[1 + 5 * row..3 + 5 * row].fill(factor);
    }
    close(&name("const_set"), &out, &expected);
    // A rectangle.
    type Copy2d<T> = unsafe extern "C" fn(*const T, *mut T, u32, u32, u32, u32);
    let kernel = symbol::<Copy2d<T>>(&name("copy2d"));
    let (mut out, mut expected) = (vec![T::zero(); 40], vec![T::zero(); 40]);
    let to = out.as_mut_ptr() as usize;
    each(15, || unsafe { kernel(all.as_ptr(), to as *mut T, 5, 3, 4, 7) });
    for row in 0..5 {
        expected[7 * row..7 * row + 3].copy_from_slice(&all[4 * row..4 * row + 3]);
    }
    close(&name("copy2d"), &out, &expected);
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
    let (a, b) = (values::<T>(1100, 5), values::<T>(1100, 4));
    type Of = fn(&Tensor, &Tensor) -> Result<Tensor>;
    let arithmetic: [(&str, Of); 6] = [
        ("badd", |a, b| a + b),
        ("bsub", |a, b| a - b),
        ("bmul", |a, b| a * b),
        ("bdiv", |a, b| a / b),
        ("bminimum", |a, b| a.minimum(b)),
        ("bmaximum", |a, b| a.maximum(b)),
    ];
    // Of whole numbers without sign no difference below 0.
    let (a, b) = if T::DTYPE.is_float() || T::DTYPE == DType::I64 {
        (a, b)
    } else {
        (a.iter().map(|v| T::from_f64(v.to_f64() + 11.0)).collect(), b)
    };
    for (root, of) in arithmetic {
        let name = format!("{root}_{}", T::DTYPE.as_str());
        let kernel = symbol::<Binary<T, T>>(&name);
        let mut out = vec![T::zero(); a.len()];
        let to = out.as_mut_ptr() as usize;
        each(a.len(), || unsafe {
            kernel(a.len() as u64, 1, std::ptr::null(), a.as_ptr(), b.as_ptr(), to as *mut T);
        });
        let (x, y) = (tensor(&a, &[a.len()]), tensor(&b, &[b.len()]));
        close(&name, &out, &flat(&of(&x, &y).unwrap()));
        // One input turned, the other one row for all.
        let x = tensor(&a[..12], &[3, 4]).t().unwrap();
        let y = tensor(&b[..3], &[3]).broadcast_as((4, 3)).unwrap();
        let (shape, mut out) = (info(&[&x, &y]), vec![T::zero(); 12]);
        let to = out.as_mut_ptr() as usize;
        each(12, || unsafe { kernel(12, 2, shape.as_ptr(), a.as_ptr(), b.as_ptr(), to as *mut T) });
        close(&format!("{name}, strided"), &out, &flat(&of(&x, &y).unwrap()));
    }
    let comparisons: [(&str, Of); 6] = [
        ("eq", |a, b| a.eq(b)),
        ("ne", |a, b| a.ne(b)),
        ("lt", |a, b| a.lt(b)),
        ("le", |a, b| a.le(b)),
        ("gt", |a, b| a.gt(b)),
        ("ge", |a, b| a.ge(b)),
    ];
    let b: Vec<T> =
        a.iter().zip(&b).enumerate().map(|(i, (a, b))| if i % 2 == 0 { *a } else { *b }).collect();
    for (root, of) in comparisons {
        let name = format!("{root}_{}", T::DTYPE.as_str());
        let kernel = symbol::<Binary<T, u8>>(&name);
        let mut out = vec![7_u8; a.len()];
        let to = out.as_mut_ptr() as usize;
        each(a.len(), || unsafe {
            kernel(a.len() as u64, 1, std::ptr::null(), a.as_ptr(), b.as_ptr(), to as *mut u8);
        });
        let (x, y) = (tensor(&a, &[a.len()]), tensor(&b, &[b.len()]));
        close(&name, &out, &flat(&of(&x, &y).unwrap()));
    }
}

fn chosen<T: WithDType, C: WithDType>() {
    type Where<T, C> =
        unsafe extern "C" fn(u64, u64, *const u64, *const C, *const T, *const T, *mut T);
    let name = format!("where_{}_{}", C::DTYPE.as_str(), T::DTYPE.as_str());
    let kernel = symbol::<Where<T, C>>(&name);
    let (a, b) = (values::<T>(12, 1), values::<T>(12, 2));
    let c: Vec<C> = (0..12).map(|i| C::from_f64([0.0, 1.0, 3.0][i % 3])).collect();
    let condition = tensor(&c, &[3, 4]).t().unwrap();
    let (x, y) = (tensor(&a, &[4, 3]), tensor(&b, &[3, 4]).t().unwrap());
    let (shape, mut out) = (info(&[&condition, &x, &y]), vec![T::zero(); 12]);
    let to = out.as_mut_ptr() as usize;
    each(12, || unsafe {
        kernel(12, 2, shape.as_ptr(), c.as_ptr(), a.as_ptr(), b.as_ptr(), to as *mut T);
    });
    close(&name, &out, &flat(&condition.where_cond(&x, &y).unwrap()));
}

fn by_number<T: WithDType, I: WithDType>() {
    let name = |root: &str| format!("{root}_{}_{}", I::DTYPE.as_str(), T::DTYPE.as_str());
    // 2 × 5 × 3, by the middle.
    let source = values::<T>(30, 3);
    let x = tensor(&source, &[2, 5, 3]);
    let ids: Vec<I> = [4, 0, 0, 2, 4, 1, 3].map(|i| I::from_f64(f64::from(i))).to_vec();
    let n = ids.len();
    type Select<T, I> =
        unsafe extern "C" fn(u64, u64, *const u64, *const I, *const T, *mut T, u64, u64, u64, u64);
    let kernel = symbol::<Select<T, I>>(&name("is"));
    let index = tensor(&ids, &[n]);
    let (shape, mut out) = (info(&[&index]), vec![T::zero(); 2 * n * 3]);
    let (to, count) = (out.as_mut_ptr() as usize, out.len());
    let select = |ids: &[I]| {
        each(count, || unsafe {
            kernel(
                count as u64,
                1,
                shape.as_ptr(),
                ids.as_ptr(),
                source.as_ptr(),
                to as *mut T,
                2,
                5,
                n as u64,
                3,
            );
        });
    };
    select(&ids);
    close(&name("is"), &out, &flat(&x.index_select(&index, 1).unwrap()));
    // A number outside is noticed, and "none" is not.
    let outside = symbol::<unsafe extern "C" fn() -> bool>("was_outside");
    assert!(!unsafe { outside() });
    let mut wrong = ids;
    wrong[2] = I::from_f64(5.0);
    select(&wrong);
    assert!(unsafe { outside() }, "{}", name("is"));
    wrong[2] = match I::DTYPE {
        DType::U8 => I::from_f64(255.0),
        DType::U32 => I::from_f64(f64::from(u32::MAX)),
        _ => I::from_f64(i64::MAX as f64),
    };
    select(&wrong);
    assert!(!unsafe { outside() } && out[6..9].iter().all(|v| v.to_f64() == 0.0), "{}", name("is"));

    // Numbers for each element of 2 × 2 × 3.
    let ids: Vec<I> = (0..12).map(|i| I::from_f64(((i * 3 + 1) % 5) as f64)).collect();
    let index = tensor(&ids, &[2, 2, 3]);
    type Gather<T, I> = unsafe extern "C" fn(u64, *const I, *const T, *mut T, u64, u64, u64, u64);
    let kernel = symbol::<Gather<T, I>>(&name("gather"));
    let mut out = vec![T::zero(); 12];
    let to = out.as_mut_ptr() as usize;
    each(12, || unsafe { kernel(12, ids.as_ptr(), source.as_ptr(), to as *mut T, 2, 5, 2, 3) });
    close(&name("gather"), &out, &flat(&x.gather(&index, 1).unwrap()));

    // Sums and writes into 2 × 5 × 3.
    let added = values::<T>(12, 8);
    let addend = tensor(&added, &[2, 2, 3]);
    let twice: Vec<I> = [3.0, 3.0].map(I::from_f64).to_vec();
    type Add<T, I> = unsafe extern "C" fn(*const I, u64, *const T, *mut T, u64, u64, u64, u64);
    let kernel = symbol::<Add<T, I>>(&name("ia"));
    let mut out = source.clone();
    let to = out.as_mut_ptr() as usize;
    each(6, || unsafe { kernel(twice.as_ptr(), 2, added.as_ptr(), to as *mut T, 2, 2, 5, 3) });
    close(&name("ia"), &out, &flat(&x.index_add(&tensor(&twice, &[2]), &addend, 1).unwrap()));
    type Scatter<T, I> = unsafe extern "C" fn(*const I, *const T, *mut T, u64, u64, u64, u64);
    type Of = fn(&Tensor, &Tensor, &Tensor) -> Result<Tensor>;
    let both: [(&str, Of); 2] =
        [("s", |x, i, a| x.scatter(i, a, 1)), ("sa", |x, i, a| x.scatter_add(i, a, 1))];
    for (root, of) in both {
        let kernel = symbol::<Scatter<T, I>>(&name(root));
        let mut out = source.clone();
        let to = out.as_mut_ptr() as usize;
        each(6, || unsafe { kernel(ids.as_ptr(), added.as_ptr(), to as *mut T, 2, 2, 5, 3) });
        close(&name(root), &out, &flat(&of(&x, &index, &addend).unwrap()));
    }
}

fn reduced<T: WithDType>() {
    type Reduce<T, O> = unsafe extern "C" fn(u64, u64, u64, *const u64, *const T, *mut O);
    type Of = fn(&Tensor) -> Result<Tensor>;
    // Over the last dimension of a turned tensor; so many values that a thread takes two, or that some take none.
    for (kept, over) in [(3, 1), (2, 5), (3, 33), (2, 100), (1, 1500)] {
        let all = values::<T>(kept * over, 6);
        let x = tensor(&all, &[over, kept]).t().unwrap();
        let (shape, threads) = (info(&[&x]), over.min(1024).next_power_of_two() as u32);
        let extremes: [(&str, Of); 3] = [
            ("fast_sum", |x| x.sum(D::Minus1)),
            ("fast_min", |x| x.min(D::Minus1)),
            ("fast_max", |x| x.max(D::Minus1)),
        ];
        // Of small whole numbers the sum of many is another one in the types that hold few.
        let small = matches!(T::DTYPE, DType::U8 | DType::F16 | DType::BF16) && over > 33;
        for (root, of) in extremes.into_iter().skip(usize::from(small)) {
            let name = format!("{root}_{}", T::DTYPE.as_str());
            let kernel = symbol::<Reduce<T, T>>(&name);
            let mut out = vec![T::zero(); kept];
            let to = out.as_mut_ptr() as usize;
            grid(kept as u32, threads, true, || unsafe {
                kernel(
                    all.len() as u64,
                    over as u64,
                    2,
                    shape.as_ptr(),
                    all.as_ptr(),
                    to as *mut T,
                );
            });
            close(&format!("{name} of {over}"), &out, &flat(&of(&x).unwrap()));
        }
        let places: [(&str, Of); 2] =
            [("fast_argmin", |x| x.argmin(D::Minus1)), ("fast_argmax", |x| x.argmax(D::Minus1))];
        for (root, of) in places {
            let name = format!("{root}_{}", T::DTYPE.as_str());
            let kernel = symbol::<Reduce<T, u32>>(&name);
            let mut out = vec![0_u32; kept];
            let to = out.as_mut_ptr() as usize;
            grid(kept as u32, threads, true, || unsafe {
                kernel(
                    all.len() as u64,
                    over as u64,
                    2,
                    shape.as_ptr(),
                    all.as_ptr(),
                    to as *mut u32,
                );
            });
            close(&format!("{name} of {over}"), &out, &flat(&of(&x).unwrap()));
        }
        if over <= 32 {
            let name = format!("fast_sum_small_{}", T::DTYPE.as_str());
            let kernel = symbol::<Reduce<T, T>>(&name);
            let mut out = vec![T::zero(); kept];
            let to = out.as_mut_ptr() as usize;
            grid(1, 256, false, || unsafe {
                kernel(kept as u64, over as u64, 2, shape.as_ptr(), all.as_ptr(), to as *mut T);
            });
            close(&format!("{name} of {over}"), &out, &flat(&x.sum(D::Minus1).unwrap()));
        }
    }
}

#[test]
fn operations_of_all_types() {
    let _alone = alone();
    if LIBRARY.is_none() {
        return;
    }
    of_all_types::<f32>();
    of_all_types::<f64>();
    of_all_types::<f16>();
    of_all_types::<bf16>();
    of_all_types::<u8>();
    of_all_types::<u32>();
    of_all_types::<i64>();
}

fn cast<A: WithDType, B: WithDType>() {
    type Cast<A, B> = unsafe extern "C" fn(u64, u64, *const u64, *const A, *mut B);
    let name = format!("cast_{}_{}", A::DTYPE.as_str(), B::DTYPE.as_str());
    let kernel = symbol::<Cast<A, B>>(&name);
    let mut input = values::<A>(58, 1);
    if A::DTYPE.is_float() {
        input.extend([A::from_f64(f64::NAN), A::from_f64(-1e9), A::from_f64(1e30)]);
    } else {
        input.extend([A::from_f64(200.0), A::from_f64(0.0), A::from_f64(255.0)]);
    }
    let turned = tensor(&input[1..], &[3, 20]).t().unwrap();
    let (shape, mut out) = (info(&[&turned]), vec![B::zero(); 60]);
    let to = out.as_mut_ptr() as usize;
    each(60, || unsafe { kernel(60, 2, shape.as_ptr(), input[1..].as_ptr(), to as *mut B) });
    close(&name, &out, &flat(&turned.to_dtype(B::DTYPE).unwrap()));
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
    let _alone = alone();
    if LIBRARY.is_none() {
        return;
    }
    casts::<f32>();
    casts::<f64>();
    casts::<f16>();
    casts::<bf16>();
    casts::<u8>();
    casts::<u32>();
    casts::<i64>();
}

/// All values of 16 bits, and f32 values between and beside them.
#[test]
fn halves_are_rounded_to_the_nearest() {
    let _alone = alone();
    if LIBRARY.is_none() {
        return;
    }
    type Cast<A, B> = unsafe extern "C" fn(u64, u64, *const u64, *const A, *mut B);
    let bits: Vec<u16> = (0..=u16::MAX).collect();
    let (halves, brains): (Vec<f16>, Vec<bf16>) =
        bits.iter().map(|b| (f16::from_bits(*b), bf16::from_bits(*b))).unzip();
    let mut wide = vec![0f32; bits.len()];
    let to = wide.as_mut_ptr() as usize;
    let from_f16 = symbol::<Cast<f16, f32>>("cast_f16_f32");
    each(bits.len(), || unsafe {
        from_f16(bits.len() as u64, 1, std::ptr::null(), halves.as_ptr(), to as *mut f32)
    });
    for (got, half) in wide.iter().zip(&halves) {
        assert!(
            got.to_bits() == half.to_f32().to_bits() || half.is_nan() && got.is_nan(),
            "{half:?}"
        );
    }
    let near =
        |v: f32| [v, v.next_up(), v.next_down(), v * 1.000_244_1, v * 1.001_953_1, v * 0.999_9];
    let inputs: Vec<f32> = halves
        .iter()
        .map(|h| h.to_f32())
        .chain(brains.iter().map(|b| b.to_f32()))
        .flat_map(near)
        .collect();
    let mut narrow = vec![f16::ZERO; inputs.len()];
    let to = narrow.as_mut_ptr() as usize;
    let kernel = symbol::<Cast<f32, f16>>("cast_f32_f16");
    each(inputs.len(), || unsafe {
        kernel(inputs.len() as u64, 1, std::ptr::null(), inputs.as_ptr(), to as *mut f16)
    });
    for (got, v) in narrow.iter().zip(&inputs) {
        assert!(
            got.to_bits() == f16::from_f32(*v).to_bits() || v.is_nan() && got.is_nan(),
            "{v:e}: {got:?}"
        );
    }
    let mut narrow = vec![bf16::ZERO; inputs.len()];
    let to = narrow.as_mut_ptr() as usize;
    let kernel = symbol::<Cast<f32, bf16>>("cast_f32_bf16");
    each(inputs.len(), || unsafe {
        kernel(inputs.len() as u64, 1, std::ptr::null(), inputs.as_ptr(), to as *mut bf16)
    });
    for (got, v) in narrow.iter().zip(&inputs) {
        assert!(
            got.to_bits() == bf16::from_f32(*v).to_bits() || v.is_nan() && got.is_nan(),
            "{v:e}: {got:?}"
        );
    }
}
