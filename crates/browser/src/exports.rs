//! The engine as numbers and addresses, for JavaScript.
//!
//! Each function gives 0, and leaves what it found as the answer, or 1, and leaves why not as a text. A block that is given is
//! made by [`allocate`] and belongs to the function that takes it. A panic is a bug; its text goes to `complain` before
//! the program stops, and the page starts another one.

use crate::{Engine, EngineError, Stage};
use std::cell::RefCell;

#[link(wasm_import_module = "page")]
unsafe extern "C" {
    /// A stage by its number, and how far it has come.
    safe fn progress(stage: u32, share: f64);
    /// The text of a panic.
    fn complain(text: *const u8, length: usize);
}

#[derive(Default)]
struct State {
    engine: Option<Engine>,
    answer: Vec<u8>,
    /// Blocks of the page, after [`page`].
    parts: Vec<(&'static str, Vec<u8>)>,
}

thread_local! {
    static STATE: RefCell<State> = RefCell::default();
}

/// A block of so many bytes; 0 if the memory is not to be had.
#[unsafe(no_mangle)]
pub extern "C" fn allocate(length: usize) -> *mut u8 {
    let mut block = Vec::<u8>::new();
    if block.try_reserve_exact(length).is_err() {
        return std::ptr::null_mut();
    }
    block.resize(length, 0);
    Box::leak(block.into_boxed_slice()).as_mut_ptr()
}

/// The block that JavaScript filled.
///
/// # Safety
/// It was made by [`allocate`] with this length, and given to nothing before.
unsafe fn block(address: *mut u8, length: usize) -> Vec<u8> {
    // SAFETY: the function's contract; a box of a slice has the capacity of its length.
    unsafe { Box::from_raw(std::ptr::slice_from_raw_parts_mut(address, length)) }.into_vec()
}

unsafe fn text(address: *mut u8, length: usize) -> String {
    // SAFETY: the caller's promise, passed on.
    String::from_utf8_lossy(&unsafe { block(address, length) }).into_owned()
}

fn tell(stage: Stage, share: f64) {
    progress(stage as u32, share);
}

/// Runs a function of the engine, which is made at first use.
fn answer(work: impl FnOnce(&mut State) -> Result<Vec<u8>, EngineError>) -> u32 {
    STATE.with_borrow_mut(|state| {
        state.answer = Vec::new();
        let (answer, status) = match work(state) {
            Ok(bytes) => (bytes, 0),
            Err(error) => (message(&error).into_bytes(), 1),
        };
        state.answer = answer;
        status
    })
}

/// An error with its causes.
fn message(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text.push_str(": ");
        text.push_str(&error.to_string());
        cause = error.source();
    }
    text
}

impl State {
    fn engine(&mut self) -> Result<&mut Engine, EngineError> {
        match &mut self.engine {
            Some(engine) => Ok(engine),
            none => Ok(none.insert(Engine::new()?)),
        }
    }
}

/// Must be called first.
#[unsafe(no_mangle)]
pub extern "C" fn start() {
    std::panic::set_hook(Box::new(|info| {
        let text = info.to_string();
        // SAFETY: the text outlives the call.
        unsafe { complain(text.as_ptr(), text.len()) };
    }));
}

/// Address of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn answer_address() -> *const u8 {
    STATE.with_borrow(|state| state.answer.as_ptr())
}

/// Length of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn answer_length() -> usize {
    STATE.with_borrow(|state| state.answer.len())
}

/// See [`Engine::give`].
///
/// # Safety
/// Blocks are as the module says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn give(
    name: *mut u8,
    name_length: usize,
    bytes: *mut u8,
    length: usize,
) -> u32 {
    // SAFETY: the function's contract.
    let (name, bytes) = unsafe { (text(name, name_length), block(bytes, length)) };
    answer(|_| Engine::give(&name, bytes).map(|()| Vec::new()))
}

/// See [`Engine::parse`]; the answer is JSON.
///
/// # Safety
/// Blocks are as the module says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parse(
    name: *mut u8,
    name_length: usize,
    bytes: *mut u8,
    length: usize,
) -> u32 {
    // SAFETY: the function's contract.
    let (name, bytes) = unsafe { (text(name, name_length), block(bytes, length)) };
    answer(|state| {
        state.parts = Vec::new();
        Ok(state.engine()?.parse(&name, bytes, &mut tell)?.to_string().into_bytes())
    })
}

/// See [`Engine::segment`]; the answer is JSON.
#[unsafe(no_mangle)]
pub extern "C" fn segment() -> u32 {
    answer(|state| Ok(state.engine()?.segment(&mut tell)?.to_string().into_bytes()))
}

/// See [`Engine::page`]; the answer is the names of the blocks, which [`part`] gives.
///
/// # Safety
/// Blocks are as the module says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn page(title: *mut u8, length: usize) -> u32 {
    // SAFETY: the function's contract.
    let title = unsafe { text(title, length) };
    answer(|state| {
        state.parts = Vec::new();
        let parts = state.engine()?.page(&title, &mut tell)?;
        let names: Vec<&str> = parts.iter().map(|(name, _)| *name).collect();
        let names = names.join("\n").into_bytes();
        state.parts = parts;
        Ok(names)
    })
}

/// A block of the page, which is forgotten here.
///
/// # Safety
/// Blocks are as the module says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn part(name: *mut u8, length: usize) -> u32 {
    // SAFETY: the function's contract.
    let name = unsafe { text(name, length) };
    answer(|state| {
        let at = state.parts.iter().position(|(own, _)| *own == name);
        let at = at.ok_or(EngineError::Missing("packed, or this part of it was taken,"))?;
        Ok(state.parts.swap_remove(at).1)
    })
}

/// See [`Engine::values`].
///
/// # Safety
/// Blocks are as the module says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn values(name: *mut u8, length: usize) -> u32 {
    // SAFETY: the function's contract.
    let name = unsafe { text(name, length) };
    answer(|state| state.engine()?.values(&name))
}

/// See [`Engine::write`].
///
/// # Safety
/// Blocks are as the module says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn write(
    format: *mut u8,
    format_length: usize,
    keep: *mut u8,
    length: usize,
) -> u32 {
    // SAFETY: the function's contract.
    let (format, keep) = unsafe { (text(format, format_length), block(keep, length)) };
    answer(|state| state.engine()?.write(&format, &keep, &mut tell))
}
