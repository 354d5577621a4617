//! Synthetic rooms: the same bits everywhere, exact labels, all classes often enough.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use scenesplat_rooms::{
    CLASSES, Capture, ClassId, MAX_STRAY, RoomError, RoomKind, SyntheticRoom,
    SyntheticRoomSettings, generate,
};
use std::collections::BTreeMap;

fn settings(room: u64, num_gaussians: usize) -> SyntheticRoomSettings {
    SyntheticRoomSettings { room, num_gaussians: Some(num_gaussians), ..Default::default() }
}

fn make(room: u64, num_gaussians: usize) -> SyntheticRoom {
    generate(&settings(room, num_gaussians)).unwrap()
}

fn bits(room: &SyntheticRoom) -> u64 {
    let scene = &room.scene;
    let floats = (scene.coord.iter().flatten())
        .chain(scene.log_scale.iter().flatten())
        .chain(scene.quat.iter().flatten())
        .chain(&scene.opacity_logit)
        .chain(scene.sh_dc.iter().flatten())
        .chain(scene.normal.as_ref().unwrap().iter().flatten())
        .map(|v| v.to_bits());
    let labels = (scene.segment.as_ref().unwrap().iter())
        .chain(scene.instance.as_ref().unwrap())
        .map(|v| v.cast_unsigned());
    floats.chain(labels).fold(0xcbf2_9ce4_8422_2325, |hash: u64, value| {
        (hash ^ u64::from(value)).wrapping_mul(0x100_0000_01b3)
    })
}

/// The same room on one thread and on four.
fn on_any_thread(settings: &SyntheticRoomSettings) -> SyntheticRoom {
    let [one, four] = [1, 4].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| generate(settings).unwrap())
    });
    assert_eq!(one, four, "{settings:?}");
    one
}

#[test]
fn rooms_have_the_same_bits_on_any_machine_and_thread() {
    let flat = SyntheticRoomSettings { flat_share: 1.0, ..settings(1, 9000) };
    let scan = |room| SyntheticRoomSettings { capture: Capture::Scan, ..settings(room, 3000) };
    // Networks were trained on these rooms: a change here is a change of the data.
    for (settings, expected) in [
        (settings(0, 3000), 0x1961_0f90_3ded_5701),
        (settings(1, 3000), 0x0b0d_ecf6_b939_a8af),
        (settings(2, 3000), 0x8442_0f1c_b8ad_3a8b),
        (settings(3, 3000), 0xc803_5451_f43f_250b),
        (scan(0), 0x88a4_70d7_2849_0036),
        (scan(1), 0xbede_dc05_0ba2_8c7f),
        (flat.clone(), 0x7c44_2ddf_f07a_aae6),
        (
            SyntheticRoomSettings { capture: Capture::Scan, seen_share: 1.0, ..flat.clone() },
            0x67d2_5541_351a_26c3,
        ),
        (SyntheticRoomSettings { capture: Capture::Model, ..flat }, 0xf48a_6391_85f8_b71f),
    ] {
        let found = bits(&on_any_thread(&settings));
        assert_eq!(found, expected, "{settings:?}: {found:#x}");
    }
    on_any_thread(&SyntheticRoomSettings { seen_share: 1.0, ..scan(2) });
    let depth =
        SyntheticRoomSettings { capture: Capture::Depth, public_share: 1.0, ..settings(0, 9000) };
    on_any_thread(&depth);
    let seeded = |seed| generate(&SyntheticRoomSettings { seed, ..settings(0, 500) }).unwrap();
    assert_ne!(bits(&seeded(0)), bits(&seeded(1)));
    assert_eq!(generate(&scan(0)).unwrap().objects, make(0, 3000).objects, "a scan is of the room");
}

#[test]
fn any_number_of_gaussians() {
    for n in [0, 1, 10, 1234] {
        for room in 0..8 {
            let room = make(room, n);
            assert_eq!(room.scene.len(), n);
            room.scene.check_rows().unwrap();
        }
    }
}

