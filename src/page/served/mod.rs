//! A page in chunks for a browser on this machine: for scenes too large for a file.
//!
//! Only 127.0.0.1 is listened to. What is given stands in memory, under an address with 128 random bits; a request that
//! names another host, or comes from another site in the reader's browser, gets nothing, so no site can read the
//! scene, whatever its name is made to point at.

mod connections;
mod request;

use super::html::assemble;
use super::pack::Pack;
use super::{PageError, PageInput, PageReport, PageSettings};
use crate::page_kit::Rights;
use connections::Connections;
use rand::TryRngCore;
use rand::rngs::OsRng;
pub use request::Refusal;
use request::{Address, LONGEST_HEAD, Request, Target, judge};
use serde_json::{Map, Value};
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

/// Bytes of a chunk: many a second come through, so that progress is seen.
const CHUNK: usize = 4 << 20;
/// Between two looks for a connection, and within a wait for bytes: how long stopping may take.
const LOOK: Duration = Duration::from_millis(15);
const WAIT: Duration = Duration::from_millis(200);
/// How long a request may take to come, and an answer to begin.
const PATIENCE: Duration = Duration::from_secs(10);
/// Bytes that a reader takes in a second at least: a slow tunnel's.
const SLOWEST: u64 = 100_000;

/// A page in memory, as it is served.
#[derive(Debug)]
pub struct ServedPage {
    html: Vec<u8>,
    blocks: Vec<(&'static str, Vec<u8>)>,
    report: PageReport,
}

impl ServedPage {
    /// Packs a page.
    ///
    /// # Errors
    /// If arrays do not fit each other, or there is nothing to show.
    pub fn new(input: &PageInput<'_>, settings: &PageSettings) -> Result<Self, PageError> {
        let Pack { mut about, parts, report } = Pack::of(input, settings)?;
        let chunks = parts.iter().map(|(name, bytes)| {
            let sizes: Vec<usize> = bytes.chunks(CHUNK).map(<[u8]>::len).collect();
            ((*name).to_owned(), Value::from(sizes))
        });
        about["chunks"] = Value::Object(chunks.collect::<Map<_, _>>());
        let first = [("about", about.to_string().into_bytes())];
        let (html, mut blocks) = assemble(input.title, &first, Rights::ServedViewer);
        blocks.extend(parts.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.len())));
        let bytes = parts.iter().map(|(_, b)| b.len() as u64).sum::<u64>() + html.len() as u64;
        let report = PageReport { bytes, blocks, ..report };
        Ok(Self { html: html.into_bytes(), blocks: parts, report })
    }

    /// What is in it.
    pub fn report(&self) -> &PageReport {
        &self.report
    }

    /// Bytes of all chunks.
    fn chunk_bytes(&self) -> u64 {
        self.blocks.iter().map(|(_, bytes)| bytes.len() as u64).sum()
    }

    fn body(&self, target: &Target) -> Option<&[u8]> {
        match target {
            Target::Page => Some(&self.html),
            Target::Chunk(name, number) => {
                let (_, bytes) = self.blocks.iter().find(|(own, _)| own == name)?;
                bytes.chunks(CHUNK).nth(*number)
            }
        }
    }
}

/// Something that happened while a page was served.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ServeEvent {
    /// A browser got the page, and will ask for its chunks.
    Opened,
    /// So many bytes of the scene went out since the page was last opened.
    Sent {
        /// Bytes that went out.
        sent: u64,
        /// Bytes of the scene.
        total: u64,
    },
    /// A request got nothing.
    Refused(Refusal),
}

/// What was served.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Served {
    /// Times that the page was opened.
    pub pages: usize,
    /// Bytes of answers.
    pub bytes: u64,
    /// Requests that got nothing.
    pub refused: usize,
}

/// A place on this machine where a page can be served.
#[derive(Debug)]
pub struct PageServer {
    listener: TcpListener,
    address: Address,
}

