//! The file itself: fixed markup, and blocks of base64 text.

use crate::page_kit::{Block, Document, Rights, escaped};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use std::io::Write;

/// The bundle, gzipped; made by `npm run build` in the folder `page`.
const PROGRAM: &[u8] = include_bytes!("../../page/dist/program.js.gz");
const STYLE: &str = include_str!("../../page/src/page.css");
const BODY: &str = include_str!("../../page/src/body.html");
const LOADER: &str = include_str!("../../page/src/loader.js");

/// A block that is compressed already.
pub(super) struct Carried<'a> {
    pub(super) name: &'static str,
    pub(super) bytes: &'a [u8],
}

/// The page with some blocks in it, and the bytes of these as text.
pub(super) fn assemble(
    title: &str,
    parts: &[(&'static str, Vec<u8>)],
    rights: Rights,
) -> (String, Vec<(String, usize)>) {
    assemble_with(title, parts, &[], rights)
}

/// As [`assemble`], with blocks that are compressed already.
pub(super) fn assemble_with(
    title: &str,
    parts: &[(&'static str, Vec<u8>)],
    carried: &[Carried<'_>],
    rights: Rights,
) -> (String, Vec<(String, usize)>) {
    let mut blocks: Vec<Block> = parts
        .par_iter()
        .map(|(name, bytes)| Block::bytes(format!("block-{name}"), &deflated(bytes)))
        .collect();
    let program = Carried { name: "program", bytes: PROGRAM };
    let carried = || carried.iter().chain([&program]);
    blocks.extend(carried().map(|c| Block::bytes(format!("block-{}", c.name), c.bytes)));
    // Its only preformatted text.
    let body = BODY.replacen("</pre>", &format!("{}</pre>", escaped(super::LICENSES)), 1);
    let document = Document {
        title,
        class: "dark",
        style: STYLE,
        body: &body,
        blocks: &blocks,
        script: LOADER,
        rights,
    };
    let names = parts.iter().map(|(name, _)| *name).chain(carried().map(|c| c.name));
    let sizes = names.zip(&blocks).map(|(name, block)| (name.to_owned(), block.len())).collect();
    (document.html(), sizes)
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(bytes.len() / 2), Compression::new(6));
    encoder.write_all(bytes).expect("a vector takes all");
    encoder.finish().expect("a vector takes all")
}

#[cfg(test)]
mod tests {
    use super::*;
    use sha2::{Digest, Sha256};

    #[test]
    fn nothing_of_a_file_is_markup() {
        let hostile = "</title><script>alert(1)</script>\"'&";
        let parts = [("about", hostile.as_bytes().to_vec())];
        for rights in [Rights::Viewer, Rights::ServedViewer] {
            let (page, blocks) = assemble(hostile, &parts, rights);
            assert!(!page.contains("alert(1)</script>"));
            assert!(page.contains("&lt;/title&gt;&lt;script&gt;alert(1)"));
            let names: Vec<&str> = blocks.iter().map(|(n, _)| n.as_str()).collect();
            assert_eq!(names, ["about", "program"]);
            // The page ends scripts where it says so, and nowhere else.
            assert_eq!(page.matches("</script").count(), blocks.len() + 1);
            assert_eq!(page.matches("<script").count(), blocks.len() + 1);
            let served = rights == Rights::ServedViewer;
            assert_eq!(page.contains("connect-src 'self'"), served);
        }
    }

    #[test]
    fn the_program_is_the_one_that_its_hash_names() {
        use std::io::Read;
        let mut program = Vec::new();
        flate2::read::GzDecoder::new(PROGRAM).read_to_end(&mut program).unwrap();
        let hex: String = Sha256::digest(&program).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(hex, include_str!("../../page/dist/program.sha256").trim());
        for license in ["Copyright © 2010-", "three", "@sparkjsdev/spark", "MIT"] {
            assert!(super::super::LICENSES.contains(license), "{license}");
        }
    }
}
