//! Sums whose order does not depend on who adds what.

/// A sum by pairs, pairs of pairs and so on, as values come: of a power of two of values in a row, beginning at a
/// multiple of it, the sum is a part of the whole one. So who has such a part can be another process.
#[derive(Debug)]
pub struct InPairs<T> {
    /// Sums of `2^level` values, the largest first.
    parts: Vec<(u32, T)>,
}

impl<T> InPairs<T> {
    /// Without a value.
    pub fn new() -> Self {
        Self { parts: Vec::new() }
    }

    /// Takes the next value; `add` makes `a + b`.
    ///
    /// # Errors
    /// That of `add`.
    pub fn push<E>(&mut self, value: T, add: impl Fn(T, T) -> Result<T, E>) -> Result<(), E> {
        let (mut level, mut value) = (0, value);
        while let Some((_, before)) = self.parts.pop_if(|(l, _)| *l == level) {
            value = add(before, value)?;
            level += 1;
        }
        self.parts.push((level, value));
        Ok(())
    }

    /// The sum; `None` without a value.
    ///
    /// # Errors
    /// That of `add`.
    pub fn finish<E>(mut self, add: impl Fn(T, T) -> Result<T, E>) -> Result<Option<T>, E> {
        let Some((_, mut sum)) = self.parts.pop() else { return Ok(None) };
        while let Some((_, before)) = self.parts.pop() {
            sum = add(before, sum)?;
        }
        Ok(Some(sum))
    }
}

/// The sum of rows of the same length, in pairs; empty without a row.
pub fn add_in_pairs(rows: Vec<Vec<f32>>) -> Vec<f32> {
    let add = |mut a: Vec<f32>, b: Vec<f32>| {
        a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
        Ok::<_, std::convert::Infallible>(a)
    };
    let mut sum = InPairs::new();
    for row in rows {
        let Ok(()) = sum.push(row, add);
    }
    let Ok(sum) = sum.finish(add);
    sum.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[allow(clippy::needless_pass_by_value, reason = "as `InPairs` takes it")]
    fn add(a: String, b: String) -> Result<String, ()> {
        Ok(format!("({a}{b})"))
    }

    fn sum(values: impl IntoIterator<Item = String>) -> String {
        let mut sum = InPairs::new();
        values.into_iter().for_each(|value| sum.push(value, add).unwrap());
        sum.finish(add).unwrap().unwrap_or_default()
    }

    #[test]
    fn the_order_is_that_of_pairs() {
        let of = |n: u8| sum((0..n).map(|i| char::from(b'a' + i).to_string()));
        let expected =
            ["", "a", "(ab)", "((ab)c)", "((ab)(cd))", "(((ab)(cd))e)", "(((ab)(cd))(ef))"];
        for (n, expected) in expected.into_iter().enumerate() {
            assert_eq!(of(n as u8), expected);
        }
        assert_eq!(of(7), "(((ab)(cd))((ef)g))");
    }

    #[test]
    fn parts_of_a_power_of_two_are_parts_of_the_whole() {
        for (all, part) in [(8, 1), (8, 2), (8, 4), (8, 8), (6, 2), (12, 4), (3, 1)] {
            let name = |i: usize| char::from(b'a' + i as u8).to_string();
            let parts = (0..all / part).map(|p| sum((p * part..(p + 1) * part).map(name)));
            assert_eq!(sum(parts), sum((0..all).map(name)), "{all} in parts of {part}");
        }
    }
}
