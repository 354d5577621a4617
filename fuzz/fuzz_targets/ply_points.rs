#![no_main]
//! Labelled point clouds and single columns of a PLY file.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::path;
use scenesplat_scene::formats::ply::PlyFile;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(file) = PlyFile::from_bytes(bytes, path()) {
        for element in file.elements() {
            for property in &element.properties {
                if let Ok(column) = file.column_f64(&element.name, &property.name) {
                    assert_eq!(column.len(), element.count);
                }
            }
        }
    }
});
