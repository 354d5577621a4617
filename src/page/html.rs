//! The file itself: fixed markup, and blocks of base64 text.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::io::Write;

/// The bundle, gzipped; made by `npm run build` in the folder `page`.
const PROGRAM: &[u8] = include_bytes!("../../page/dist/program.js.gz");
const STYLE: &str = include_str!("../../page/src/page.css");
const BODY: &str = include_str!("../../page/src/body.html");
const LOADER: &str = include_str!("../../page/src/loader.js");

/// The page, and the bytes of its blocks.
pub(super) fn assemble(
    title: &str,
    parts: Vec<(&'static str, Vec<u8>)>,
) -> (String, Vec<(String, usize)>) {
    let mut blocks: Vec<(String, String)> = parts
        .into_par_iter()
        .map(|(name, bytes)| (name.to_owned(), STANDARD.encode(deflated(&bytes))))
        .collect();
    blocks.push(("program".to_owned(), STANDARD.encode(PROGRAM)));
    let size: usize = blocks.iter().map(|(_, text)| text.len() + 80).sum();
    let mut page = String::with_capacity(size + 32_768);
    page.push_str("<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    // Nothing is loaded from anywhere; what runs is what stands here.
    page.push_str(&format!(
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src {} blob: \
         'wasm-unsafe-eval'; worker-src blob:; connect-src data: blob:; img-src data: blob:; style-src {}; base-uri \
         'none'; form-action 'none'\">\n",
        hash(LOADER),
        hash(STYLE)
    ));
    page.push_str("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n");
    page.push_str("<meta name=\"generator\" content=\"scenesplat\">\n<link rel=\"icon\" href=\"data:,\">\n<title>");
    page.push_str(&escaped(title));
    page.push_str("</title>\n<style>");
    page.push_str(STYLE);
    page.push_str("</style>\n</head>\n<body>\n");
    page.push_str(&BODY.replace(
        "<pre id=\"licenses\"></pre>",
        &format!("<pre id=\"licenses\">{}</pre>", escaped(super::LICENSES)),
    ));
    for (name, text) in &blocks {
        page.push_str("<script type=\"text/plain\" id=\"block-");
        page.push_str(name);
        page.push_str("\">");
        page.push_str(text);
        page.push_str("</script>\n");
    }
    page.push_str("<script>");
    page.push_str(LOADER);
    page.push_str("</script>\n</body>\n</html>\n");
    (page, blocks.into_iter().map(|(name, text)| (name, text.len())).collect())
}

/// What a policy calls a script or style that stands in the page.
fn hash(text: &str) -> String {
    format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text.as_bytes())))
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(bytes.len() / 2), Compression::new(6));
    encoder.write_all(bytes).expect("a vector takes all");
    encoder.finish().expect("a vector takes all")
}

/// A text in markup; of long ones the first 200 letters.
fn escaped(text: &str) -> String {
    let limit = if text.len() > 65_536 { 200 } else { usize::MAX };
    let mut out = String::with_capacity(text.len().min(65_536));
    for c in text.chars().take(limit) {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_of_a_file_is_markup() {
        let hostile = "</title><script>alert(1)</script>\"'&";
        let (page, blocks) = assemble(hostile, vec![("about", hostile.as_bytes().to_vec())]);
        assert!(!page.contains("alert(1)</script>"));
        assert!(page.contains("&lt;/title&gt;&lt;script&gt;alert(1)"));
        assert_eq!(
            blocks.iter().map(|(n, _)| n.as_str()).collect::<Vec<_>>(),
            ["about", "program"]
        );
        // The page ends scripts where it says so, and nowhere else.
        assert_eq!(page.matches("</script").count(), blocks.len() + 1);
        assert_eq!(page.matches("<script").count(), blocks.len() + 1);
        assert!(assemble(&"x".repeat(1 << 20), Vec::new()).0.len() < 3 << 20);
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
