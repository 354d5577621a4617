//! A catalogue of a few models, made on the spot: sizes, axes, colors, parts, refusals, rooms.

use super::*;
use crate::classes::ClassId;
use crate::vector::{V3, dot};
use crate::{RoomError, SyntheticRoom, SyntheticRoomSettings, generate};
use scenesplat_kernels::random::sample_rng;
use scenesplat_scene::picture::RgbPicture;
use std::fmt::Write as _;

const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];
const WHITE: [u8; 3] = [255, 255, 255];

/// A box from 0 0 0 to 2 4 3, y up: front (toward +z) red, right (+x) green, left blue, top white, the rest
/// black.
const BOX: &str = "mtllib box.mtl
v 0 0 0\nv 2 0 0\nv 2 4 0\nv 0 4 0\nv 0 0 3\nv 2 0 3\nv 2 4 3\nv 0 4 3
usemtl black\nf 1 4 3 2\nf 1 2 6 5
usemtl red\nf 5 6 7 8
usemtl green\nf 2 3 7 6
usemtl blue\nf 1 5 8 4
usemtl white\nf 4 8 7 3\n";

const BOX_MTL: &str = "newmtl black\nKd 0 0 0\nnewmtl red\nKd 1 0 0\nnewmtl green\nKd 0 1 0\nnewmtl blue\nKd 0 0 1\n\
    newmtl white\nKd 1 1 1\nnewmtl pane\nKd 0 0 1\nd 0.3\n";

/// A square in the ground plane with a picture of four colors on it; (0, 0) of the picture is its lower left.
const QUAD: &str = "mtllib quad.mtl\nv 0 0 0\nv 1 0 0\nv 1 0 -1\nv 0 0 -1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl paint\n\
    f 1/1 2/2 3/3 4/4\n";

struct Maker {
    folder: tempfile::TempDir,
    properties: String,
    count: usize,
}

impl Maker {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("m")).unwrap();
        let picture = RgbPicture::from_pixels(2, 2, vec![RED, GREEN, BLUE, WHITE]).unwrap();
        let write = |name: &str, bytes: &[u8]| {
            std::fs::write(folder.path().join("m").join(name), bytes).unwrap();
        };
        write("box.obj", BOX.as_bytes());
        write("box.mtl", BOX_MTL.as_bytes());
        write("quad.obj", QUAD.as_bytes());
        // As models from other computers name their pictures.
        write("quad.mtl", b"newmtl paint\nKd 0 0 0\nmap_Kd C:\\Users\\me\\four.png\n");
        write("four.png", &picture.encode_png().unwrap());
        Self { folder, properties: "license=Free for all\n".to_owned(), count: 0 }
    }

    fn file(&self, name: &str, text: &str) {
        std::fs::write(self.folder.path().join("m").join(name), text).unwrap();
    }

    /// A model of `model`, width, depth and height in centimeters, further lines with `#` for the number.
    fn model(&mut self, name: &str, model: &str, [w, d, h]: [f64; 3], more: &str) {
        self.count += 1;
        let n = self.count;
        let more = more.replace('#', &format!("#{n}"));
        let _ = write!(
            self.properties,
            "id#{n}=made#{name}{n}\nname#{n}={name}\nmodel#{n}=/m/{model}\nwidth#{n}={w}\ndepth#{n}={d}\nheight#{n}={h}\n\
             creator#{n}=A | B\n{more}\n"
        );
    }

    fn open(&self) -> Catalogue {
        std::fs::write(self.folder.path().join(PROPERTIES), &self.properties).unwrap();
        Catalogue::open(self.folder.path()).unwrap()
    }

    fn settings(&self, room: u64) -> SyntheticRoomSettings {
        self.open();
        SyntheticRoomSettings {
            room,
            furniture: Some(self.folder.path().to_owned()),
            furniture_share: 1.0,
            num_gaussians: Some(4000),
            ..Default::default()
        }
    }
}

fn piece(catalogue: &Catalogue, name: &str) -> Arc<Piece> {
    let index = catalogue.entries().iter().position(|entry| entry.name == name).unwrap();
    catalogue.piece(index).unwrap()
}

