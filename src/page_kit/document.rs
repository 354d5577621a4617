//! An HTML file that holds all it needs, and whose policy forbids everything else.

use super::escaped;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use sha2::{Digest, Sha256};

/// What a page may do besides running its own script.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rights {
    /// Nothing: a report.
    None,
    /// Workers and programs out of its own text: the viewer.
    Viewer,
    /// As the viewer, and it asks the program that serves it.
    ServedViewer,
}

impl Rights {
    fn policy(self, script: &str, style: &str) -> String {
        let (script, style) = (hash(script), hash(style));
        let viewer = |connect: &str| {
            format!(
                "script-src {script} blob: 'wasm-unsafe-eval'; worker-src blob:; connect-src {connect}data: \
                 blob:; img-src data: blob:"
            )
        };
        let own = match self {
            Self::None => format!("script-src {script}; img-src data:"),
            Self::Viewer => viewer(""),
            Self::ServedViewer => viewer("'self' "),
        };
        format!("default-src 'none'; {own}; style-src {style}; base-uri 'none'; form-action 'none'")
    }
}

/// What a policy calls a script or style that stands in the page.
fn hash(text: &str) -> String {
    format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text.as_bytes())))
}

/// Data of a page; nothing in it can end its element.
#[derive(Debug, Clone)]
pub struct Block {
    id: String,
    kind: &'static str,
    text: String,
}

impl Block {
    /// Bytes as base64 text.
    pub fn bytes(id: String, bytes: &[u8]) -> Self {
        Self { id, kind: "text/plain", text: STANDARD.encode(bytes) }
    }

    /// A value as JSON.
    ///
    /// # Errors
    /// If the value has no JSON form.
    pub fn json(id: &str, value: &impl Serialize) -> serde_json::Result<Self> {
        // Inside a script element only `<` could end it, and in JSON it stands in strings alone.
        let text = serde_json::to_string(value)?.replace('<', "\\u003c");
        Ok(Self { id: id.to_owned(), kind: "application/json", text })
    }

    /// Length of its text.
    pub(crate) fn len(&self) -> usize {
        self.text.len()
    }
}

/// The parts of a page. All but `title` and `blocks` are texts of this program.
#[derive(Debug, Clone, Copy)]
pub struct Document<'a> {
    /// Title of the window.
    pub title: &'a str,
    /// Class of the root element.
    pub class: &'a str,
    /// The style sheet after that of the kit.
    pub style: &'a str,
    /// Markup of the body.
    pub body: &'a str,
    /// Data, before the script.
    pub blocks: &'a [Block],
    /// The script that draws.
    pub script: &'a str,
    /// What the page may do.
    pub rights: Rights,
}

impl Document<'_> {
    /// The file.
    pub fn html(&self) -> String {
        let Self { title, class, style, body, blocks, script, rights } = self;
        let style = format!("{}{style}", super::KIT_STYLE);
        let size: usize = blocks.iter().map(|b| b.text.len() + 80).sum();
        let mut page = String::with_capacity(size + style.len() + script.len() + 32_768);
        page.push_str("<!doctype html>\n<html lang=\"en\"");
        if !class.is_empty() {
            page.push_str(&format!(" class=\"{class}\""));
        }
        page.push_str(">\n<head>\n<meta charset=\"utf-8\">\n");
        // Before anything that it is about.
        page.push_str(&format!(
            "<meta http-equiv=\"Content-Security-Policy\" content=\"{}\">\n",
            rights.policy(script, &style)
        ));
        page.push_str("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n");
        page.push_str("<meta name=\"generator\" content=\"scenesplat\">\n<link rel=\"icon\" href=\"data:,\">\n<title>");
        page.push_str(&escaped(title));
        page.push_str("</title>\n<style>");
        page.push_str(&style);
        page.push_str("</style>\n</head>\n<body>\n");
        page.push_str(body);
        for Block { id, kind, text } in *blocks {
            page.push_str(&format!("<script type=\"{kind}\" id=\"{id}\">"));
            page.push_str(text);
            page.push_str("</script>\n");
        }
        page.push_str("<script>");
        page.push_str(script);
        page.push_str("</script>\n</body>\n</html>\n");
        page
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A page that ends its scripts where it says so and nowhere else, and asks nobody.
    pub(crate) fn is_closed(page: &str, scripts: usize) {
        assert_eq!(page.matches("</script").count(), scripts);
        assert_eq!(page.matches("<script").count(), scripts);
        for outside in [" src=\"", "href=\"http", "@import", "url(", "XMLHttp", "innerHTML"] {
            assert!(!page.contains(outside), "{outside}");
        }
        let policy = page.find("Content-Security-Policy").unwrap();
        assert!(policy < page.find("<title>").unwrap() && policy < page.find("<style>").unwrap());
        assert!(page.contains("default-src 'none'") && !page.contains("unsafe-inline"));
    }

    #[test]
    fn nothing_of_a_file_is_markup() {
        let hostile = "</title></script><script>alert(1)</script><!--\"'&";
        let blocks = [
            Block::json("data", &serde_json::json!({ hostile: hostile })).unwrap(),
            Block::bytes("bytes".to_owned(), hostile.as_bytes()),
        ];
        let document = Document {
            title: hostile,
            class: "",
            style: "",
            body: "",
            blocks: &blocks,
            script: "1",
            rights: Rights::None,
        };
        let page = document.html();
        is_closed(&page, 3);
        assert!(!page.contains("<script>alert(1)") && !page.contains("<!--"));
        assert!(page.contains("<title>&lt;/title&gt;&lt;/script&gt;&lt;script&gt;alert(1)"));
        let begin = page.find("id=\"data\">").unwrap() + 10;
        let end = begin + page[begin..].find("</script>").unwrap();
        let back: serde_json::Value = serde_json::from_str(&page[begin..end]).unwrap();
        assert_eq!(back[hostile], hostile);
        assert!(Document { title: &"x".repeat(1 << 20), ..document }.html().len() < 32_768);
    }

    #[test]
    fn each_page_may_do_what_it_needs() {
        let policy = |rights: Rights| rights.policy("s", "t");
        assert!(!policy(Rights::None).contains("connect-src"));
        assert!(!policy(Rights::None).contains("blob:"));
        assert!(policy(Rights::Viewer).contains("connect-src data: blob:"));
        assert!(policy(Rights::ServedViewer).contains("connect-src 'self' data: blob:"));
        // What `printf s | openssl dgst -sha256 -binary | base64` says.
        let digest = "'sha256-BDpxh3TFcr2KJa2+sb/NXAJWrhHOz5+cP5JdDlK+r4k='";
        assert!(policy(Rights::None).contains(digest), "{}", policy(Rights::None));
    }
}
