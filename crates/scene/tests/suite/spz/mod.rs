//! SPZ files: those of other programs, records, what is written, and damaged ones.

mod hostile;
mod reading;
mod records;
mod writing;