/// Where the points of a color are on average, and their mean normal.
fn of_color(piece: &Piece, color: [u8; 3]) -> (V3, V3) {
    let mut rng = sample_rng(1, 2, 3);
    let (mut sum, mut normals, mut count) = ([0.0; 3], [0.0; 3], 0.0);
    for _ in 0..4000 {
        let (point, found) = piece.sample(false, &mut rng);
        if found == color.map(f64::from) {
            count += 1.0;
            sum = std::array::from_fn(|i| sum[i] + point.coord[i]);
            normals = std::array::from_fn(|i| normals[i] + point.normal[i]);
        }
    }
    assert!(count > 20.0, "{color:?}: {count}");
    (sum.map(|v| v / count), normals.map(|v| v / count))
}

fn assert_near(a: V3, b: V3, by: f64) {
    assert!((0..3).all(|i| (a[i] - b[i]).abs() < by), "{a:?} is not {b:?}");
}

#[test]
fn sizes_are_metres_and_the_front_looks_to_y() {
    let mut maker = Maker::new();
    maker.model("Chair", "box.obj", [40.0, 50.0, 90.0], "");
    let catalogue = maker.open();
    let chair = piece(&catalogue, "Chair");
    assert_near(chair.bounds.low, [-0.2, -0.25, 0.0], 1e-6);
    assert_near(chair.bounds.high, [0.2, 0.25, 0.9], 1e-6);
    // Its front looks to +y, its right side, seen from behind, to −x, and up is z.
    for (color, place, normal) in [
        (RED, [0.0, 0.25, 0.45], [0.0, 1.0, 0.0]),
        (GREEN, [-0.2, 0.0, 0.45], [-1.0, 0.0, 0.0]),
        (BLUE, [0.2, 0.0, 0.45], [1.0, 0.0, 0.0]),
        (WHITE, [0.0, 0.0, 0.9], [0.0, 0.0, 1.0]),
    ] {
        let (at, looks) = of_color(&chair, color);
        assert_near(at, place, 0.04);
        assert_near(looks, normal, 0.01);
    }
    // All sides but the underside are seen: 2 · 0.9 · (0.4 + 0.5) + 0.2.
    assert!((chair.area(false) - 1.82).abs() < 0.03, "{}", chair.area(false));
    assert!((chair.area(true) - 2.02).abs() < 1e-6, "{}", chair.area(true));
    assert_eq!(catalogue.entries()[0].meaning.class(), Some(ClassId::Chair));
}

#[test]
fn models_are_turned_upright_first() {
    let mut maker = Maker::new();
    // Its z axis is up: (x, y, z) becomes (x, z, −y).
    maker.model("Sofa", "box.obj", [40.0, 50.0, 90.0], "modelRotation#=1 0 0 0 0 1 0 -1 0");
    let sofa = piece(&maker.open(), "Sofa");
    assert_near(sofa.bounds.high, [0.2, 0.25, 0.9], 1e-6);
    let (at, _) = of_color(&sofa, RED);
    assert_near(at, [0.0, 0.0, 0.9], 0.04);
    let (at, _) = of_color(&sofa, GREEN);
    assert_near(at, [-0.2, 0.0, 0.45], 0.04);
}

#[test]
fn textures_are_read_where_they_are() {
    let mut maker = Maker::new();
    maker.model("Rug with letters", "quad.obj", [200.0, 100.0, 1.0], "");
    let rug = piece(&maker.open(), "Rug with letters");
    assert_near(rug.bounds.low, [-1.0, -0.5, 0.0], 1e-6);
    let mut rng = sample_rng(0, 0, 0);
    let mut seen = [0; 4];
    for _ in 0..4000 {
        let (point, color) = rug.sample(false, &mut rng);
        assert!(dot(point.normal, [0.0, 0.0, 1.0]) > 0.999);
        // In the middle of a pixel there is one color. The picture's right is the model's +x, here −x; its
        // top is the back, here −y.
        let [x, y, _] = point.coord;
        if (x.abs() - 0.5).abs() > 0.03 || (y.abs() - 0.25).abs() > 0.015 {
            continue;
        }
        let quarter = usize::from(y > 0.0) * 2 + usize::from(x < 0.0);
        let expected = [RED, GREEN, BLUE, WHITE][quarter].map(f64::from);
        assert!((0..3).all(|i| (color[i] - expected[i]).abs() < 25.0), "{x} {y} {color:?}");
        seen[quarter] += 1;
    }
    assert!(seen.iter().all(|&n| n > 0), "{seen:?}");
}

