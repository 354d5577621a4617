//! What a request asks for, and whether it gets it. No file is ever opened for one: what can be asked for stands in memory,
//! under names that are compared as a whole.

/// Longest head of a request, bytes.
pub(super) const LONGEST_HEAD: usize = 16 * 1024;
const MOST_HEADERS: usize = 64;

/// Where a page is served.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Address {
    pub(super) port: u16,
    /// The part of the address that only its reader knows.
    pub(super) token: String,
}

/// What is asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Target {
    Page,
    /// A chunk of a block, from 0.
    Chunk(String, usize),
}

/// Why a request gets nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refusal {
    /// As in HTTP.
    pub status: u16,
    /// In words.
    pub why: &'static str,
}

/// A request that gets an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Request {
    pub(super) target: Target,
    /// Whether the answer has no body.
    pub(super) head_only: bool,
}

const fn refused<T>(status: u16, why: &'static str) -> Result<T, Refusal> {
    Err(Refusal { status, why })
}

/// Reads the head of a request. `None`: it is not complete.
pub(super) fn judge(head: &[u8], address: &Address) -> Option<Result<Request, Refusal>> {
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(head) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) if head.len() < LONGEST_HEAD => return None,
        Ok(httparse::Status::Partial) | Err(httparse::Error::TooManyHeaders) => {
            return Some(refused(431, "the head of the request is too long"));
        }
        Err(_) => return Some(refused(400, "this is no request of HTTP/1.1")),
    }
    Some(checked(&request, address))
}

fn checked(request: &httparse::Request<'_, '_>, address: &Address) -> Result<Request, Refusal> {
    let head_only = match request.method {
        Some("GET") => false,
        Some("HEAD") => true,
        _ => return refused(405, "only GET and HEAD are answered"),
    };
    let values = |name: &str| {
        let own = request.headers.iter().filter(|h| h.name.eq_ignore_ascii_case(name));
        own.map(|h| h.value).collect::<Vec<&[u8]>>()
    };
    // A name of another site may be made to point at this machine; the browser says it all the same.
    let hosts = values("host");
    if hosts.len() != 1 || !address.is_host(hosts[0]) {
        return refused(
            403,
            "Host is not this program's address: open the address that it printed",
        );
    }
    // What other sites ask for in a reader's browser.
    let is_own =
        |origin: &&[u8]| origin.strip_prefix(b"http://").is_some_and(|host| address.is_host(host));
    if !values("origin").iter().all(is_own) {
        return refused(403, "another site asks");
    }
    if !values("sec-fetch-site").iter().all(|v| [&b"same-origin"[..], b"none"].contains(v)) {
        return refused(403, "another site asks");
    }
    let is_empty = |v: &&[u8]| *v == b"0";
    if !values("transfer-encoding").is_empty() || !values("content-length").iter().all(is_empty) {
        return refused(400, "a request with a body");
    }
    let target = address.target(request.path.unwrap_or_default());
    target.map_or(refused(404, "there is no such thing here"), |target| {
        Ok(Request { target, head_only })
    })
}

impl Address {
    fn is_host(&self, host: &[u8]) -> bool {
        ["127.0.0.1", "localhost"].iter().any(|name| {
            let full = format!("{name}:{}", self.port);
            // Browsers leave out the usual port.
            host.eq_ignore_ascii_case(full.as_bytes())
                || (self.port == 80 && host.eq_ignore_ascii_case(name.as_bytes()))
        })
    }

    fn target(&self, path: &str) -> Option<Target> {
        let mut parts = path.strip_prefix('/')?.split('/');
        if !is_equal(parts.next()?.as_bytes(), self.token.as_bytes()) {
            return None;
        }
        let rest: Vec<&str> = parts.collect();
        match rest.as_slice() {
            [""] => Some(Target::Page),
            ["chunk", name, number] => {
                // Blocks have plain names, so nothing that stands for something else gets further.
                let plain = |b: u8| b.is_ascii_alphanumeric() || b == b'_' || b == b'-';
                if name.is_empty() || !name.bytes().all(plain) {
                    return None;
                }
                let number: usize =
                    number.parse().ok().filter(|n: &usize| n.to_string() == *number)?;
                Some(Target::Chunk((*name).to_owned(), number))
            }
            _ => None,
        }
    }
}

