//! How many Gaussians a file claims, read by other means than the readers.

use std::io::Read;

/// The number that the file's own header states.
pub fn claimed(kind: &str, bytes: &[u8]) -> Option<usize> {
    match kind {
        "ply" | "compressed-ply" => {
            let text = String::from_utf8_lossy(bytes);
            let header = text.split("end_header").next()?;
            let line = header.lines().find(|l| {
                let mut words = l.split_whitespace();
                words.next() == Some("element") && words.next() == Some("vertex")
            })?;
            line.split_whitespace().nth(2)?.parse().ok()
        }
        "splat" => Some(bytes.len() / 32),
        "spz" => in_spz(bytes),
        "ksplat" => Some(u32_at(bytes, 16)? as usize),
        "sog" => {
            let mut zip = zip::ZipArchive::new(std::io::Cursor::new(bytes)).ok()?;
            let names = zip.file_names().filter_map(|n| n.ok().map(|n| n.into_owned()));
            let name = names.collect::<Vec<_>>().into_iter().find(|n| n.ends_with("meta.json"))?;
            let mut text = String::new();
            zip.by_name(&name).ok()?.read_to_string(&mut text).ok()?;
            let meta: serde_json::Value = serde_json::from_str(&text).ok()?;
            let v2 = meta["count"].as_u64();
            Some(v2.or_else(|| meta["means"]["shape"][0].as_u64())? as usize)
        }
        "gltf" => in_gltf(bytes),
        other => panic!("no format is called {other}"),
    }
}

fn in_spz(bytes: &[u8]) -> Option<usize> {
    let legacy = |body: &mut dyn Read| {
        let mut head = [0; 16];
        body.read_exact(&mut head).ok()?;
        Some(u32_at(&head, 8)? as usize)
    };
    match bytes.get(..4)? {
        [0x1f, 0x8b, ..] => legacy(&mut flate2::read::GzDecoder::new(bytes)),
        [0x28, 0xb5, 0x2f, 0xfd] => legacy(&mut zstd::stream::read::Decoder::new(bytes).ok()?),
        _ => Some(u32_at(bytes, 8)? as usize),
    }
}

fn in_gltf(bytes: &[u8]) -> Option<usize> {
    let json = match bytes {
        [b'g', b'l', b'T', b'F', ..] => {
            let length = u32_at(bytes, 12)? as usize;
            bytes.get(20..20 + length)?
        }
        _ => bytes,
    };
    // Strings that no count is in may hold anything.
    let json = String::from_utf8_lossy(json);
    let json: serde_json::Value = serde_json::from_str(&json).ok()?;
    // The fixtures have one mesh, used once.
    let primitives = json["meshes"][0]["primitives"].as_array()?;
    primitives
        .iter()
        .map(|p| {
            if let Some(view) = spz_view(p) {
                return spz_rows(bytes, &json["bufferViews"][view]);
            }
            let accessor = p["attributes"]["POSITION"].as_u64()? as usize;
            Some(json["accessors"][accessor]["count"].as_u64()? as usize)
        })
        .sum()
}

/// The buffer view of a primitive that is an SPZ file.
fn spz_view(primitive: &serde_json::Value) -> Option<usize> {
    let about = primitive["extensions"]["KHR_gaussian_splatting"]["extensions"].as_object()?;
    let prefix = "KHR_gaussian_splatting_compression_spz";
    let (_, about) = about.iter().find(|(name, _)| name.starts_with(prefix))?;
    Some(about["bufferView"].as_u64()? as usize)
}

/// The number in the header of an SPZ file of version 4 within a glb.
fn spz_rows(glb: &[u8], view: &serde_json::Value) -> Option<usize> {
    let start = 20 + u32_at(glb, 12)? as usize + 8;
    let offset = view["byteOffset"].as_u64().unwrap_or(0) as usize;
    in_spz(glb.get(start + offset..)?)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}