#[test]
fn what_is_inside_is_seen_by_points_alone() {
    let mut maker = Maker::new();
    // A red plate within the box.
    maker.file(
        "full.obj",
        &format!(
            "{BOX}v 0.5 2 0.5\nv 1.5 2 0.5\nv 1.5 2 2.5\nv 0.5 2 2.5\nusemtl red\nf 9 10 11 12\n"
        ),
    );
    maker.model("Wardrobe", "full.obj", [100.0, 60.0, 200.0], "");
    maker.file(
        "open.obj",
        &format!("{}usemtl white\nf 4 8 7 3\n", BOX.replace("usemtl red\nf 5 6 7 8\n", "")),
    );
    maker.model("Shelves", "open.obj", [100.0, 60.0, 200.0], "");
    let catalogue = maker.open();
    let mut rng = sample_rng(0, 0, 0);
    let (wardrobe, shelves) = (piece(&catalogue, "Wardrobe"), piece(&catalogue, "Shelves"));
    let is_inside = |p: V3| p[2] > 0.9 && p[2] < 1.1 && p[0].abs() < 0.4 && p[1].abs() < 0.25;
    let mut inside =
        |hidden| (0..4000).any(|_| is_inside(wardrobe.sample(hidden, &mut rng).0.coord));
    assert!(inside(true) && !inside(false));
    // Without a front its back is seen from within.
    let (_, looks) = (0..4000).fold((0, 0.0), |(n, sum), _| {
        let (point, _) = shelves.sample(false, &mut rng);
        let is_back = point.coord[1] < -0.29 && point.coord[2] > 0.3;
        if is_back { (n + 1, sum + point.normal[1].signum()) } else { (n, sum) }
    });
    assert!(looks.abs() < 400.0, "both sides of the back: {looks}");
}

#[test]
fn glass_counts_less() {
    let mut maker = Maker::new();
    maker.file("glass.obj", &BOX.replace("usemtl red", "usemtl pane"));
    maker.model("Aquarium", "glass.obj", [100.0, 100.0, 100.0], "");
    let piece = piece(&maker.open(), "Aquarium");
    assert!((piece.area(true) - 5.35).abs() < 1e-6, "{}", piece.area(true));
}

#[test]
fn what_makes_no_sense_is_refused_by_name() {
    let mut maker = Maker::new();
    maker.file("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    maker.file("nan.obj", "v 0 0 0\nv 1 0 0\nv NaN 1 0\nf 1 2 3\n");
    maker.file("empty.obj", "v 0 0 0\n");
    maker.file("text.obj", "v one two three\n");
    let many: String = (0..=mesh::MAX_TRIANGLES)
        .fold("v 0 0 0\nv 1 0 0\nv 1 1 1\n".to_owned(), |t, _| t + "f 1 2 3\n");
    maker.file("many.obj", &many);
    for name in ["line", "nan", "empty", "text", "many", "missing"] {
        maker.model(name, &format!("{name}.obj"), [10.0, 10.0, 10.0], "");
    }
    maker.model("wide", "box.obj", [f64::NAN, 10.0, 10.0], "");
    maker.model("huge", "box.obj", [1e9, 10.0, 10.0], "");
    maker.model("turned", "box.obj", [1.0, 1.0, 1.0], "modelRotation#=1 0 0");
    maker.model("out", "../../box.obj", [1.0, 1.0, 1.0], "");
    maker.model("car", "box.obj", [1.0, 1.0, 1.0], "category#=Vehicles");
    maker.model("Chair", "box.obj", [40.0, 50.0, 90.0], "");
    let catalogue = maker.open();
    let refused = catalogue.examine();
    let problem = |name: &str| {
        let found = refused.iter().find(|refused| refused.id.starts_with(&format!("made#{name}")));
        found.unwrap_or_else(|| panic!("{name} is not refused: {refused:?}")).problem.clone()
    };
    for (name, says) in [
        ("line", "extents are 0"),
        ("nan", "finite"),
        ("empty", "no face"),
        ("text", "text.obj"),
        ("many", "500000"),
        ("missing", "missing.obj"),
        ("wide", "width"),
        ("huge", "width"),
        ("turned", "nine"),
        ("out", "leads out"),
    ] {
        assert!(problem(name).contains(says), "{name}: {}", problem(name));
    }
    assert_eq!(refused.len(), 10, "{refused:?}");
    assert!(catalogue.entries().iter().all(|entry| entry.name != "car"));
}

#[test]
fn catalogues_that_are_none_say_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let open = |name: &str| Catalogue::open(&folder.path().join(name)).unwrap_err().to_string();
    std::fs::write(folder.path().join("a.sh3f"), b"no archive").unwrap();
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    for name in ["missing", "a.sh3f", "empty"] {
        assert!(open(name).contains("sweethome3d-furniture"), "{}", open(name));
    }
    let mut settings = SyntheticRoomSettings {
        furniture: Some(folder.path().join("missing")),
        ..Default::default()
    };
    assert!(matches!(generate(&settings), Err(RoomError::Furniture(_))));
    settings.furniture = None;
    settings.furniture_split = FurnitureSplit::Train;
    assert!(generate(&settings).unwrap_err().to_string().contains("furniture_split"));
}

