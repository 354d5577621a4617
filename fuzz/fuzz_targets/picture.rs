#![no_main]
//! PNG and JPEG: maps of segments, pictures to compare.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::path;
use scenesplat_scene::picture::decode_picture;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(picture) = decode_picture(bytes, path()) {
        let pixels = picture.width() as usize * picture.height() as usize;
        assert_eq!(picture.to_rgb8().pixels().len(), pixels);
    }
});
