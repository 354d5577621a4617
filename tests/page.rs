//! Pages that `view` writes: what is in the file. `.ci/page` opens the same files in a browser.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

use scenesplat::objects::relations::{Relation, distance};
use scenesplat::objects::{Catalogue, ObjectInput, ObjectSettings, find_objects};
use scenesplat::page::{PageError, PageInput, PageSettings, write_page};
use scenesplat::query::{Query, QuerySettings, select};
use scenesplat::rooms::vocabulary::Vocabulary;
use scenesplat::rooms::{CLASSES, RoomKind, SyntheticRoom, SyntheticRoomSettings, generate};
use scenesplat::scene::UpAxis;
use scenesplat::{SceneFeatures, embedded};
use std::path::PathBuf;

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

fn objects(room: &SyntheticRoom, labels: &[i32], names: &[String]) -> Catalogue {
    let input = ObjectInput {
        scene: &room.scene,
        labels,
        scores: None,
        instances: None,
        features: None,
        names,
        up: UpAxis::PlusZ,
        metres_per_unit: 1.0,
    };
    find_objects(&input, &ObjectSettings::default()).unwrap()
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
        up: UpAxis::PlusZ,
        metres_per_unit: 1.0,
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