#[test]
fn settings_out_of_range_are_named() {
    let usual = SyntheticRoomSettings::default;
    let scan = SyntheticRoomSettings { capture: Capture::Scan, ..usual() };
    let depth = SyntheticRoomSettings { capture: Capture::Depth, ..usual() };
    for (bad, setting) in [
        (settings(0, usize::MAX), "num_gaussians"),
        (SyntheticRoomSettings { gaussians_per_m2: 1e9, ..usual() }, "gaussians_per_m2"),
        (SyntheticRoomSettings { gaussians_per_m2: 0.0, ..usual() }, "gaussians_per_m2"),
        (SyntheticRoomSettings { gaussians_per_m2: f32::NAN, ..usual() }, "gaussians_per_m2"),
        (SyntheticRoomSettings { points_share: 1.5, ..usual() }, "points_share"),
        (SyntheticRoomSettings { seen_share: 1.1, ..usual() }, "seen_share"),
        (SyntheticRoomSettings { flat_share: f64::NAN, ..usual() }, "flat_share"),
        (SyntheticRoomSettings { public_share: -0.1, ..usual() }, "public_share"),
        (SyntheticRoomSettings { density_variation: 1.1, ..usual() }, "density_variation"),
        (SyntheticRoomSettings { density_variation: f64::NAN, ..usual() }, "density_variation"),
        (SyntheticRoomSettings { density_variation: 0.5, ..scan }, "density_variation"),
        (SyntheticRoomSettings { seen_share: 0.5, ..depth }, "seen_share"),
    ] {
        let error = generate(&bad).unwrap_err();
        assert!(matches!(error, RoomError::Setting { .. }), "{error}");
        assert!(error.to_string().contains(setting), "{error}");
    }
}

#[test]
fn half_a_share_is_about_half_of_the_rooms() {
    let some = SyntheticRoomSettings { seen_share: 0.5, flat_share: 0.5, ..Default::default() };
    let (mut walked, mut flats, mut varied) = (0, 0, 0);
    for room in 0..40 {
        let few = SyntheticRoomSettings { room, num_gaussians: Some(500), ..some.clone() };
        let made = generate(&few).unwrap();
        let own = SyntheticRoomSettings { density_variation: 0.5, ..settings(room, 500) };
        let (before, after) = (make(room, 500), generate(&own).unwrap());
        assert_eq!(before.objects, after.objects);
        walked += usize::from(made.is_walked);
        flats += usize::from(made.num_rooms > 1);
        varied += usize::from(before.scene != after.scene);
    }
    let public = SyntheticRoomSettings { public_share: 0.5, ..Default::default() };
    let public = (0..40).filter(|&room| {
        let few = SyntheticRoomSettings { room, num_gaussians: Some(100), ..public.clone() };
        let (made, home) = (generate(&few).unwrap(), make(room, 100));
        assert!(made.kind.is_public() || made.objects == home.objects);
        made.kind.is_public()
    });
    for count in [walked, flats, varied, public.count()] {
        assert!((10..=30).contains(&count), "{walked} {flats} {varied}");
    }
}

