//! Pages that `view` writes: the contents of the file. `.ci/page` opens the same files in a browser.

use scenesplat::experiment::curves::write_curves_page;
use scenesplat::objects::relations::{Relation, distance};
use scenesplat::objects::{Catalogue, ObjectInput, ObjectSettings, find_objects};
use scenesplat::page::{
    PageError, PageInput, PageServer, PageSettings, ServeEvent, ServedPage, write_page,
};
use scenesplat::query::{Query, QuerySettings, select};
use scenesplat::rooms::vocabulary::Vocabulary;
use scenesplat::rooms::{CLASSES, RoomKind, SyntheticRoom, SyntheticRoomSettings, generate};
use scenesplat::scene::Up;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::trainers::callbacks::LoggedValue;
use scenesplat::{SceneFeatures, embedded};
use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Where pages go: a folder that the browser test names, or a temporary one.
struct Folder(PathBuf, Option<tempfile::TempDir>);

fn folder() -> Folder {
    match std::env::var_os("SCENESPLAT_PAGES") {
        Some(path) => {
            std::fs::create_dir_all(&path).unwrap();
            Folder(path.into(), None)
        }
        None => {
            let folder = tempfile::tempdir().unwrap();
            Folder(folder.path().to_owned(), Some(folder))
        }
    }
}

fn room(count: usize) -> SyntheticRoom {
    let settings = SyntheticRoomSettings {
        kind: Some(RoomKind::Office),
        points_share: 1.0,
        ..SyntheticRoomSettings::with_count(count, 12)
    };
    generate(&settings).unwrap()
}

fn names() -> Vec<String> {
    CLASSES.iter().map(|c| c.name.to_owned()).collect()
}

fn known<'a>(room: &'a SyntheticRoom, labels: &'a [i32], names: &'a [String]) -> ObjectInput<'a> {
    ObjectInput {
        scene: &room.scene,
        labels,
        scores: None,
        instances: None,
        features: None,
        names,
        upright: Up::PLUS_Z.upright(),
        metres_per_unit: 1.0,
        floor: None,
    }
}

fn objects(room: &SyntheticRoom, labels: &[i32], names: &[String]) -> Catalogue {
    find_objects(&known(room, labels, names), &ObjectSettings::default()).unwrap()
}

fn plain<'a>(room: &'a SyntheticRoom, title: &'a str) -> PageInput<'a> {
    PageInput {
        title,
        scene: &room.scene,
        labels: None,
        scores: None,
        names: &[],
        catalogue: None,
        features: None,
        vocabulary: None,
        upright: Up::PLUS_Z.upright(),
        metres_per_unit: 1.0,
        warnings: &[],
        remarks: &[],
    }
}

/// What a perfect network would give.
fn features(room: &SyntheticRoom, words: &Vocabulary) -> SceneFeatures {
    let ids = room.scene.instance.as_deref().unwrap();
    let row = |&id: &i32| match usize::try_from(id).ok().and_then(|id| room.objects.get(id)) {
        Some(object) => words.object_target(object.class.unwrap(), object.color),
        None => vec![0.0; words.dim()],
    };
    SceneFeatures::from_rows(ids.iter().flat_map(row).collect(), words.dim()).unwrap()
}

#[test]
fn a_room_with_everything() {
    let Folder(folder, _keep) = folder();
    let (room, names, words) = (room(60_000), names(), embedded::vocabulary().unwrap());
    let labels = room.scene.segment.as_deref().unwrap();
    let scores: Vec<f32> = (0..labels.len()).map(|i| 0.5 + 0.5 * (i % 100) as f32 / 99.0).collect();
    let catalogue = objects(&room, labels, &names);
    let (features, text) = (features(&room, &words), words.class_table());
    let input = PageInput {
        labels: Some(labels),
        scores: Some(&scores),
        names: &names,
        catalogue: Some(&catalogue),
        features: Some((&features, &text)),
        vocabulary: Some(&words),
        ..plain(&room, "room.ply")
    };
    let report = write_page(&folder.join("room.html"), &input, &PageSettings::default()).unwrap();
    println!("{report:?}");
    assert_eq!((report.gaussians, report.left_out), (60_000, 0));
    assert!(report.bytes < 4_500_000, "{}", report.bytes);
    assert!(report.code_cosine.unwrap() > 0.9, "{report:?}");
    let query = Query::of_vocabulary(&words, "chair").unwrap();
    let found = select(&features, &query, &QuerySettings::default(), &room.scene.coord).unwrap();
    let chair: Vec<usize> = (0..labels.len()).filter(|&i| found.selected[i] == 1).collect();
    assert!(chair.len() > 200, "{}", chair.len());
    // Something that stands on something, in words.
    let all = &catalogue.objects;
    let pair = all.iter().flat_map(|a| all.iter().map(move |b| (a, b))).find(|(a, b)| {
        a.class != b.class && b.class == "desk" && distance(a, b, Relation::On).is_some()
    });
    let (a, b) = pair.expect("something stands on a desk");
    let relation = format!("the {} on the {}", a.class, b.class);
    let about = serde_json::json!({
        "chair": chair,
        "least_iou": 0.9,
        "phrases": [
            ["chairs", "Gaussians, [1-9]\\d* object"],
            ["chiar", "taken as “chair”"],
            ["Somewhere to sleep", "taken as “bed”|nothing"],
            ["armchair", "taken as “(chair|sofa)”"],
            ["brown desk", "Gaussians"],
            ["seat", "chair, stool, sofa"],
            [relation, "[1-9]\\d* object"],
            ["chair vs desk", "Gaussians"],
            ["floor on the chair", "nothing found"],
            ["xqzzt", "nothing found.*none of these words"],
        ],
    });
    std::fs::write(folder.join("room.json"), about.to_string()).unwrap();
}

