//! Pictures in another size.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

mod resize;