#[test]
fn a_fifth_is_held_out_of_each_name() {
    let mut maker = Maker::new();
    for _ in 0..10 {
        maker.model("Chair", "box.obj", [40.0, 50.0, 90.0], "");
    }
    for number in 0..100 {
        maker.model(&format!("thing {number}"), "box.obj", [40.0, 50.0, 90.0], "");
    }
    let catalogue = maker.open();
    let ids = |split: &str| -> Vec<&str> {
        catalogue.drawn(&split.parse().unwrap()).map(|entry| entry.id.as_str()).collect()
    };
    let (train, held) = (ids("train"), ids("held_out"));
    assert!(train.iter().all(|id| !held.contains(id)));
    assert_eq!(train.len() + held.len(), ids("all").len());
    let chairs = |ids: &[&str]| ids.iter().filter(|id| id.contains("Chair")).count();
    assert_eq!([chairs(&train), chairs(&held)], [8, 2]);
    assert!((10..35).contains(&(held.len() - 2)), "{}", held.len());
    // One more model changes nothing of the others that have their names alone.
    maker.model("thing new", "box.obj", [40.0, 50.0, 90.0], "");
    let more = maker.open();
    for (index, entry) in more.entries().iter().enumerate().filter(|(_, e)| e.name != "thing new") {
        assert_eq!(more.is_held_out(index), held.contains(&entry.id.as_str()), "{}", entry.id);
    }
    let library = maker.folder.path().file_stem().unwrap().to_string_lossy().into_owned();
    assert_eq!(ids(&format!("only:{library}")).len(), ids("all").len());
    let error = catalogue.check(&"without:Scopia".parse().unwrap()).unwrap_err();
    assert!(error.to_string().contains(&library), "{error}");
    assert!(catalogue.check(&FurnitureSplit::Without(library)).is_err(), "nothing is left");
}

#[test]
fn makers_are_named() {
    let mut maker = Maker::new();
    maker.model("Chair", "box.obj", [40.0, 50.0, 90.0], "");
    maker.model("Street light", "box.obj", [40.0, 50.0, 90.0], "");
    std::fs::write(
        maker.folder.path().join("LICENSE.TXT"),
        "Terms:\n\thttp://example.org/by/3.0/\n",
    )
    .unwrap();
    let list = maker.open().attribution(&FurnitureSplit::All);
    let text = list.to_string();
    assert!(
        text.contains(
            "| made#Chair1 | Chair | A / B | Free for all | http://example.org/by/3.0/ |"
        ),
        "{text}"
    );
    assert_eq!(
        (list.len(), Attribution::parse(&text)),
        (1, list.clone()),
        "what is never drawn is not listed"
    );
    let mut twice = list.clone();
    twice.add(list.clone());
    assert_eq!(twice, list);
}