#[test]
fn values_are_sound_and_labels_exact() {
    let mut kinds = BTreeMap::new();
    for index in 0..60 {
        let room = make(index, 6000);
        *kinds.entry(format!("{:?} {}", room.kind, room.is_points)).or_insert(0) += 1;
        let scene = &room.scene;
        let segment = scene.segment.as_ref().unwrap();
        let instance = scene.instance.as_ref().unwrap();
        let normal = scene.normal.as_ref().unwrap();
        let mut num_floaters = 0;
        for row in 0..scene.len() {
            let norm: f32 = scene.quat[row].iter().map(|v| v * v).sum();
            assert!((norm - 1.0).abs() < 1e-5 && scene.quat[row][0] >= 0.0);
            let norm: f32 = normal[row].iter().map(|v| v * v).sum();
            assert!((norm - 1.0).abs() < 1e-5);
            assert!(scene.scale(row).iter().all(|s| (9e-5..0.51).contains(s)));
            assert!((-4.61..5.61).contains(&scene.opacity_logit[row]) || segment[row] < 0);
            assert!(scene.opacity_logit[row].is_finite());
            assert!(scene.coord[row].iter().chain(&scene.sh_dc[row]).all(|v| v.is_finite()));
            let Ok(owner) = usize::try_from(instance[row]) else {
                assert_eq!((segment[row], instance[row]), (-1, -1));
                num_floaters += 1;
                continue;
            };
            let object = &room.objects[owner];
            assert_eq!(object.instance, instance[row]);
            assert_eq!(object.class.unwrap().index() as i32, segment[row]);
            for axis in 0..3 {
                let at = scene.coord[row][axis];
                let inside =
                    object.bounds[0][axis] - MAX_STRAY..=object.bounds[1][axis] + MAX_STRAY;
                assert!(inside.contains(&at), "room {index} {object:?} {at}");
            }
        }
        assert!(num_floaters <= 6000 / 80, "{num_floaters}");
        assert!(!room.is_points || num_floaters == 0);
        for object in &room.objects {
            let [low, high] = object.bounds;
            let class = object.class.unwrap();
            let is_shell = matches!(class, ClassId::Wall | ClassId::Window | ClassId::Door);
            let beyond = if is_shell { 0.25 } else { 0.02 };
            for axis in 0..3 {
                let inside = -beyond..=room.size[axis] + beyond;
                assert!(
                    inside.contains(&low[axis]) && inside.contains(&high[axis]),
                    "room {index} {object:?} {:?}",
                    room.size
                );
            }
        }
    }
    assert!(kinds.len() >= 9, "{kinds:?}");
}

#[test]
fn every_class_is_in_a_tenth_of_the_rooms() {
    const ROOMS: u64 = 400;
    let mut rooms_with = vec![0_u64; CLASSES.len()];
    let mut fewest = usize::MAX;
    for index in 0..ROOMS {
        let room = make(index, 0);
        let mut classes: Vec<_> = room.objects.iter().map(|o| o.class.unwrap().index()).collect();
        classes.sort_unstable();
        classes.dedup();
        fewest = fewest.min(classes.len());
        for class in classes {
            rooms_with[class] += 1;
        }
    }
    let named: Vec<_> = CLASSES.iter().map(|c| c.name).zip(&rooms_with).collect();
    println!("fewest classes {fewest}, rooms with each of {ROOMS}: {named:?}");
    assert!(fewest >= 10, "{fewest}");
    assert!(rooms_with.iter().all(|&n| n * 10 >= ROOMS), "{named:?}");
}

#[test]
fn captured_rooms_have_the_anisotropy_and_opacity_of_captures() {
    let (mut ratios, mut opacities) = (Vec::new(), Vec::new());
    for room in 0..40 {
        let captured = SyntheticRoomSettings { points_share: 0.0, ..settings(room, 4000) };
        let room = generate(&captured).unwrap();
        for row in 0..room.scene.len() {
            let [a, b, c] = room.scene.log_scale[row];
            ratios.push((a.max(b).max(c) - a.min(b).min(c)).exp());
            opacities.push(room.scene.opacity(row));
        }
    }
    let at = |values: &mut Vec<f32>, share: f32| {
        values.sort_by(f32::total_cmp);
        values[(values.len() as f32 * share) as usize]
    };
    // Of trained scenes: 5 % 2.2 to 4.0, median 17 to 34, 95 % 112 to 775.
    assert!((2.0..4.0).contains(&at(&mut ratios, 0.05)));
    assert!((17.0..34.0).contains(&at(&mut ratios, 0.5)));
    assert!((112.0..775.0).contains(&at(&mut ratios, 0.95)));
    // Medians from 0.05 (badly converged) to 0.98.
    assert!((0.05..0.98).contains(&at(&mut opacities, 0.5)));
}

#[test]
fn kinds_can_be_asked_for() {
    for kind in RoomKind::HOMES.into_iter().chain(RoomKind::PUBLIC) {
        for room in 0..5 {
            let wanted = SyntheticRoomSettings { kind: Some(kind), ..settings(room, 100) };
            assert_eq!(generate(&wanted).unwrap().kind, kind);
        }
    }
}