#[test]
fn names_of_any_kind_are_text() {
    let Folder(folder, _keep) = folder();
    let room = room(6_000);
    let mut names = names();
    let attack = "<img src=x onerror=globalThis.attacked=1>";
    names[0] = format!("</script><script>globalThis.attacked=1</script>{attack}");
    names[1] = "🪑\u{202e} floor \u{0}\n\"'`${attacked=1}".to_owned();
    names[2] = "x".repeat(1 << 20);
    names[8] = "__proto__".to_owned();
    let labels = room.scene.segment.as_deref().unwrap();
    let catalogue = objects(&room, labels, &names);
    let input = PageInput {
        labels: Some(labels),
        names: &names,
        catalogue: Some(&catalogue),
        warnings: &[format!("up is unclear {attack}")],
        remarks: &[
            attack.to_owned(),
            "]]>--></pre><script>globalThis.attacked=1</script>".to_owned(),
        ],
        ..plain(&room, "</title></style><script>globalThis.attacked=1</script>.ply")
    };
    let path = folder.join("hostile.html");
    write_page(&path, &input, &PageSettings::default()).unwrap();
    let page = std::fs::read_to_string(path).unwrap();
    // In its title it is escaped, everywhere else it is in base64.
    assert!(!page.contains("attacked=1</script>") && !page.contains("<img"));
    assert_eq!(page.matches("attacked").count(), 1);
    let policy = page.find("Content-Security-Policy").unwrap();
    assert!(policy < page.find("<title>").unwrap());
    assert!(page.contains("default-src 'none'") && !page.contains("unsafe-inline"));
    for scheme in ["http:", "https:"] {
        let outside = page.split("<script").next().unwrap();
        let outside = outside.split("<pre").next().unwrap();
        assert!(!outside.contains(scheme), "{scheme}");
    }
}

#[test]
fn a_scene_alone_and_what_does_not_fit() {
    let Folder(folder, _keep) = folder();
    let room = room(6_000);
    let input = plain(&room, "plain.ply");
    let whole = write_page(&folder.join("plain.html"), &input, &PageSettings::default()).unwrap();
    let less = PageSettings { max_splats: Some(1000), ..PageSettings::default() };
    let part = write_page(&folder.join("part.html"), &input, &less).unwrap();
    assert_eq!((part.gaussians, part.left_out), (1000, 5000));
    assert!(part.bytes < whole.bytes);

    let path = folder.join("none.html");
    let short = PageInput { labels: Some(&[0; 3]), ..input };
    let error = write_page(&path, &short, &PageSettings::default()).unwrap_err();
    assert_eq!(error.to_string(), "labels: expected 6000 rows, one a Gaussian, got 3");
    let mut nowhere = room.clone();
    nowhere.scene.coord.iter_mut().for_each(|c| c[0] = f32::NAN);
    let error = write_page(&path, &plain(&nowhere, "x"), &PageSettings::default()).unwrap_err();
    assert!(matches!(error, PageError::Empty));
    let many: Vec<String> = (0..70_000).map(|i| format!("class {i}")).collect();
    let error = write_page(&path, &PageInput { names: &many, ..input }, &PageSettings::default());
    assert!(matches!(error, Err(PageError::TooMany { count: 70_000, .. })));
    assert!(!path.exists());
}