impl PageServer {
    /// Takes a port of 127.0.0.1, 0 for any free one. Nothing is answered before [`run`](Self::run).
    ///
    /// # Errors
    /// If the port is taken, or the system gives no random numbers.
    pub fn bind(port: u16) -> Result<Self, PageError> {
        let error = |source| PageError::Bind { port, source };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(error)?;
        listener.set_nonblocking(true).map_err(error)?;
        let port = listener.local_addr().map_err(error)?.port();
        let mut random = [0u8; 16];
        OsRng.try_fill_bytes(&mut random).map_err(|_| PageError::Random)?;
        let token = random.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { listener, address: Address { port, token } })
    }

    /// What to open in a browser on this machine. Who knows it can read the page.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}/{}/", self.address.port, self.address.token)
    }

    /// Answers until `stop` is true, which is asked several times a second; then all connections are closed.
    ///
    /// # Errors
    /// If the system lets no connection through any more.
    pub fn run(
        &self,
        page: &ServedPage,
        stop: &(dyn Fn() -> bool + Sync),
        event: &mut dyn FnMut(ServeEvent),
    ) -> Result<Served, PageError> {
        let (events, seen) = channel();
        let (open, sent, bytes) = (Connections::default(), AtomicU64::new(0), AtomicU64::new(0));
        let mut served = Served::default();
        let mut tell = |e: ServeEvent| {
            match e {
                ServeEvent::Opened => served.pages += 1,
                ServeEvent::Refused(_) => served.refused += 1,
                ServeEvent::Sent { .. } => {}
            }
            event(e);
        };
        let (mut failures, mut next) = (0, 0);
        let done = std::thread::scope(|scope| {
            while !stop() {
                seen.try_iter().for_each(&mut tell);
                let stream = match self.listener.accept() {
                    Ok((stream, _)) => stream,
                    Err(e) if e.kind() == ErrorKind::WouldBlock => {
                        std::thread::sleep(LOOK);
                        continue;
                    }
                    // A browser that left, or too many open files: later ones may come through.
                    Err(source) => {
                        failures += 1;
                        if failures > 200 {
                            return Err(PageError::Accept { source });
                        }
                        std::thread::sleep(LOOK);
                        continue;
                    }
                };
                failures = 0;
                while !open.make_room() && !stop() {
                    std::thread::sleep(LOOK);
                }
                next += 1;
                if !open.add(next, &stream) {
                    continue;
                }
                let (id, address, events) = (next, &self.address, events.clone());
                let (open, sent, bytes) = (&open, &sent, &bytes);
                scope.spawn(move || {
                    Connection { id, open, address, page, stop, events, sent, bytes }
                        .answer(stream);
                    open.remove(id);
                });
            }
            Ok(())
        });
        seen.try_iter().for_each(&mut tell);
        done.map(|()| Served { bytes: bytes.into_inner(), ..served })
    }
}

/// One connection, which gets one answer.
struct Connection<'a> {
    id: u64,
    open: &'a Connections,
    address: &'a Address,
    page: &'a ServedPage,
    stop: &'a (dyn Fn() -> bool + Sync),
    events: Sender<ServeEvent>,
    /// Of the scene since the page was last opened.
    sent: &'a AtomicU64,
    bytes: &'a AtomicU64,
}

