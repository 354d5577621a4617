//! PLY files, written independently of the crate.

use scenesplat_scene::GaussianScene;

/// The columns of a scene in the order of the original trainer, without normals.
pub fn inria_columns(scene: &GaussianScene) -> Vec<(String, Vec<f32>)> {
    let mut columns: Vec<(String, Vec<f32>)> = Vec::new();
    for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
        columns.push((name.into(), scene.coord.iter().map(|v| v[i]).collect()));
    }
    for i in 0..3 {
        columns.push((format!("f_dc_{i}"), scene.sh_dc.iter().map(|v| v[i]).collect()));
    }
    let k = scene.sh_rest_len();
    for channel in 0..3 {
        for c in 0..k {
            let values = scene.sh_rest.chunks_exact(3 * k).map(|row| row[c * 3 + channel]);
            columns.push((format!("f_rest_{}", channel * k + c), values.collect()));
        }
    }
    columns.push(("opacity".into(), scene.opacity_logit.clone()));
    for i in 0..3 {
        columns.push((format!("scale_{i}"), scene.log_scale.iter().map(|v| v[i]).collect()));
    }
    for i in 0..4 {
        columns.push((format!("rot_{i}"), scene.quat.iter().map(|v| v[i]).collect()));
    }
    columns
}

/// How a test file is encoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Encoding {
    Ascii,
    Little,
    Big,
}

/// A PLY file of float columns.
pub fn ply_bytes(columns: &[(String, Vec<f32>)], encoding: Encoding, line_end: &str) -> Vec<u8> {
    let rows = columns.first().map_or(0, |c| c.1.len());
    let name = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Little => "binary_little_endian",
        Encoding::Big => "binary_big_endian",
    };
    let mut head =
        vec!["ply".to_owned(), format!("format {name} 1.0"), "comment made by a test".into()];
    head.push(format!("element vertex {rows}"));
    head.extend(columns.iter().map(|(name, _)| format!("property float {name}")));
    head.push("end_header".into());
    let mut out = Vec::new();
    for line in head {
        out.extend_from_slice(line.as_bytes());
        out.extend_from_slice(line_end.as_bytes());
    }
    for row in 0..rows {
        match encoding {
            Encoding::Ascii => {
                let values: Vec<String> = columns.iter().map(|(_, v)| v[row].to_string()).collect();
                out.extend_from_slice(values.join(" ").as_bytes());
                out.extend_from_slice(line_end.as_bytes());
            }
            Encoding::Little => {
                columns.iter().for_each(|(_, v)| out.extend_from_slice(&v[row].to_le_bytes()));
            }
            Encoding::Big => {
                columns.iter().for_each(|(_, v)| out.extend_from_slice(&v[row].to_be_bytes()));
            }
        }
    }
    out
}

/// Every scalar type, two elements with lists and one without properties, comments everywhere.
pub fn mixed(encoding: Encoding) -> Vec<u8> {
    let format = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Little => "binary_little_endian",
        Encoding::Big => "binary_big_endian",
    };
    let mut out = format!(
        "ply\ncomment before the format\nformat {format} 1.0\nobj_info about it\nelement face 2\n\
         property list uchar int vertex_indices\nproperty uint8 flag\ncomment  two  spaces\n\
         element vertex 3\nproperty float x\nproperty double y\nproperty int8 a\n\
         property uchar b\nproperty short c\nproperty uint16 d\nproperty int e\ncomment inside\n\
         property uint32 f\nproperty float32 z\nelement nothing 7\nelement tail 2\n\
         property list ushort float64 w\nobj_info last\nend_header\n"
    )
    .into_bytes();
    let be = encoding == Encoding::Big;
    macro_rules! put {
        ($($value:expr),*) => {{
            $(if encoding == Encoding::Ascii {
                out.extend_from_slice(format!("{} ", $value).as_bytes());
            } else if be {
                out.extend_from_slice(&$value.to_be_bytes());
            } else {
                out.extend_from_slice(&$value.to_le_bytes());
            })*
        }};
    }
    macro_rules! row {
        ($($value:expr),*) => {{
            put!($($value),*);
            if encoding == Encoding::Ascii {
                out.push(b'\n');
            }
        }};
    }
    row!(3u8, 0i32, 1i32, 2i32, 7u8);
    row!(0u8, 9u8);
    row!(0.1f32, 0.1f64, -128i8, 255u8, -32768i16, 65535u16, i32::MIN, u32::MAX, f32::MIN_POSITIVE);
    row!(f32::NAN, f64::INFINITY, 127i8, 0u8, 32767i16, 1u16, i32::MAX, 0u32, f32::NEG_INFINITY);
    row!(-0.0f32, 1e300f64, 0i8, 1u8, 2i16, 3u16, 4i32, 5u32, 1e-45f32);
    row!(1u16, 0.25f64);
    row!(2u16, 1.5f64, -2.5f64);
    out
}

/// Where the rows begin.
pub fn body_start(bytes: &[u8]) -> usize {
    bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11
}

/// The file with a part of its header replaced.
pub fn with_header(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let start = body_start(bytes);
    let head = String::from_utf8(bytes[..start].to_vec()).unwrap();
    assert!(head.contains(from), "{head}");
    [head.replace(from, to).as_bytes(), &bytes[start..]].concat()
}