#[test]
fn settings_are_read_strictly() {
    let read = |text: &str| serde_json::from_str::<SyntheticRoomSettings>(text);
    let some = read(r#"{"seed": 3, "kind": "kitchen"}"#).unwrap();
    assert_eq!((some.seed, some.kind), (3, Some(RoomKind::Kitchen)));
    assert!(read(r#"{"sead": 3}"#).is_err());
}

fn scanned(room: u64) -> SyntheticRoom {
    generate(&SyntheticRoomSettings { room, capture: Capture::Scan, ..Default::default() }).unwrap()
}

/// Of each class, the mean over rooms of ln(density of its objects / density of the room), and of ln(size
/// of its Gaussians / size in the room).
fn leaks(make: impl Fn(u64) -> SyntheticRoom) -> [f64; 2] {
    let mut of_class: BTreeMap<usize, Vec<[f64; 2]>> = BTreeMap::new();
    for room in 0..40 {
        let room = make(room);
        let segment = room.scene.segment.as_ref().unwrap();
        let largest = |row: usize| {
            let s = room.scene.log_scale[row];
            f64::from(s[0].max(s[1]).max(s[2]))
        };
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let usual = median((0..room.scene.len()).map(largest).collect());
        // Cells of 8 cm that a class has, and Gaussians in them.
        let mut cells: BTreeMap<(i32, [i32; 3]), usize> = BTreeMap::new();
        for (row, p) in room.scene.coord.iter().enumerate() {
            *cells.entry((segment[row], p.map(|c| (c / 0.08) as i32))).or_default() += 1;
        }
        let mean = cells.values().sum::<usize>() as f64 / cells.len() as f64;
        for class in 0..CLASSES.len() {
            let counts: Vec<usize> = (cells.iter())
                .filter(|((c, _), _)| usize::try_from(*c) == Ok(class))
                .map(|(_, n)| *n)
                .collect();
            let sizes: Vec<f64> = (0..room.scene.len())
                .filter(|&r| usize::try_from(segment[r]) == Ok(class))
                .map(largest)
                .collect();
            if counts.len() > 30 && sizes.len() > 100 {
                let density = counts.iter().sum::<usize>() as f64 / counts.len() as f64 / mean;
                of_class.entry(class).or_default().push([density.ln(), median(sizes) - usual]);
            }
        }
    }
    let mut spread = [0.0; 2];
    let classes: Vec<_> = of_class.values().filter(|rooms| rooms.len() >= 10).collect();
    assert!(classes.len() >= 10, "{}", classes.len());
    for rooms in &classes {
        for (k, spread) in spread.iter_mut().enumerate() {
            let mean = rooms.iter().map(|r| r[k]).sum::<f64>() / rooms.len() as f64;
            *spread += mean * mean / classes.len() as f64;
        }
    }
    spread.map(f64::sqrt)
}

#[test]
fn neither_density_nor_size_tells_a_class_but_as_made() {
    let own = |room| {
        let own = SyntheticRoomSettings { density_variation: 1.0, ..settings(room, 40_000) };
        generate(&own).unwrap()
    };
    let made = leaks(|room| make(room, 40_000));
    let (scan, own, model) = (leaks(scanned), leaks(own), leaks(modelled));
    println!("density and size: made {made:?}, scans {scan:?}, own {own:?}, models {model:?}");
    assert!(made[0] > 0.4 && made[1] > 0.2, "{made:?}");
    assert!(scan[0] < 0.5 * made[0] && scan[1] < 0.1, "{scan:?}, {made:?}");
    assert!(model[0] < 0.5 * made[0] && model[1] < 0.5 * made[1], "{model:?}, {made:?}");
    // Gaussians are as large as they lie apart, so sizes tell less as well, but not nothing.
    assert!(own[0] < 0.5 * made[0], "{own:?}, {made:?}");
    assert!(own[1] < 0.6 * made[1] && own[1] > 0.1 * made[1], "{own:?}, {made:?}");
}

#[test]
fn scans_differ_in_density_and_reach_below_the_floor() {
    let rooms: Vec<SyntheticRoom> = (0..24).map(scanned).collect();
    let ratio = |room: usize| {
        let due = generate(&SyntheticRoomSettings { room: room as u64, ..Default::default() });
        rooms[room].scene.len() as f64 / due.unwrap().scene.len() as f64
    };
    let mut ratios: Vec<f64> = (0..rooms.len()).map(ratio).collect();
    ratios.sort_by(f64::total_cmp);
    assert!(ratios[0] < 0.2 && ratios[ratios.len() - 1] > 0.8, "{ratios:?}");
    let below =
        |room: &&SyntheticRoom| room.scene.coord.iter().filter(|p| p[2] < -0.05).count() > 0;
    assert!((6..=18).contains(&rooms.iter().filter(below).count()));
    for room in &rooms {
        let segment = room.scene.segment.as_ref().unwrap();
        let stray = |(p, s): (&[f32; 3], &i32)| p[2] < -2.0 * MAX_STRAY && *s != -1;
        assert!(!room.scene.coord.iter().zip(segment).any(stray), "labels below the floor");
    }
}

fn walked(room: u64) -> (SyntheticRoom, SyntheticRoom) {
    let made = SyntheticRoomSettings { room, points_share: 0.0, ..Default::default() };
    let walked = SyntheticRoomSettings { seen_share: 1.0, ..made.clone() };
    (generate(&made).unwrap(), generate(&walked).unwrap())
}

#[test]
fn of_a_walk_there_is_what_can_be_seen_from_the_floor() {
    let (mut kept, mut made) = (0, 0);
    let (mut under, mut all_under) = (0, 0);
    for number in 0..8 {
        let (before, after) = walked(number);
        assert!(after.is_walked && !before.is_walked);
        assert_eq!(before.objects, after.objects, "the same room");
        after.scene.check_rows().unwrap();
        assert!(after.scene.len() < before.scene.len());
        (made, kept) = (made + before.scene.len(), kept + after.scene.len());
        // What looks down within half a meter of the floor is seen by nobody who stands.
        let count = |room: &SyntheticRoom| {
            let normal = room.scene.normal.as_ref().unwrap();
            let segment = room.scene.segment.as_ref().unwrap();
            let is_under = |row: &usize| {
                let [_, _, z] = room.scene.coord[*row];
                normal[*row][2] < -0.9 && (0.02..0.5).contains(&z) && segment[*row] >= 0
            };
            (0..room.scene.len()).filter(is_under).count()
        };
        (all_under, under) = (all_under + count(&before), under + count(&after));
    }
    let [share, share_under] = [kept as f64 / made as f64, under as f64 / all_under as f64];
    println!("kept {share:.2} of all, {share_under:.2} of {all_under} undersides");
    assert!((0.4..0.9).contains(&share), "{share}");
    assert!(all_under > 300 && share_under < 0.5 * share, "{share_under} of {all_under}");
}

#[test]
fn places_other_than_homes_have_what_their_names_say() {
    let count = |kind: RoomKind, class: ClassId| -> usize {
        let of = |room| {
            let settings =
                SyntheticRoomSettings { kind: Some(kind), flat_share: 1.0, ..settings(room, 500) };
            let made = generate(&settings).unwrap();
            assert_eq!((made.kind, made.num_rooms), (kind, 1), "such a place is no flat");
            made.objects.iter().filter(|o| o.class == Some(class)).count()
        };
        (0..6).map(of).sum()
    };
    // In six of each, more than one a room.
    let mut missing = Vec::new();
    for (kind, class, least) in [
        (RoomKind::Pantry, ClassId::KitchenCabinet, 18),
        (RoomKind::OpenOffice, ClassId::Desk, 12),
        (RoomKind::Meeting, ClassId::Chair, 12),
        (RoomKind::Shop, ClassId::Bookshelf, 18),
        (RoomKind::Ward, ClassId::Bed, 8),
        (RoomKind::Classroom, ClassId::Chair, 12),
        (RoomKind::Workshop, ClassId::Box, 12),
        (RoomKind::Lobby, ClassId::Chair, 12),
    ] {
        let found = count(kind, class);
        if found < least {
            missing.push(format!("{kind:?}: {found} of {class:?}, {least} expected"));
        }
    }
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn a_depth_camera_leaves_points_of_what_it_saw_near_where_they_were() {
    let (mut kept, mut made, mut off, mut lit) = (0, 0, Vec::new(), 0);
    for number in 0..6 {
        let of = |capture| {
            let usual = SyntheticRoomSettings { capture, ..settings(number, 30_000) };
            generate(&usual).unwrap()
        };
        let (whole, seen) = (of(Capture::Model), of(Capture::Depth));
        seen.scene.check_rows().unwrap();
        assert_eq!(whole.objects, seen.objects, "the same room");
        assert!(seen.is_points && seen.is_walked);
        (made, kept) = (made + whole.scene.len(), kept + seen.scene.len());
        // Nearer to its own object's box than errors of range and place reach.
        let instance = seen.scene.instance.as_ref().unwrap();
        for (p, &of) in seen.scene.coord.iter().zip(instance) {
            let [low, high] = seen.objects[of as usize].bounds;
            let far = (0..3).map(|i| (low[i] - p[i]).max(p[i] - high[i]).max(0.0));
            off.push(far.fold(0.0, f32::max));
        }
        // Bare points: one opacity, discs a tenth as thick.
        let [a, b, c] = seen.scene.log_scale[0];
        assert!(a == b && (a - c - std::f32::consts::LN_10).abs() < 1e-5);
        lit +=
            usize::from(seen.scene.opacity_logit.iter().all(|&o| o == seen.scene.opacity_logit[0]));
    }
    assert_eq!(lit, 6);
    let share = kept as f64 / made as f64;
    assert!((0.1..0.7).contains(&share), "{share} of all points");
    off.sort_by(f32::total_cmp);
    let at = |share: f64| off[(off.len() as f64 * share) as usize];
    assert!(at(0.5) < 0.01 && at(0.95) < 0.06 && at(1.0 - 1e-9) < 0.25, "{} {}", at(0.5), at(0.95));
    assert!(at(0.9) > 0.002, "no noise: {}", at(0.9));
}

fn flat(room: u64) -> SyntheticRoom {
    generate(&SyntheticRoomSettings { room, flat_share: 1.0, ..Default::default() }).unwrap()
}

#[test]
fn a_flat_is_rooms_that_do_not_stand_in_each_other() {
    let mut counts = BTreeMap::new();
    for number in 0..16 {
        let flat = flat(number);
        *counts.entry(flat.num_rooms).or_insert(0) += 1;
        flat.scene.check_rows().unwrap();
        let of = |class| flat.objects.iter().filter(move |o| o.class == Some(class));
        // Each room has a floor, and so has the corridor.
        let floors: Vec<_> = of(ClassId::Floor).map(|o| o.bounds).collect();
        assert_eq!(floors.len(), flat.num_rooms + 1);
        for (i, a) in floors.iter().enumerate() {
            for b in &floors[..i] {
                let shared = |axis: usize| a[1][axis].min(b[1][axis]) - a[0][axis].max(b[0][axis]);
                let apart = -shared(0).min(shared(1));
                assert!(apart > 0.07, "flat {number}: floors {a:?} and {b:?}");
            }
        }
        for object in &flat.objects {
            let [low, high] = object.bounds;
            for axis in 0..3 {
                // Outer walls and windows have a thickness; only backs and sills lie outside.
                let out = (-low[axis]).max(high[axis] - flat.size[axis]);
                assert!(out < 0.7, "flat {number}: {object:?} of {:?}", flat.size);
            }
            // What stands or hangs in a room is above its floor, whole.
            let middle = [0, 1].map(|i| (low[i] + high[i]) / 2.0);
            let is_in = |f: &[[f32; 3]; 2]| {
                (0..2).all(|i| f[0][i] - 0.05 < middle[i] && middle[i] < f[1][i] + 0.05)
            };
            let is_building = object.class.is_some_and(|class| {
                class.about().groups.contains(&scenesplat_rooms::Group::Structure)
            });
            assert!(is_building || floors.iter().any(is_in), "flat {number}: {object:?}");
        }
    }
    assert!(counts.len() >= 4 && counts.keys().all(|n| (2..=6).contains(n)), "{counts:?}");
}

#[test]
fn a_corridor_is_open_where_rooms_have_their_doors() {
    let (mut doors, mut walls_between) = (0, 0);
    for number in 0..12 {
        let flat = flat(number);
        let (segment, instance) =
            (flat.scene.segment.as_ref().unwrap(), flat.scene.instance.as_ref().unwrap());
        // The corridor comes first: its walls are those before its floor.
        let floor = flat.objects.iter().position(|o| o.class == Some(ClassId::Floor)).unwrap();
        let corridor = flat.objects[floor].bounds;
        for door in flat.objects.iter().filter(|o| o.class == Some(ClassId::Door)) {
            let [low, high] = door.bounds;
            let beside = |y: f32| low[1] < y + 0.35 && y - 0.35 < high[1];
            let (is_bottom, is_top) = (beside(corridor[0][1]), beside(corridor[1][1]));
            if high[0] - low[0] < 0.5 || !(is_bottom || is_top) {
                // The entrance, at an end.
                continue;
            }
            doors += 1;
            for (row, p) in flat.scene.coord.iter().enumerate() {
                let is_of_corridor = usize::try_from(instance[row]).is_ok_and(|i| i < floor);
                let is_before = (low[0] + 0.05..high[0] - 0.05).contains(&p[0])
                    && (low[2] + 0.05..high[2] - 0.05).contains(&p[2])
                    && (low[1] - 0.5..high[1] + 0.5).contains(&p[1]);
                let is_wall = segment[row] == ClassId::Wall.index() as i32;
                assert!(!(is_of_corridor && is_wall && is_before), "flat {number}: {p:?} {door:?}");
            }
        }
        walls_between += flat.objects.iter().filter(|o| o.class == Some(ClassId::Wall)).count();
    }
    assert!(doors > 20 && walls_between > 150, "{doors} doors, {walls_between} walls");
}

fn modelled(room: u64) -> SyntheticRoom {
    let settings = SyntheticRoomSettings { room, capture: Capture::Model, ..Default::default() };
    generate(&settings).unwrap()
}

#[test]
fn points_of_models_are_plain() {
    // Walls of one color: hardly any as made, most of these.
    let plain = |make: &dyn Fn(u64) -> SyntheticRoom| {
        let (mut of_one, mut all) = (0, 0);
        for number in 0..12 {
            let room = make(number);
            assert!(room.scene.opacity_logit.iter().all(|o| o.is_finite()));
            for wall in room.objects.iter().filter(|o| o.class == Some(ClassId::Wall)) {
                let mut colors: Vec<_> = (room.scene.instance.as_ref().unwrap().iter())
                    .zip(&room.scene.sh_dc)
                    .filter(|(i, _)| **i == wall.instance)
                    .map(|(_, c)| c.map(f32::to_bits))
                    .collect();
                colors.sort_unstable();
                colors.dedup();
                all += 1;
                // With a skirting of another color.
                of_one += usize::from(colors.len() <= 3);
            }
        }
        f64::from(of_one as u32) / f64::from(all as u32)
    };
    let points = |room| {
        generate(&SyntheticRoomSettings { points_share: 1.0, ..settings(room, 9000) }).unwrap()
    };
    let (before, after) = (plain(&points), plain(&modelled));
    println!("walls of one color: points {before:.2}, models {after:.2}");
    assert!(before < 0.3 && after > 0.4, "{before} {after}");
    assert!((0..12).all(|room| modelled(room).is_points));
}