impl Connection<'_> {
    fn answer(&self, mut stream: TcpStream) {
        // Where this cannot be set, waiting would have no end: then there is no answer.
        let waits = stream
            .set_nonblocking(false)
            .and_then(|()| stream.set_read_timeout(Some(WAIT)))
            .and_then(|()| stream.set_write_timeout(Some(WAIT)));
        if waits.is_err() {
            return;
        }
        let Some(judged) = self.head(&mut stream) else { return };
        self.open.moved(self.id);
        let found = judged.and_then(|request| {
            let missing = Refusal { status: 404, why: "there is no such thing here" };
            self.page.body(&request.target).map(|body| (request, body)).ok_or(missing)
        });
        let whole = match &found {
            Ok((Request { target, head_only }, body)) => {
                let kind = match target {
                    Target::Page => "text/html; charset=utf-8",
                    Target::Chunk(..) => "application/octet-stream",
                };
                let body_sent: &[u8] = if *head_only { &[] } else { body };
                self.send(&mut stream, head(200, kind, body.len()).as_bytes())
                    && self.send(&mut stream, body_sent)
            }
            Err(Refusal { status, why }) => {
                let text = format!("{why}\n");
                let head = head(*status, "text/plain; charset=utf-8", text.len());
                self.send(&mut stream, (head + &text).as_bytes())
            }
        };
        close(&mut stream);
        match found {
            Ok((Request { target: Target::Page, head_only: false }, _)) if whole => {
                self.sent.store(0, Ordering::Release);
                self.tell(ServeEvent::Opened);
            }
            Ok((Request { target: Target::Chunk(..), head_only: false }, body)) if whole => {
                let own = body.len() as u64;
                let sent = self.sent.fetch_add(own, Ordering::AcqRel) + own;
                self.tell(ServeEvent::Sent { sent, total: self.page.chunk_bytes() });
            }
            Err(refusal) => self.tell(ServeEvent::Refused(refusal)),
            Ok(_) => {}
        }
    }

    fn tell(&self, event: ServeEvent) {
        // Nobody listens once serving is over.
        let _ = self.events.send(event);
    }

    /// Reads a request; `None` if none comes.
    fn head(&self, stream: &mut TcpStream) -> Option<Result<Request, Refusal>> {
        let began = Instant::now();
        let mut head = Vec::new();
        let mut part = [0u8; 2048];
        loop {
            match stream.read(&mut part) {
                Ok(0) => return None,
                Ok(n) => {
                    head.extend_from_slice(&part[..n]);
                    if let Some(judged) = judge(&head, self.address) {
                        return Some(judged);
                    }
                }
                Err(e) if is_wait(&e) => {}
                Err(_) => return None,
            }
            if (self.stop)() || began.elapsed() > PATIENCE {
                return None;
            }
            debug_assert!(head.len() <= LONGEST_HEAD + part.len());
        }
    }

    /// Whether all of it went out, in the time that a slow reader needs.
    fn send(&self, stream: &mut TcpStream, mut bytes: &[u8]) -> bool {
        let needed = Duration::from_secs(bytes.len() as u64 / SLOWEST);
        let deadline = Instant::now() + PATIENCE + needed;
        while !bytes.is_empty() {
            if (self.stop)() || Instant::now() > deadline {
                return false;
            }
            match stream.write(&bytes[..bytes.len().min(1 << 18)]) {
                Ok(0) => return false,
                Ok(n) => {
                    self.bytes.fetch_add(n as u64, Ordering::Relaxed);
                    bytes = &bytes[n..];
                    self.open.moved(self.id);
                }
                Err(e) if is_wait(&e) => {}
                Err(_) => return false,
            }
        }
        true
    }
}

fn is_wait(error: &std::io::Error) -> bool {
    [ErrorKind::WouldBlock, ErrorKind::TimedOut, ErrorKind::Interrupted].contains(&error.kind())
}

/// Ends a connection so that the answer arrives: what is left unread would take it back.
fn close(stream: &mut TcpStream) {
    if stream.shutdown(Shutdown::Write).is_ok() {
        let mut rest = [0u8; 4096];
        for _ in 0..16 {
            if !matches!(stream.read(&mut rest), Ok(n) if n > 0) {
                break;
            }
        }
    }
}

fn head(status: u16, kind: &str, length: usize) -> String {
    let reason = match status {
        200 => "OK",
        400 => "Bad Request",
        403 => "Forbidden",
        405 => "Method Not Allowed",
        431 => "Request Header Fields Too Large",
        _ => "Not Found",
    };
    let allow = if status == 405 { "Allow: GET, HEAD\r\n" } else { "" };
    // No other site may frame, read or keep it. The page itself says what it may load.
    let policy = match kind.starts_with("text/html") {
        true => "frame-ancestors 'none'",
        false => "default-src 'none'; frame-ancestors 'none'; sandbox",
    };
    format!(
        "HTTP/1.1 {status} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n{allow}Connection: close\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\n\
         Referrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n\
         Cross-Origin-Opener-Policy: same-origin\r\nContent-Security-Policy: {policy}\r\n\r\n"
    )
}
