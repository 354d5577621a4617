//! The emulation notices what it is there for.

use crate::emulator::{Emulator, is_there};
use scenesplat_device::Launcher;
use scenesplat_device::ops::rows;

/// A row that is out of range is named with the length of the array.
#[test]
fn reads_beside_an_array_are_told() {
    if !is_there() {
        return;
    }
    let l = Emulator::new(0);
    let x = l.upload_values(&[1.0f32, 2.0, 3.0]).unwrap();
    let order = l.upload_values(&[0u32, 3, 1]).unwrap();
    let mut out = l.alloc_values::<f32>(3).unwrap();
    let error = rows::gather_rows(&l, &x, rows::Width::Four, 1, &order, 3, &mut out).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("gather_rows_4") && text.contains("element 3 of an array of 3"),
        "{text}"
    );
    // The machine is as good as new afterwards.
    let order = l.upload_values(&[2u32, 0, 1]).unwrap();
    rows::gather_rows(&l, &x, rows::Width::Four, 1, &order, 3, &mut out).unwrap();
    assert_eq!(l.download_values::<f32>(&out, 3).unwrap(), [3.0, 1.0, 2.0]);
}
