//! Compares the nearest neighbors of `scenesplat-kernels` with those of kiddo: `cargo test` the distances, `cargo bench`
//! the time. Kiddo is not used otherwise, because it does not order equal distances by row.
