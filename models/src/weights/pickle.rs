//! The data inside a pickle, taken apart without running anything.
//!
//! A pickle is a program for a stack machine that may call any function of Python. Here a call is
//! only written down ([`Value::Call`]); who reads the result decides which calls it understands.
//!
//! Values live in one list and refer to each other by position, so what a pickle shares stays
//! shared: no file, however hostile, needs more memory than a fixed multiple of its length, and
//! nothing recurses.

use std::collections::HashMap;

/// Position of a value.
pub(super) type Ref = u32;

/// Most values of one pickle: thirty times what a checkpoint of 10,000 tensors has.
const MAX_VALUES: usize = 1 << 22;

/// One value.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    /// A class or function, `module.name`.
    Global(String),
    Int(i64),
    Float(f64),
    Text(String),
    Bool(bool),
    None,
    Tuple(Vec<Ref>),
    List(Vec<Ref>),
    /// Entries in their order.
    Dict(Vec<(Ref, Ref)>),
    /// A call that Python would make.
    Call {
        function: Ref,
        args: Ref,
    },
    /// Something kept outside of the pickle: a tensor's storage.
    External(Ref),
    /// Bytes, sets and integers beyond 64 bits.
    Opaque,
}

/// A parsed pickle.
#[derive(Debug)]
pub(super) struct Pickle {
    values: Vec<Value>,
    root: Ref,
}

impl Pickle {
    /// Runs the stack machine; the error says at which byte it stopped.
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut machine = Machine {
            bytes,
            at: 0,
            values: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
        };
        match machine.run() {
            Ok(root) => Ok(Self { values: machine.values, root }),
            Err(e) => Err(format!("byte {} of the pickle: {e}", machine.at)),
        }
    }

    pub(super) fn root(&self) -> &Value {
        self.get(self.root)
    }

    pub(super) fn root_ref(&self) -> Ref {
        self.root
    }

    pub(super) fn get(&self, at: Ref) -> &Value {
        &self.values[at as usize]
    }

    /// The text, if it is one.
    pub(super) fn text(&self, at: Ref) -> Option<&str> {
        match self.get(at) {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    /// A dictionary's key as a name.
    pub(super) fn key(&self, at: Ref) -> String {
        match self.get(at) {
            Value::Text(text) => text.clone(),
            Value::Int(v) => v.to_string(),
            _ => "(no text)".to_owned(),
        }
    }
}

struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    values: Vec<Value>,
    stack: Vec<Ref>,
    /// Heights of the stack.
    marks: Vec<usize>,
    memo: HashMap<u32, Ref>,
}

type Step<T> = Result<T, String>;

impl<'a> Machine<'a> {
    fn take(&mut self, n: usize) -> Step<&'a [u8]> {
        let end = self.at.checked_add(n).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or_else(|| format!("cut off: {n} more bytes expected"))?;
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    /// Unsigned, little-endian.
    fn number(&mut self, width: usize) -> Step<usize> {
        let bytes = self.take(width)?;
        let value = bytes.iter().rev().fold(0u64, |v, b| v << 8 | u64::from(*b));
        usize::try_from(value).map_err(|_| format!("{value} is too large"))
    }

    fn line(&mut self) -> Step<String> {
        let rest = &self.bytes[self.at..];
        let Some(length) = rest.iter().position(|b| *b == b'\n') else {
            return Err("cut off inside a name".to_owned());
        };
        self.at += length + 1;
        let line = rest[..length].strip_suffix(b"\r").unwrap_or(&rest[..length]);
        Ok(String::from_utf8_lossy(line).into_owned())
    }

    fn push(&mut self, value: Value) -> Step<()> {
        if self.values.len() >= MAX_VALUES {
            return Err(format!("more than {MAX_VALUES} values"));
        }
        self.stack.push(self.values.len() as Ref);
        self.values.push(value);
        Ok(())
    }

