//! Frames, and extension records.

use crate::common::spz::{
    compare_within_steps, gunzip, read, read_raw, with_record, write, write_with,
};
use crate::common::{close, dot, flat, labelled, random_scene};
use scenesplat_scene::{Frame, GaussianScene, SpzFrame, WriteOptions};

fn write_raw(scene: &GaussianScene, spz_version: u8) -> Vec<u8> {
    let options = WriteOptions { spz_version, spz_frame: SpzFrame::Raw, ..WriteOptions::default() };
    write_with(scene, &options).0
}

#[test]
fn frames_are_turned_into_each_other() {
    let scene = random_scene(500, 3, 2);
    for version in 2..=4 {
        let raw = write_raw(&scene, version);
        // What is stored as it is, and read as right, up, back, is off by that frame.
        let mut turned = read(&raw).scene;
        let straight = read_raw(&raw).scene;
        turned.change_frame(Frame::CANONICAL, Frame::RUB);
        assert_eq!(turned, straight);
        // Codes of −1 and 0.992 are not each other's negative, so a clipped value may differ.
        compare_within_steps(&scene, &read(&write(&scene, version)).scene, version);
    }
}

#[test]
fn a_file_may_say_which_frame_it_is_in() {
    const KIND: u32 = 0xadbe_0003;
    let scene = random_scene(500, 3, 12);
    // 6 is RDF, 7 LUF, 12 RFU: not turned, mirrored, and turned.
    for (number, frame) in [(4u32, "RUB"), (6, "RDF"), (7, "LUF"), (12, "RFU")] {
        let mut moved = scene.clone();
        moved.change_frame(Frame::CANONICAL, frame.parse().unwrap());
        for version in [3, 4] {
            let bytes = with_record(&write_raw(&moved, version), KIND, &number.to_le_bytes());
            let loaded = read(&bytes);
            assert!(loaded.report.notes[0].contains(frame), "{}", loaded.report);
            let mut due = read_raw(&bytes).scene;
            due.change_frame(frame.parse().unwrap(), Frame::CANONICAL);
            close(flat(&loaded.scene.coord), flat(&due.coord), 0.0);
            close(flat(&loaded.scene.coord), flat(&scene.coord), 1.23e-4);
            for (a, b) in loaded.scene.quat.iter().zip(&scene.quat) {
                assert!(dot(a, b) > 0.999_996, "{frame} {a:?} {b:?}");
            }
            close(&loaded.scene.sh_rest, &due.sh_rest, 1e-6);
            let notes = read_raw(&bytes).report.notes;
            assert!(notes[0].contains(frame) && notes[0].contains("not converted"), "{notes:?}");
        }
    }
    for version in [3, 4] {
        let bytes = write(&scene, version);
        let more = with_record(&bytes, 0x4e41_0001, &[3; 24]);
        let loaded = read(&more);
        assert_eq!(loaded.scene, read(&bytes).scene);
        assert!(loaded.report.notes[0].contains("0x4e410001"), "{}", loaded.report);
    }
}

#[test]
fn only_files_with_labels_have_a_record() {
    for version in 2..=4 {
        for (scene, due) in [(labelled(50, 1), 2), (random_scene(5, 0, 1), 0)] {
            let bytes = write(&scene, version);
            let flags = if version == 4 { bytes[14] } else { gunzip(&bytes)[14] };
            assert_eq!(flags, due, "version {version}");
        }
    }
}