/// Chairs, tables, a sofa, a thing without a class for a table and one for the floor.
fn furnished() -> Maker {
    let mut maker = Maker::new();
    for size in [[40.0, 50.0, 90.0], [45.0, 48.0, 85.0]] {
        maker.model("Chair", "box.obj", size, "");
    }
    maker.model("Table", "box.obj", [120.0, 80.0, 75.0], "");
    maker.model("Sofa", "box.obj", [180.0, 80.0, 80.0], "dropOnTopElevation#=-1");
    maker.model("Zither", "box.obj", [30.0, 20.0, 10.0], "");
    maker.model("Gnome", "box.obj", [40.0, 40.0, 100.0], "");
    maker.model(
        "Door",
        "box.obj",
        [90.0, 12.0, 205.0],
        "doorOrWindow#=true\ndoorOrWindowWallThickness#=8",
    );
    maker.model("Wall light", "box.obj", [20.0, 10.0, 30.0], "elevation#=150");
    maker
}

fn named<'a>(
    room: &'a SyntheticRoom,
    name: &'a str,
) -> impl Iterator<Item = &'a crate::SyntheticObject> {
    room.objects.iter().filter(move |object| object.name == name)
}

#[test]
fn rooms_have_pieces_in_their_size_with_their_labels() {
    let maker = furnished();
    let mut found = BTreeMap::new();
    for number in 0..40 {
        let room = generate(&maker.settings(number)).unwrap();
        room.scene.check_rows().unwrap();
        assert_eq!(room.scene.len(), 4000);
        let (segment, instance) =
            (room.scene.segment.as_ref().unwrap(), room.scene.instance.as_ref().unwrap());
        for object in &room.objects {
            *found.entry(object.name.clone()).or_insert(0) += 1;
            let rows = (0..4000).filter(|&row| instance[row] == object.instance);
            let label = object.class.map_or(-1, |class| class.index() as i32);
            for row in rows {
                assert_eq!(segment[row], label, "{object:?}");
                for axis in 0..3 {
                    let [low, high] = object.bounds.map(|corner| corner[axis]);
                    let at = room.scene.coord[row][axis];
                    assert!((low - 0.05..=high + 0.05).contains(&at), "{object:?} {at}");
                }
            }
        }
        for table in named(&room, "Table") {
            let [w, d, h] = std::array::from_fn(|i| table.bounds[1][i] - table.bounds[0][i]);
            assert_eq!(table.class, Some(ClassId::Table));
            assert!((h - 0.75).abs() < 1e-5 && table.bounds[0][2].abs() < 1e-6, "{table:?}");
            // Turned by any angle about z.
            assert!(w.max(d) < 1.45 && w.min(d) > 0.79, "{table:?}");
        }
        for thing in named(&room, "Zither") {
            assert_eq!(thing.class, None);
        }
        for door in named(&room, "Door") {
            assert!((door.bounds[1][2] - 2.05).abs() < 1e-5, "{door:?}");
        }
        for light in named(&room, "Wall light") {
            assert!((1.44..1.56).contains(&light.bounds[0][2]), "{light:?}");
        }
        for object in &room.objects {
            for axis in 0..3 {
                assert!(object.bounds[0][axis] > -0.3, "{object:?}");
                assert!(
                    object.bounds[1][axis] < room.size[axis] + 0.3,
                    "{object:?} {:?}",
                    room.size
                );
            }
        }
    }
    for name in ["Chair", "Table", "Sofa", "Zither", "Gnome", "Door", "Wall light"] {
        assert!(found.get(name).is_some_and(|&n| n > 5), "{name}: {found:?}");
    }
    // There is no other chair than the catalogue's at a share of 1; beds are not in it.
    assert!(!found.contains_key("chair") && found.contains_key("bed"), "{found:?}");
}

#[test]
fn the_same_room_for_any_number_of_threads() {
    let maker = furnished();
    let on = |threads, settings: &SyntheticRoomSettings| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| generate(settings).unwrap())
    };
    for number in 0..4 {
        let settings = maker.settings(number);
        let first = on(1, &settings);
        assert_eq!(first, on(4, &settings));
        // From another copy of the files, decoded anew.
        let other = furnished();
        assert_eq!(first, on(2, &other.settings(number)));
        assert!(first.objects.iter().any(|object| object.name == "Chair" || object.name == "Door"));
    }
}

