//! How much two pictures differ, how sharp one is, and which frames of a capture to keep.
//!
//! Everything works on [`ImageView`]s: f32 values, row by row, channels inside (`[H, W, C]`, as
//! renderers give them), nominally 0 to 1. Sums are f64. A number depends on neither the number of
//! threads nor the size of the blocks that threads take.
//!
//! # Numbers that need a convention
//! - **PSNR** is of one image; over a set it is the mean of the images' PSNRs, not the PSNR of the
//!   mean error. Identical images have an infinite one.
//! - **SSIM** depends on how the window treats the border; see [`SsimPadding`]. The difference
//!   reaches 0.04 on noisy images, so every caller names it.
//! - **Sharpness** depends on the size of the picture; see [`sharpness`].
//!
//! ```
//! use scenesplat_metrics::image::{ImageView, SsimPadding, psnr, ssim};
//!
//! let (black, gray) = ([0.0; 16 * 16], [0.1; 16 * 16]);
//! let black = ImageView::new(&black, 16, 16, 1)?;
//! let gray = ImageView::new(&gray, 16, 16, 1)?;
//! assert!((psnr(gray, black)? - 20.0).abs() < 1e-5);
//! assert_eq!(psnr(gray, gray)?, f64::INFINITY);
//! assert!((ssim(gray, gray, SsimPadding::Valid)? - 1.0).abs() < 1e-12);
//! # Ok::<(), scenesplat_metrics::image::ImageError>(())
//! ```

mod blur;
pub mod depth;
mod difference;
mod error;
pub mod frame_filter;
pub mod sharpness;
mod ssim;
mod view;

pub use difference::{l1, l1_with_gradient, mean_squared_error, psnr};
pub use error::ImageError;
pub use ssim::{SsimPadding, ssim, ssim_map, ssim_with_gradient};
pub use view::ImageView;
