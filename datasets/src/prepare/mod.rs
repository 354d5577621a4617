//! From a benchmark's own files to the folder of `.npy` that training reads.
//!
//! ```text
//! scan (mesh, annotations) ─ read_scan ─► ScanPoints: raw names, instances ─ LabelTable ─► class numbers
//!                                             │ nearest point of each Gaussian, up to a distance
//! scene (Gaussians) ─ prune to the scan's box ─► prepare ─► segment*, instance, normal, pc_*
//! ```
//!
//! A layout is read as the benchmark's own documentation describes it ([`ScanLayout`]); what names mean is a
//! [`LabelTable`], apart from that. [`transfer_to_chunks`] brings labeled points to chunks that were cut before.
//! [`frames`] reads the pictures that scans were made of.

mod bounding_box;
mod chunk_points;
pub mod frames;
mod label_table;
mod readers;
mod scan;
mod transfer;

pub use bounding_box::UprightBox;
pub use chunk_points::{ChunkTransfer, ChunkTransferReport, transfer_to_chunks};
pub use label_table::{LabelTable, LabelTables};
pub use readers::{ScanLayout, read_scan};
pub use scan::{ScanPoints, vertex_normals};
pub use transfer::{PrepareReport, PrepareSettings, PreparedScene, SegmentColumn, prepare};