#[test]
fn without_a_share_rooms_are_what_they_were_but_for_things() {
    let maker = furnished();
    let plain = SyntheticRoomSettings { room: 3, num_gaussians: Some(4000), ..Default::default() };
    let settings = SyntheticRoomSettings { furniture_share: 0.0, ..maker.settings(3) };
    let (plain, none) = (generate(&plain).unwrap(), generate(&settings).unwrap());
    let classed = |room: &SyntheticRoom| -> Vec<_> {
        room.objects.iter().map(|o| (o.name.clone(), o.bounds)).take(plain.objects.len()).collect()
    };
    assert_eq!(classed(&plain), classed(&none));
}

#[test]
fn varied_pieces_have_other_sizes_and_their_gaussians_lie_on_them() {
    let mut maker = Maker::new();
    maker.model("Chair", "box.obj", [40.0, 50.0, 90.0], "");
    maker.model("Desk", "box.obj", [140.0, 70.0, 75.0], "dropOnTopElevation#=75");
    let mut sizes = Vec::new();
    for number in 0..12 {
        let plain = maker.settings(number);
        let varied = SyntheticRoomSettings { furniture_variation: 1.0, ..plain.clone() };
        let room = generate(&varied).unwrap();
        let instances = room.scene.instance.as_ref().unwrap();
        for object in room.objects.iter().filter(|o| o.name == "Chair") {
            let [low, high] = object.bounds;
            let [w, d, h]: [f32; 3] = std::array::from_fn(|i| high[i] - low[i]);
            // Turned as it may be, a chair has its height.
            assert!((0.9 * 0.79..0.9 * 1.26).contains(&h), "{h}");
            assert!(w.max(d) < 1.26 * (0.4_f32.hypot(0.5)) && w.min(d) > 0.4 * 0.79, "{w} {d}");
            sizes.push(h);
            for (row, _) in instances.iter().enumerate().filter(|(_, i)| **i == object.instance) {
                let p = room.scene.coord[row];
                let is_in = |i: usize| {
                    p[i] > low[i] - crate::MAX_STRAY && p[i] < high[i] + crate::MAX_STRAY
                };
                assert!((0..3).all(is_in), "{p:?} {object:?}");
            }
        }
        let of_models = generate(&plain).unwrap();
        for object in of_models.objects.iter().filter(|o| o.name == "Chair") {
            assert!((object.bounds[1][2] - object.bounds[0][2] - 0.9).abs() < 1e-4, "{object:?}");
        }
    }
    assert!(sizes.len() > 5, "{}", sizes.len());
    let (least, most) = sizes.iter().fold((9.0_f32, 0.0_f32), |(a, b), &h| (a.min(h), b.max(h)));
    assert!(most - least > 0.1, "{sizes:?}");
    let settings = maker.settings(0);
    for (furniture, furniture_variation) in [(None, 0.5), (settings.furniture.clone(), 1.5)] {
        let wrong = SyntheticRoomSettings { furniture, furniture_variation, ..settings.clone() };
        let error = generate(&wrong).unwrap_err().to_string();
        assert!(error.contains("furniture_variation"), "{error}");
    }
}

#[test]
fn archives_are_read() {
    let maker = furnished();
    let from_folder = maker.open();
    let file = tempfile::Builder::new().suffix(".sh3f").tempfile().unwrap();
    let mut zip = zip::ZipWriter::new(file.reopen().unwrap());
    let mut add = |name: &str, path: &Path| {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut zip, &std::fs::read(path).unwrap()).unwrap();
    };
    add(PROPERTIES, &maker.folder.path().join(PROPERTIES));
    for name in ["box.obj", "box.mtl"] {
        add(&format!("m/{name}"), &maker.folder.path().join("m").join(name));
    }
    zip.finish().unwrap();
    let from_archive = Catalogue::open(file.path()).unwrap();
    assert_eq!(from_archive.entries().len(), from_folder.entries().len());
    let [a, b] = [&from_archive, &from_folder].map(|catalogue| {
        let piece = piece(catalogue, "Table");
        let mut rng = sample_rng(0, 0, 0);
        (0..50).map(|_| piece.sample(false, &mut rng).0.coord).collect::<Vec<_>>()
    });
    assert_eq!(a, b);
}