/// As long for any two texts of one length: time tells nothing about the token.
fn is_equal(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |all, (x, y)| all | (x ^ y)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address() -> Address {
        Address { port: 4711, token: "0123456789abcdef0123456789abcdef".to_owned() }
    }

    fn ask(text: &str) -> Result<Request, Refusal> {
        judge(text.as_bytes(), &address()).unwrap()
    }

    fn status(text: &str) -> u16 {
        ask(text).map_or_else(|r| r.status, |_| 200)
    }

    const TOKEN: &str = "0123456789abcdef0123456789abcdef";
    const HOST: &str = "Host: 127.0.0.1:4711\r\n";

    #[test]
    fn the_page_and_its_chunks_are_given() {
        let page = ask(&format!("GET /{TOKEN}/ HTTP/1.1\r\n{HOST}\r\n")).unwrap();
        assert_eq!(page, Request { target: Target::Page, head_only: false });
        let own = "Origin: http://127.0.0.1:4711\r\nSec-Fetch-Site: same-origin\r\n";
        let text =
            format!("HEAD /{TOKEN}/chunk/color/12 HTTP/1.1\r\nhOsT: LOCALHOST:4711\r\n{own}\r\n");
        let chunk = ask(&text).unwrap();
        assert_eq!(chunk.target, Target::Chunk("color".to_owned(), 12));
        assert!(chunk.head_only);
        assert_eq!(judge(b"GET / HTTP/1.1\r\nHost", &address()), None, "the rest may come");
    }

    #[test]
    fn other_hosts_and_sites_get_nothing() {
        let with = |headers: &str| status(&format!("GET /{TOKEN}/ HTTP/1.1\r\n{headers}\r\n"));
        for host in [
            "Host: attacker.example\r\n",
            "Host: attacker.example:4711\r\n",
            "Host: 127.0.0.1\r\n",
            "Host: 127.0.0.1:4712\r\n",
            "Host: 127.0.0.1:4711.attacker.example\r\n",
            "Host: 127.0.0.1:4711@attacker.example\r\n",
            "Host: 0.0.0.0:4711\r\n",
            "Host: \r\n",
            "",
            "Host: 127.0.0.1:4711\r\nHost: 127.0.0.1:4711\r\n",
            "X-Forwarded-Host: 127.0.0.1:4711\r\n",
        ] {
            assert_eq!(with(host), 403, "{host:?}");
        }
        for more in [
            "Origin: http://attacker.example\r\n",
            "Origin: null\r\n",
            "Origin: https://127.0.0.1:4711\r\n",
            "Origin: http://127.0.0.1:4712\r\n",
            "Origin: http://127.0.0.1:4711.attacker.example\r\n",
            "Origin: http://127.0.0.1:4711\r\nOrigin: http://attacker.example\r\n",
            "Sec-Fetch-Site: cross-site\r\n",
            "Sec-Fetch-Site: same-site\r\n",
        ] {
            assert_eq!(with(&format!("{HOST}{more}")), 403, "{more:?}");
        }
        assert_eq!(with(&format!("{HOST}Sec-Fetch-Site: none\r\n")), 200);
    }

    #[test]
    fn nothing_else_can_be_asked_for() {
        let get = |path: &str| status(&format!("GET {path} HTTP/1.1\r\n{HOST}\r\n"));
        for path in [
            "/".to_owned(),
            format!("/{TOKEN}"),
            format!("/{}/", TOKEN.to_uppercase()),
            format!("/{}0/", &TOKEN[..31]),
            format!("//{TOKEN}/"),
            format!("/{TOKEN}/../../etc/passwd"),
            format!("/{TOKEN}/chunk/../../etc/passwd"),
            format!("/{TOKEN}/chunk/%2e%2e%2fetc/0"),
            format!("/{TOKEN}/chunk/color/-1"),
            format!("/{TOKEN}/chunk/color/+1"),
            format!("/{TOKEN}/chunk/color/00"),
            format!("/{TOKEN}/chunk/color/99999999999999999999"),
            format!("/{TOKEN}/chunk/color/0/"),
            format!("/{TOKEN}/chunk/color/0?x"),
            format!("/{TOKEN}/?query=<script>"),
            format!("http://127.0.0.1:4711/{TOKEN}/"),
            "*".to_owned(),
            "/etc/passwd".to_owned(),
            "/..%2f..%2fetc%2fpasswd".to_owned(),
            "/\\..\\..\\etc\\passwd".to_owned(),
        ] {
            assert!([400, 404].contains(&get(&path)), "{path}: {}", get(&path));
        }
        for method in ["POST", "PUT", "DELETE", "OPTIONS", "CONNECT", "TRACE", "get"] {
            let text = format!("{method} /{TOKEN}/ HTTP/1.1\r\n{HOST}\r\n");
            assert_eq!(status(&text), 405, "{method}");
        }
        for body in ["Content-Length: 5\r\n", "Transfer-Encoding: chunked\r\n"] {
            assert_eq!(status(&format!("GET /{TOKEN}/ HTTP/1.1\r\n{HOST}{body}\r\n")), 400);
        }
        for noise in ["\u{16}\u{3}\u{1} tls", "GET\r\n\r\n", "GET / HTTP/3.0\r\n\r\n", "\0\0\0\0"] {
            assert_eq!(status(noise), 400, "{noise:?}");
        }
        let many = "X: y\r\n".repeat(100);
        assert_eq!(status(&format!("GET /{TOKEN}/ HTTP/1.1\r\n{HOST}{many}\r\n")), 431);
        let long = format!("GET /{} HTTP/1.1\r\n", "a".repeat(LONGEST_HEAD));
        assert_eq!(status(&long), 431);
    }
}