    fn pop(&mut self) -> Step<Ref> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.pop() {
            Some(value) if self.stack.len() >= floor => Ok(value),
            _ => Err("nothing left to take".to_owned()),
        }
    }

    fn top(&self) -> Step<Ref> {
        self.stack.last().copied().ok_or_else(|| "nothing there".to_owned())
    }

    fn pop_to_mark(&mut self) -> Step<Vec<Ref>> {
        let mark = self.marks.pop().ok_or("no mark")?;
        if mark > self.stack.len() {
            return Err("the mark is gone".to_owned());
        }
        Ok(self.stack.split_off(mark))
    }

    fn tuple(&mut self, n: usize) -> Step<()> {
        let mut items = Vec::with_capacity(n);
        for _ in 0..n {
            items.push(self.pop()?);
        }
        items.reverse();
        self.push(Value::Tuple(items))
    }

    fn text(&mut self, width: usize) -> Step<()> {
        let length = self.number(width)?;
        let text = std::str::from_utf8(self.take(length)?).map_err(|e| e.to_string())?;
        self.push(Value::Text(text.to_owned()))
    }

    fn opaque(&mut self, width: usize) -> Step<()> {
        let length = self.number(width)?;
        self.take(length)?;
        self.push(Value::Opaque)
    }

    fn long(&mut self, width: usize) -> Step<()> {
        let length = self.number(width)?;
        let bytes = self.take(length)?;
        if length > 8 {
            return self.push(Value::Opaque);
        }
        // Two's complement of any length.
        let negative = bytes.last().is_some_and(|b| *b >= 0x80);
        let mut full = [if negative { 0xff } else { 0 }; 8];
        full[..length].copy_from_slice(bytes);
        self.push(Value::Int(i64::from_le_bytes(full)))
    }

    fn remember(&mut self, slot: usize) -> Step<()> {
        let top = self.top()?;
        let slot = u32::try_from(slot).map_err(|e| e.to_string())?;
        self.memo.insert(slot, top);
        Ok(())
    }

    fn recall(&mut self, slot: usize) -> Step<()> {
        let found = u32::try_from(slot).ok().and_then(|s| self.memo.get(&s).copied());
        self.stack.push(found.ok_or_else(|| format!("nothing was remembered as {slot}"))?);
        Ok(())
    }

    fn extend_list(&mut self, items: Vec<Ref>) -> Step<()> {
        let top = self.top()? as usize;
        // Other classes with an `append` are of no interest.
        if let Value::List(list) = &mut self.values[top] {
            list.extend(items);
        }
        Ok(())
    }

    fn extend_dict(&mut self, items: &[Ref]) -> Step<()> {
        if !items.len().is_multiple_of(2) {
            return Err("a key without value".to_owned());
        }
        let pairs = items.chunks_exact(2).map(|p| (p[0], p[1]));
        let top = self.top()? as usize;
        match &mut self.values[top] {
            Value::Dict(dict) => dict.extend(pairs),
            // Subclasses of dict are made by a call and filled like one.
            call @ Value::Call { .. } => *call = Value::Dict(pairs.collect()),
            _ => return Err("entries for something that is no dictionary".to_owned()),
        }
        Ok(())
    }

    fn call(&mut self, args: Ref) -> Step<()> {
        let function = self.pop()?;
        let dict = match &self.values[function as usize] {
            Value::Global(name) if name == "collections.OrderedDict" => Some(self.pairs(args)),
            Value::Global(name) if name == "collections.defaultdict" => Some(Vec::new()),
            _ => None,
        };
        self.push(dict.map_or(Value::Call { function, args }, Value::Dict))
    }

    /// The entries that Python 2 gives to an ordered dictionary: a list of pairs.
    fn pairs(&self, args: Ref) -> Vec<(Ref, Ref)> {
        let Value::Tuple(args) = &self.values[args as usize] else { return Vec::new() };
        let Some(Value::List(items)) = args.first().map(|a| &self.values[*a as usize]) else {
            return Vec::new();
        };
        let pair = |item: &Ref| match &self.values[*item as usize] {
            Value::Tuple(p) | Value::List(p) if p.len() == 2 => Some((p[0], p[1])),
            _ => None,
        };
        items.iter().filter_map(pair).collect()
    }

    /// Gives the value on top when the program stops.
    fn run(&mut self) -> Step<Ref> {
        loop {
            match self.take(1)?[0] {
                b'.' => return self.pop(),
                code => self.step(code)?,
            }
        }
    }

    /// An operation on the stack, the memory or a plain value.
    fn step(&mut self, code: u8) -> Step<()> {
        match code {
            0x80 => self.take(1).map(drop),
            0x95 => self.take(8).map(drop),
            // `b` is the state of an object; of a dictionary, its attributes beside the entries.
            b'0' | b'b' => self.pop().map(drop),
            b'1' | 0x90 => self.pop_to_mark().map(drop),
            b'(' => {
                self.marks.push(self.stack.len());
                Ok(())
            }
            b'2' => {
                self.stack.push(self.top()?);
                Ok(())
            }
            b'N' => self.push(Value::None),
            0x88 | 0x89 => self.push(Value::Bool(code == 0x88)),
            b'J' => {
                let value = self.number(4)? as u32 as i32;
                self.push(Value::Int(i64::from(value)))
            }
            b'K' | b'M' => {
                let value = self.number(if code == b'K' { 1 } else { 2 })?;
                self.push(Value::Int(value as i64))
            }
            0x8a => self.long(1),
            0x8b => self.long(4),
            b'G' => {
                let mut bytes = [0; 8];
                bytes.copy_from_slice(self.take(8)?);
                self.push(Value::Float(f64::from_be_bytes(bytes)))
            }
            0x8c | b'U' => self.text(1),
            b'X' | b'T' => self.text(4),
            0x8d => self.text(8),
            b'C' => self.opaque(1),
            b'B' => self.opaque(4),
            0x8e | 0x96 => self.opaque(8),
            b'q' => self.number(1).and_then(|slot| self.remember(slot)),
            b'r' => self.number(4).and_then(|slot| self.remember(slot)),
            0x94 => self.remember(self.memo.len()),
            b'h' => self.number(1).and_then(|slot| self.recall(slot)),
            b'j' => self.number(4).and_then(|slot| self.recall(slot)),
            _ => self.composite(code),
        }
    }

    /// An operation that makes or fills a list, a dictionary or an object.
    fn composite(&mut self, code: u8) -> Step<()> {
        match code {
            b')' => self.tuple(0),
            0x85 => self.tuple(1),
            0x86 => self.tuple(2),
            0x87 => self.tuple(3),
            b't' => self.pop_to_mark().and_then(|items| self.push(Value::Tuple(items))),
            b']' => self.push(Value::List(Vec::new())),
            b'l' => self.pop_to_mark().and_then(|items| self.push(Value::List(items))),
            b'a' => self.pop().and_then(|item| self.extend_list(vec![item])),
            b'e' => self.pop_to_mark().and_then(|items| self.extend_list(items)),
            b'}' => self.push(Value::Dict(Vec::new())),
            b'd' => {
                let items = self.pop_to_mark()?;
                self.push(Value::Dict(Vec::new()))?;
                self.extend_dict(&items)
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.extend_dict(&[key, value])
            }
            b'u' => self.pop_to_mark().and_then(|items| self.extend_dict(&items)),
            0x8f => self.push(Value::Opaque),
            0x91 => self.pop_to_mark().and_then(|_| self.push(Value::Opaque)),
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                self.push(Value::Global(format!("{module}.{name}")))
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                let full = match (&self.values[module as usize], &self.values[name as usize]) {
                    (Value::Text(module), Value::Text(name)) => format!("{module}.{name}"),
                    _ => return Err("a class whose name is no text".to_owned()),
                };
                self.push(Value::Global(full))
            }
            b'R' | 0x81 => self.pop().and_then(|args| self.call(args)),
            0x92 => {
                let (_keywords, args) = (self.pop()?, self.pop()?);
                self.call(args)
            }
            b'Q' => self.pop().and_then(|id| self.push(Value::External(id))),
            other => Err(format!("operation {other:#04x} is not known")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_values_stay_shared() {
        // {'a': d, 'b': d} with d = {'x': 1} filled after it was remembered.
        let pickle = b"\x80\x02}(X\x01\0\0\0a}q\x01X\x01\0\0\0xK\x01sX\x01\0\0\0bh\x01u.";
        let pickle = Pickle::parse(pickle).unwrap();
        let Value::Dict(top) = pickle.root() else { panic!("{:?}", pickle.root()) };
        assert_eq!(top.iter().map(|(k, _)| pickle.key(*k)).collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(top[0].1, top[1].1);
        assert!(matches!(pickle.get(top[1].1), Value::Dict(d) if d.len() == 1));
    }

    #[test]
    fn doubling_forty_times_needs_no_memory() {
        let mut program = b"\x80\x02)".to_vec();
        for _ in 0..40 {
            program.extend(b"q\0h\0\x86");
        }
        program.push(b'.');
        assert!(Pickle::parse(&program).unwrap().values.len() < 50);
    }

    #[test]
    fn nesting_is_no_recursion() {
        let mut program = b"\x80\x02)".to_vec();
        program.extend(std::iter::repeat_n(0x85, 1_000_000));
        program.push(b'.');
        drop(Pickle::parse(&program).unwrap());
    }

    #[test]
    fn integers() {
        let int = |bytes: &[u8]| match Pickle::parse(bytes).unwrap().root() {
            Value::Int(v) => *v,
            other => panic!("{other:?}"),
        };
        assert_eq!(int(b"K\xff."), 255);
        assert_eq!(int(b"M\x01\x02."), 513);
        assert_eq!(int(b"J\xff\xff\xff\xff."), -1);
        assert_eq!(int(b"\x8a\x00."), 0);
        assert_eq!(int(b"\x8a\x02\x00\x80."), -32768);
        assert_eq!(int(b"\x8a\x05\x00\x00\x00\x00\x01."), 1 << 32);
    }

    #[test]
    fn dictionaries_of_other_classes() {
        let entries = |bytes: &[u8]| match Pickle::parse(bytes) {
            Ok(p) => match p.root() {
                Value::Dict(d) => d.iter().map(|(k, _)| p.key(*k)).collect::<Vec<_>>(),
                other => panic!("{other:?}"),
            },
            Err(e) => panic!("{e}"),
        };
        // Filled after the call, with attributes beside the entries.
        assert_eq!(entries(b"ccollections\nCounter\n)RX\x01\0\0\0aK\x01s}b."), ["a"]);
        assert_eq!(entries(b"ccollections\ndefaultdict\nN\x85RX\x01\0\0\0aK\x01s."), ["a"]);
        // Python 2 hands the entries to the call.
        let pairs = b"ccollections\nOrderedDict\n]](X\x01\0\0\0aK\x01ea\x85R.";
        assert_eq!(entries(pairs), ["a"]);
    }

    #[test]
    fn damage_is_an_error() {
        for bad in [
            &b""[..],
            b".",
            b"(.",
            b"K",
            b"X\xff\xff\xff\xffab.",
            b"\x8d\xff\xff\xff\xff\xff\xff\xff\xff.",
            b"h\x07.",
            b"(K\x01u.",
            b"}(K\x01u.",
            b"K\x01(0(t.",
            b"K\x01K\x02s.",
            b"cos\nsystem",
            b"t.",
            b"q\x01.",
            b"\xff.",
        ] {
            assert!(Pickle::parse(bad).is_err(), "{bad:02x?}");
        }
    }
}
