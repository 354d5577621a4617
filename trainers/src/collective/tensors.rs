//! Sums over the ranks of tensors that stay where they are.

use super::CollectiveError;
use super::pairs::InPairs;
use candle_core::Tensor;

/// What moves rows of values between the devices of the ranks.
pub(crate) trait Exchange {
    /// How many ranks there are.
    fn size(&self) -> usize;

    /// Row `r` of `rows` (`[size, len]`) goes to rank `r`; row `r` of the result came from rank `r`.
    fn all_to_all(&self, rows: &Tensor) -> Result<Tensor, CollectiveError>;

    /// The rows (`[len]`) of all ranks, in their order. `[size, len]`
    fn all_gather(&self, row: &Tensor) -> Result<Tensor, CollectiveError>;
}

#[allow(clippy::needless_pass_by_value, reason = "as `map_err` gives it")]
fn failed(error: candle_core::Error) -> CollectiveError {
    CollectiveError::Device { problem: error.to_string() }
}

/// The sum over the ranks of as many values (`[len]`, f32) on each, with the bits of
/// [`Collective::all_reduce`](super::Collective::all_reduce): each rank adds a part of them, in pairs.
pub(crate) fn sum_over_ranks(
    exchange: &impl Exchange,
    values: &Tensor,
) -> Result<Tensor, CollectiveError> {
    let (ranks, len) = (exchange.size(), values.elem_count());
    if ranks == 1 || len == 0 {
        return Ok(values.clone());
    }
    // All parts are of one length, so the last ones are filled up.
    let part = len.div_ceil(ranks);
    let filled = || {
        let rest = Tensor::zeros(part * ranks - len, values.dtype(), values.device())?;
        Tensor::cat(&[values, &rest], 0)?.reshape((ranks, part))
    };
    let mine = exchange.all_to_all(&filled().map_err(failed)?)?;
    let sum = || {
        let add = |a: Tensor, b: Tensor| &a + &b;
        let mut sum = InPairs::new();
        for rank in 0..ranks {
            sum.push(mine.get(rank)?, add)?;
        }
        let sum = sum.finish(add)?;
        sum.map_or_else(|| mine.get(0), |sum| sum.contiguous())
    };
    let all = exchange.all_gather(&sum().map_err(failed)?)?;
    all.flatten_all().and_then(|all| all.narrow(0, 0, len)).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::super::{Collective, ThreadRank};
    use super::*;
    use candle_core::Device;

    /// Rows that go through the memory of the host, as those of no device do.
    struct ThroughHost(ThreadRank);

    impl Exchange for ThroughHost {
        fn size(&self) -> usize {
            self.0.size()
        }

        fn all_to_all(&self, rows: &Tensor) -> Result<Tensor, CollectiveError> {
            let rows = rows.to_vec2::<f32>().unwrap();
            let rows: Vec<&[f32]> = rows.iter().map(Vec::as_slice).collect();
            Ok(Tensor::new(self.0.all_to_all(&rows)?, &Device::Cpu).unwrap())
        }

        fn all_gather(&self, row: &Tensor) -> Result<Tensor, CollectiveError> {
            let row = row.to_vec1::<f32>().unwrap();
            let to_all = vec![row.as_slice(); self.size()];
            Ok(Tensor::new(self.0.all_to_all(&to_all)?, &Device::Cpu).unwrap())
        }
    }

    #[test]
    fn sums_have_the_bits_of_those_of_the_host() {
        for size in [1, 2, 3, 4, 5] {
            for len in [0, 1, 2, 7, 8, 1000] {
                // Of these the order of addition can be told.
                let value = |rank: usize, i: usize| {
                    [1e8_f32, 1.0, -1e8, 0.25, 3e7][rank] * (1.0 + i as f32).sqrt()
                };
                let ranks = ThreadRank::group(size);
                std::thread::scope(|scope| {
                    for rank in ranks {
                        scope.spawn(move || {
                            let me = rank.rank();
                            let mut values: Vec<f32> = (0..len).map(|i| value(me, i)).collect();
                            let tensor = Tensor::new(values.as_slice(), &Device::Cpu).unwrap();
                            rank.all_reduce(&mut values).unwrap();
                            let sum = sum_over_ranks(&ThroughHost(rank), &tensor).unwrap();
                            assert_eq!(sum.to_vec1::<f32>().unwrap(), values, "{size} {len}");
                        });
                    }
                });
            }
        }
    }
}
