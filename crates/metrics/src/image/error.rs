//! Why a number about pictures cannot be given.

/// Errors of the image metrics.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The number of values is not width × height × channels.
    #[error("{what}: {width} × {height} × {channels} are not {len} values")]
    Shape {
        /// Which array.
        what: &'static str,
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// Values per pixel.
        channels: usize,
        /// Values found.
        len: usize,
    },
    /// A picture without a pixel or a channel has no metric.
    #[error("{what}: {width} × {height} pixels of {channels} channels hold nothing to measure")]
    Empty {
        /// Which array.
        what: &'static str,
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// Values per pixel.
        channels: usize,
    },
    /// Two pictures that are compared differ in size.
    #[error("sizes differ: {pred:?} against {truth:?} (width, height, channels)")]
    SizesDiffer {
        /// Width, height, channels of the first.
        pred: [usize; 3],
        /// Width, height, channels of the second.
        truth: [usize; 3],
    },
    /// A value is NaN or infinite.
    #[error(
        "{what}: pixel ({x}, {y}) channel {channel} is {value}; only finite values can be compared"
    )]
    NonFinite {
        /// Which array.
        what: &'static str,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// Channel.
        channel: usize,
        /// Value found.
        value: f32,
    },
    /// The picture is too small for the window of SSIM with this treatment of the border.
    #[error(
        "SSIM with {padding} padding needs at least {least} × {least} pixels, got {width} × {height}"
    )]
    TooSmall {
        /// The padding asked for.
        padding: super::SsimPadding,
        /// Smallest side.
        least: usize,
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
    },
    /// A setting or an input number lies outside its range.
    #[error("{field} is {value}, expected {expected}")]
    Setting {
        /// Name of the setting.
        field: &'static str,
        /// Value found.
        value: f64,
        /// What would be valid.
        expected: &'static str,
    },
    /// A number of a list lies outside its range.
    #[error("{what}[{row}] is {value}, expected {expected}")]
    Row {
        /// Which list.
        what: &'static str,
        /// First offending row.
        row: usize,
        /// Value found.
        value: f64,
        /// What would be valid.
        expected: &'static str,
    },
    /// Lists that belong together differ in length.
    #[error("{what}: expected {expected} rows, got {got}")]
    RowCount {
        /// Which list.
        what: &'static str,
        /// Rows expected.
        expected: usize,
        /// Rows found.
        got: usize,
    },
}