#[test]
fn the_same_scene_is_the_same_page() {
    let Folder(folder, _keep) = folder();
    let room = room(3_000);
    let page = |name: &str| {
        let path = folder.join(name);
        write_page(&path, &plain(&room, "same"), &PageSettings::default()).unwrap();
        std::fs::read(path).unwrap()
    };
    assert_eq!(page("one.html"), page("two.html"));
}

/// Values that look random and are the same everywhere, −1..=1.
fn noise(i: u64) -> f32 {
    let mixed = (i ^ (i >> 31)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((mixed >> 40) as f32 / 8_388_608.0) - 1.0
}

/// A room of 1.5 million Gaussians, each with a feature of its own that is no other's: what codes take at most.
#[test]
#[ignore = "takes a minute and a gigabyte; LARGE=1 .ci/page runs it and opens the page"]
fn a_page_of_one_and_a_half_million_gaussians() {
    let Folder(folder, _keep) = folder();
    let (room, names, words) = (room(1_500_000), names(), embedded::vocabulary().unwrap());
    let labels = room.scene.segment.as_deref().unwrap();
    let scores: Vec<f32> = (0..labels.len() as u64).map(|i| 0.5 + 0.5 * noise(i)).collect();
    let instances = room.scene.instance.as_deref();
    let known = ObjectInput { scores: Some(&scores), instances, ..known(&room, labels, &names) };
    let catalogue = find_objects(&known, &ObjectSettings::default()).unwrap();
    let (width, ids) = (words.dim(), room.scene.instance.as_deref().unwrap());
    let targets: Vec<Vec<f32>> =
        room.objects.iter().map(|o| words.object_target(o.class.unwrap(), o.color)).collect();
    let mut rows = Vec::with_capacity(ids.len() * width);
    for (i, &id) in (0u64..).zip(ids) {
        let target = usize::try_from(id).ok().and_then(|id| targets.get(id));
        let spread = 0.4 / (width as f32).sqrt();
        rows.extend(
            (0..width as u64).map(|k| {
                target.map_or(0.0, |t| t[k as usize]) + spread * noise(i * width as u64 + k)
            }),
        );
    }
    let features = SceneFeatures::from_rows(rows, width).unwrap();
    let text = words.class_table();
    let input = PageInput {
        labels: Some(labels),
        scores: Some(&scores),
        names: &names,
        catalogue: Some(&catalogue),
        features: Some((&features, &text)),
        vocabulary: Some(&words),
        ..plain(&room, "large.ply")
    };
    let report = write_page(&folder.join("large.html"), &input, &PageSettings::default()).unwrap();
    println!("{report:?}");
    assert_eq!((report.gaussians, report.left_out), (1_500_000, 0));
    assert!(report.bytes <= 90_000_000, "{} bytes", report.bytes);
    let chairs =
        room.objects.iter().filter(|o| CLASSES[o.class.unwrap().index()].name == "chair").count();
    let about = serde_json::json!({ "bytes": report.bytes, "chairs": chairs });
    std::fs::write(folder.join("large.json"), about.to_string()).unwrap();
}

/// The curves of a training run, with names that would be markup.
#[test]
fn curves_are_a_page_of_the_same_kit() {
    let Folder(folder, _keep) = folder();
    let attack = "<img src=x onerror=globalThis.attacked=1></script>";
    let log: Vec<LoggedValue> = (0..4000u64)
        .flat_map(|step| {
            let value = |name: &str, value: f64| LoggedValue {
                step,
                epoch: 0,
                name: name.to_owned(),
                value,
            };
            let loss = 2.0 / (1.0 + step as f64 / 400.0) + 0.2 * f64::from(noise(step));
            let mut all = vec![
                value(&format!("train/{attack}"), loss),
                value("train/loss", 2.0 * loss),
                value("train/lr_factor", 1.0),
            ];
            if step % 500 == 0 {
                all.push(value("unseen/oracle/mIoU", 0.99));
                all.push(value("unseen/mIoU", 0.99 + step as f64 * 1e-8));
            }
            all
        })
        .collect();
    write_curves_page(&log, None, attack, &folder.join("curves.html")).unwrap();
    let page = std::fs::read_to_string(folder.join("curves.html")).unwrap();
    assert_eq!(page.matches("</script").count(), 2);
    assert!(page.contains("default-src 'none'") && !page.contains("unsafe-inline"));
    assert!(!page.contains("<img") && !page.contains("<script>globalThis"));
}

/// A server in a thread that ends with it.
struct Running {
    url: String,
    port: u16,
    stop: std::sync::Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<(scenesplat::page::Served, Vec<ServeEvent>)>>,
}

impl Running {
    fn of(page: ServedPage) -> Self {
        let server = PageServer::bind(0).unwrap();
        let (url, stop) = (server.url(), std::sync::Arc::new(AtomicBool::new(false)));
        let port = url.split([':', '/']).nth(4).unwrap().parse().unwrap();
        let own = stop.clone();
        let thread = std::thread::spawn(move || {
            let mut events = Vec::new();
            let stop = || own.load(Ordering::SeqCst);
            let served = server.run(&page, &stop, &mut |e| events.push(e)).unwrap();
            (served, events)
        });
        Self { url, port, stop, thread: Some(thread) }
    }

    fn token(&self) -> &str {
        self.url.rsplit('/').nth(1).unwrap()
    }

    /// Sends bytes as they are; gives what comes back.
    fn send(&self, request: &[u8]) -> Vec<u8> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let _ = stream.write_all(request);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    /// Status and body of a GET.
    fn get(&self, path: &str, headers: &str) -> (u16, Vec<u8>) {
        let host = format!("Host: 127.0.0.1:{}\r\n", self.port);
        let answer = self.send(format!("GET {path} HTTP/1.1\r\n{host}{headers}\r\n").as_bytes());
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = std::str::from_utf8(&answer[..end]).unwrap();
        assert!(
            head.contains("X-Content-Type-Options: nosniff") && !head.contains("Access-Control")
        );
        (head.split(' ').nth(1).unwrap().parse().unwrap(), answer[end + 4..].to_vec())
    }

    fn end(&mut self) -> (scenesplat::page::Served, Vec<ServeEvent>) {
        self.stop.store(true, Ordering::SeqCst);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
    }
}

/// The bytes that a page has as text, by their name.
fn block(page: &str, name: &str) -> Option<Vec<u8>> {
    let open = format!("id=\"block-{name}\">");
    let from = page.find(&open).map(|at| at + open.len())?;
    let text = &page[from..from + page[from..].find('<').unwrap()];
    let packed = base64::Engine::decode(&base64::engine::general_purpose::STANDARD, text).unwrap();
    let mut bytes = Vec::new();
    flate2::read::ZlibDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
    Some(bytes)
}

#[test]
fn a_served_page_is_the_file_in_chunks() {
    let Folder(folder, _keep) = folder();
    let (room, names) = (room(20_000), names());
    let labels = room.scene.segment.as_deref().unwrap();
    let catalogue = objects(&room, labels, &names);
    let input = PageInput {
        labels: Some(labels),
        names: &names,
        catalogue: Some(&catalogue),
        ..plain(&room, "</title><script>globalThis.attacked=1</script>.ply")
    };
    let settings = PageSettings::default();
    let mut running = Running::of(ServedPage::new(&input, &settings).unwrap());
    let token = running.token().to_owned();
    let (status, page) = running.get(&format!("/{token}/"), "Sec-Fetch-Site: none\r\n");
    assert_eq!(status, 200);
    let page = String::from_utf8(page).unwrap();
    assert!(
        page.contains("connect-src 'self' data: blob:") && !page.contains("attacked=1</script>")
    );
    // What the file has as text comes as bytes.
    let path = folder.join("served-beside.html");
    write_page(&path, &input, &settings).unwrap();
    let file = std::fs::read_to_string(path).unwrap();
    let about: serde_json::Value = serde_json::from_slice(&block(&page, "about").unwrap()).unwrap();
    let in_file: serde_json::Value =
        serde_json::from_slice(&block(&file, "about").unwrap()).unwrap();
    assert!(in_file["chunks"].is_null() && in_file["objects"] == about["objects"]);
    let chunks = about["chunks"].as_object().unwrap();
    assert_eq!(chunks["position"][0], 180_000);
    let mut total = 0;
    for (name, sizes) in chunks {
        let mut bytes = Vec::new();
        for (i, size) in sizes.as_array().unwrap().iter().enumerate() {
            let (status, chunk) = running.get(&format!("/{token}/chunk/{name}/{i}"), "");
            assert_eq!((status, Some(chunk.len() as u64)), (200, size.as_u64()), "{name} {i}");
            bytes.extend(chunk);
        }
        total += bytes.len() as u64;
        assert_eq!(Some(bytes), block(&file, name), "{name}");
        assert!(block(&page, name).is_none());
        let beyond = format!("/{token}/chunk/{name}/{}", sizes.as_array().unwrap().len());
        assert_eq!(running.get(&beyond, "").0, 404, "{name}");
    }
    let (served, events) = running.end();
    assert_eq!((served.pages, served.refused), (1, chunks.len()));
    assert!(
        events.contains(&ServeEvent::Opened)
            && events.contains(&ServeEvent::Sent { sent: total, total })
    );
}

#[test]
fn hostile_requests_get_nothing_and_end() {
    let room = room(2_000);
    let page = ServedPage::new(&plain(&room, "room"), &PageSettings::default()).unwrap();
    let mut running = Running::of(page);
    let (token, port) = (running.token().to_owned(), running.port);
    assert!(token.len() == 32 && token.bytes().all(|b| b.is_ascii_hexdigit()));
    let status = |request: String| {
        let answer = running.send(request.as_bytes());
        String::from_utf8_lossy(&answer).split(' ').nth(1).map(|s| s.parse::<u16>().unwrap())
    };
    let host = format!("Host: 127.0.0.1:{port}\r\n");
    let page = format!("GET /{token}/ HTTP/1.1\r\n");
    for (request, want) in [
        // One of each kind; the unit tests of requests have many more.
        (format!("{page}Host: attacker.example:{port}\r\n\r\n"), 403),
        (format!("{page}{host}Sec-Fetch-Site: cross-site\r\n\r\n"), 403),
        (format!("GET /{token}/../../../etc/passwd HTTP/1.1\r\n{host}\r\n"), 404),
        (format!("POST /{token}/ HTTP/1.1\r\n{host}Content-Length: 4\r\n\r\nabcd"), 405),
        ("\u{16}\u{3}\u{1}\u{2} no request\r\n\r\n".to_owned(), 400),
        (format!("{page}X: {}", "y".repeat(1 << 20)), 431),
    ] {
        let short: String = request.chars().take(120).collect();
        assert_eq!(status(request), Some(want), "{short:?}");
    }
    // Nothing but HEAD leaves out the body.
    let head = running.send(format!("HEAD /{token}/ HTTP/1.1\r\n{host}\r\n").as_bytes());
    assert!(head.starts_with(b"HTTP/1.1 200 OK\r\n") && head.ends_with(b"\r\n\r\n"));
    // Only this machine is listened to: another of its addresses has nobody.
    assert!(TcpStream::connect(("127.0.0.2", port)).is_err());
    // Two requests in one, and many that never end: the page is there all the same.
    let twice = format!("{page}{host}\r\n{page}{host}\r\n");
    assert_eq!(
        String::from_utf8_lossy(&running.send(twice.as_bytes())).matches("HTTP/1.1 ").count(),
        1
    );
    let idle: Vec<TcpStream> = (0..145)
        .map(|_| {
            let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
            stream.write_all(b"GET / HTTP/1.1\r\n").unwrap();
            stream
        })
        .collect();
    let asked = Instant::now();
    assert_eq!(running.get(&format!("/{token}/"), "").0, 200);
    assert!(asked.elapsed() < Duration::from_secs(8), "{:?}", asked.elapsed());
    // It ends at once, whoever still waits.
    let began = Instant::now();
    let (served, events) = running.end();
    assert!(began.elapsed() < Duration::from_secs(3), "{:?}", began.elapsed());
    assert_eq!(served.refused, 6, "{events:?}");
    assert!(idle.iter().all(|s| s.shutdown(Shutdown::Both).is_ok() || s.peer_addr().is_err()));
    assert!(TcpStream::connect(("127.0.0.1", port)).is_err());
}

#[test]
fn a_taken_port_is_said_and_addresses_differ() {
    let first = PageServer::bind(0).unwrap();
    let port = first.url().split([':', '/']).nth(4).unwrap().parse().unwrap();
    let error = PageServer::bind(port).unwrap_err();
    assert!(matches!(error, PageError::Bind { port: p, .. } if p == port), "{error}");
    let second = PageServer::bind(0).unwrap();
    assert_ne!(first.url().rsplit('/').nth(1), second.url().rsplit('/').nth(1));
}

/// A scene with a name that would be markup, for the browser test of `view --serve`.
#[test]
fn a_hostile_scene_to_serve() {
    let Folder(folder, _keep) = folder();
    let room = room(20_000);
    let mut names = names();
    names[0] =
        "</script><script>globalThis.attacked=1</script><img src=x onerror=globalThis.attacked=1>"
            .to_owned();
    let path = folder.join("a \"><img src=x onerror=globalThis.attacked=1>.ply");
    write_inria_ply(&room.scene, &[], &path).unwrap();
    let list = folder.join("served-names.json");
    std::fs::write(&list, serde_json::to_string(&names).unwrap()).unwrap();
    let read = scenesplat::scene::label_set::read_names(&list).unwrap();
    assert_eq!(read, names);
}
