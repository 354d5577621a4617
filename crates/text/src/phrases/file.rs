//! The table as a file: `.safetensors` with the rows, beside a list of the phrases.

use super::spelling::KnownWords;
use super::{KEPT, PhraseTable};
use crate::PhraseError;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use sha2::{Digest, Sha256};

const PHRASES_SHA256: &str = "phrases_sha256";
/// What the licenses of its sources ask every copy to carry.
const NOTICE: &str = include_str!("../../assets/NOTICE");

fn sha256(phrases: &[String]) -> [u8; 32] {
    let mut hash = Sha256::new();
    for phrase in phrases {
        hash.update(phrase.as_bytes());
        hash.update(b"\n");
    }
    hash.finalize().into()
}

impl PhraseTable {
    pub(super) fn of(
        phrases: Vec<String>,
        rows: Vec<i8>,
        scales: Vec<f32>,
        mean: Vec<f32>,
        basis: Vec<f32>,
    ) -> Self {
        let words = KnownWords::of(&phrases);
        Self { phrases, rows, scales, mean, basis, words }
    }

    /// A table from its phrases, sorted, and the vectors that [`to_bytes`](Self::to_bytes) gave.
    ///
    /// # Errors
    /// If it is no such file, or one of other phrases (by their SHA-256).
    pub fn from_bytes(phrases: Vec<String>, bytes: &[u8]) -> Result<Self, PhraseError> {
        let bad = |problem: String| PhraseError::Table { problem };
        let broken = |error| bad(format!("is no whole .safetensors file: {error}"));
        let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
        let stated = tensors.tensor(PHRASES_SHA256).ok();
        if stated.is_none_or(|stated| stated.data() != sha256(&phrases)) {
            return Err(bad(format!(
                "was not made of these {} phrases: build it again",
                phrases.len()
            )));
        }
        if !phrases.is_sorted() {
            return Err(bad("has phrases that are not sorted".to_owned()));
        }
        let take = |name: &str, dtype: Dtype, shape: [usize; 2]| {
            let tensor = tensors.tensor(name).map_err(|_| bad(format!("has no tensor {name}")))?;
            let fits = |(have, asked): (&usize, &usize)| have == asked || *asked == 0;
            let shapes = tensor.shape().len() == 2 && tensor.shape().iter().zip(&shape).all(fits);
            if tensor.dtype() != dtype || !shapes {
                let (found, have) = (tensor.dtype(), tensor.shape());
                return Err(bad(format!(
                    "has {name} as {found:?} {have:?}, {dtype:?} {shape:?} is right"
                )));
            }
            Ok(tensor)
        };
        let count = phrases.len();
        let rows = take("rows", Dtype::I8, [count, KEPT])?;
        let scales = floats(&take("scales", Dtype::F32, [count, 1])?);
        let mean = floats(&take("mean", Dtype::F32, [1, 0])?);
        let basis = floats(&take("basis", Dtype::F32, [KEPT, mean.len()])?);
        if mean.is_empty() || scales.iter().chain(&mean).chain(&basis).any(|v| !v.is_finite()) {
            return Err(bad("holds values that are not finite".to_owned()));
        }
        let rows = rows.data().iter().map(|byte| byte.cast_signed()).collect();
        Ok(Self::of(phrases, rows, scales, mean, basis))
    }

    /// Its vectors, the hash of its phrases and the notices of its sources, as a `.safetensors` file.
    ///
    /// # Errors
    /// If the table does not fit into such a file.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PhraseError> {
        let le = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let rows: Vec<u8> = self.rows.iter().map(|v| v.cast_unsigned()).collect();
        let (scales, mean, basis) = (le(&self.scales), le(&self.mean), le(&self.basis));
        let (count, width, hash) = (self.len(), self.mean.len(), sha256(&self.phrases));
        let bad =
            |error: safetensors::SafeTensorError| PhraseError::Table { problem: error.to_string() };
        let views = [
            ("rows", TensorView::new(Dtype::I8, vec![count, KEPT], &rows)),
            ("scales", TensorView::new(Dtype::F32, vec![count, 1], &scales)),
            ("mean", TensorView::new(Dtype::F32, vec![1, width], &mean)),
            ("basis", TensorView::new(Dtype::F32, vec![KEPT, width], &basis)),
            (PHRASES_SHA256, TensorView::new(Dtype::U8, vec![1, hash.len()], &hash)),
        ];
        let views = views.into_iter().map(|(name, view)| view.map(|v| (name, v)));
        let views = views.collect::<Result<Vec<_>, _>>().map_err(bad)?;
        // One entry: several would be written in the order of a map with random hashes.
        let metadata = [("notice".to_owned(), NOTICE.to_owned())].into();
        safetensors::serialize(views, Some(metadata)).map_err(bad)
    }
}

fn floats(tensor: &TensorView<'_>) -> Vec<f32> {
    tensor.data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}
