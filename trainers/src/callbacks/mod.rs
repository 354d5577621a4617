//! What watches a run: console, logs, early stopping. Each in a file of its own.

mod console;
mod csv;
mod early_stopping;
mod json_lines;
mod tensorboard;

pub use console::Console;
pub use csv::write_csv;
pub use early_stopping::EarlyStopping;
pub use json_lines::{JsonLines, LoggedValue, read_json_lines};
pub use tensorboard::TensorBoard;
