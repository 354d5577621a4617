use super::*;

const SIDE: f32 = 0.05;

/// Rows in the making.
#[derive(Default)]
struct Rows(Vec<FloorRow>);

impl Rows {
    fn push(&mut self, coord: [f32; 3], quat: [f32; 4], opacity: f32) {
        self.0.push(FloorRow { coord, opacity, scale: [0.03, 0.03, 0.003], quat });
    }

    /// A level rectangle of discs.
    fn plane(&mut self, from: [f32; 2], to: [f32; 2], z: f32) {
        let count = |a: usize| ((to[a] - from[a]) / SIDE) as u16;
        for i in 0..count(0) {
            for j in 0..count(1) {
                let at = |a: usize, k: u16| from[a] + SIDE * f32::from(k);
                self.push([at(0, i), at(1, j), z], [1.0, 0.0, 0.0, 0.0], 0.9);
            }
        }
    }

    /// Four walls of a room of 4 × 3 m.
    fn walls(&mut self, z: f32, high: f32) {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        for i in 0..(high / SIDE) as u16 {
            let z = z + SIDE * f32::from(i);
            for j in 0..80u16 {
                let x = SIDE * f32::from(j);
                self.push([x, 0.0, z], [half, half, 0.0, 0.0], 0.9);
                self.push([x, 3.0, z], [half, half, 0.0, 0.0], 0.9);
            }
            for j in 0..60u16 {
                let y = SIDE * f32::from(j);
                self.push([0.0, y, z], [half, 0.0, half, 0.0], 0.9);
                self.push([4.0, y, z], [half, 0.0, half, 0.0], 0.9);
            }
        }
    }

    fn floors(&self) -> Floors {
        Floors::of(self.0.len(), |row| self.0[row])
    }
}

/// A room with a table and a bed.
fn room(z: f32) -> Rows {
    let mut rows = Rows::default();
    rows.plane([0.0, 0.0], [4.0, 3.0], z);
    rows.walls(z, 2.5);
    rows.plane([0.5, 0.5], [2.0, 1.3], z + 0.75);
    rows.plane([2.0, 1.0], [4.0, 3.0], z + 0.5);
    rows
}

#[test]
fn the_floor_of_a_room_is_found_wherever_it_lies() {
    for z in [0.0, -3.0, 1.25, 40.0] {
        let floors = room(z).floors();
        assert_eq!(floors.heights.len(), 1, "{floors:?}");
        assert!((floors.heights[0] - f64::from(z)).abs() < 1e-3, "{floors:?}");
        assert!(floors.has_plane() && floors.cover > 0.85 && floors.below == 0.0, "{floors:?}");
    }
}

#[test]
fn what_lies_below_a_floor_moves_it_not() {
    // Floaters down to 3 m below, a heap 1 m below, a haze as under polished stone, a mirrored bed.
    let mut rows = room(0.0);
    let count = rows.0.len();
    for i in 0..count / 20 {
        let (x, y) = ((i * 37 % 400) as f32 * 0.01, (i * 53 % 300) as f32 * 0.01);
        rows.push([x, y, -0.01 * (i % 300) as f32], [1.0, 0.0, 0.0, 0.0], 0.5);
        rows.push([x, y, -0.1], [1.0, 0.0, 0.0, 0.0], 0.05);
    }
    rows.plane([1.0, 1.0], [1.4, 1.4], -1.0);
    rows.plane([2.0, 1.0], [3.0, 2.0], -0.5);
    let floors = rows.floors();
    assert!(floors.heights[0].abs() < 0.01, "{floors:?}");
    assert!(floors.below > 0.02, "{floors:?}");
    // Where a row in a hundred ends is far from it.
    let mut z: Vec<f32> = rows.0.iter().map(|r| r.coord[2]).collect();
    assert!(quantile(&mut z, 0.01).unwrap() < -0.5);
}

#[test]
fn each_storey_has_its_floor_and_a_ceiling_is_none() {
    let mut rows = room(0.0);
    rows.plane([0.0, 0.0], [4.0, 3.0], 2.5);
    assert_eq!(rows.floors().heights.len(), 1);
    rows.0.extend(room(2.8).0);
    rows.plane([0.0, 0.0], [4.0, 3.0], 5.3);
    let floors = rows.floors();
    assert_eq!(floors.heights.len(), 2, "{floors:?}");
    assert!((floors.heights[1] - 2.8).abs() < 1e-3, "{floors:?}");
    let near = |a: f32, b: f32| (a - b).abs() < 1e-3;
    assert!(near(floors.height(3.55), 0.75) && near(floors.height(2.5), 2.5), "{floors:?}");
    assert!(near(floors.height(2.79), -0.01) && near(floors.height(-1.0), -1.0), "{floors:?}");
}

#[test]
fn a_thin_layer_below_is_no_floor_however_wide() {
    for depth in [0.1, 1.0, 3.0] {
        let mut rows = room(0.0);
        for i in 0..rows.0.len() / 50 {
            let (x, y) = ((i * 37 % 400) as f32 * 0.01, (i * 53 % 300) as f32 * 0.01);
            rows.push([x, y, -depth], [1.0, 0.0, 0.0, 0.0], 0.9);
        }
        let floors = rows.floors();
        assert!(floors.heights[0].abs() < 1e-3, "{depth}: {floors:?}");
    }
}

#[test]
fn beds_on_the_floor_of_a_storey_are_no_floor() {
    let mut rows = room(0.0);
    rows.0.extend(room(2.8).0);
    rows.plane([0.0, 0.0], [1.5, 2.4], 2.8 + 0.48);
    let floors = rows.floors();
    assert_eq!(floors.heights.len(), 2, "{floors:?}");
    assert!((floors.heights[1] - 2.8).abs() < 1e-3, "{floors:?}");
}

#[test]
fn density_and_faintness_do_not_matter() {
    let due = room(0.3).floors().heights;
    for keep in [4, 8] {
        let mut rows = room(0.3);
        let mut i = 0;
        rows.0.retain(|_| {
            i += 1;
            i % keep == 0
        });
        assert!((rows.floors().heights[0] - due[0]).abs() < 1e-3);
    }
    let mut faint = room(0.3);
    faint.0.iter_mut().for_each(|r| r.opacity *= 0.05);
    assert_eq!(faint.floors().heights, due);
    // Balls have no normal: walls count as much as floors do, and the floor is still the fullest.
    let mut balls = room(0.3);
    balls.0.iter_mut().for_each(|r| r.scale = [0.02; 3]);
    assert!((balls.floors().heights[0] - due[0]).abs() < 1e-3);
}

#[test]
fn a_table_with_more_rows_than_the_floor_is_no_floor() {
    let mut rows = room(0.0);
    for _ in 0..20 {
        rows.plane([0.5, 0.5], [2.0, 1.3], 0.75);
    }
    assert!(rows.floors().heights[0].abs() < 1e-3);
}

#[test]
fn without_a_plane_the_ground_is_near_the_lowest() {
    let mut rows = Rows::default();
    for i in 0..2000u16 {
        let z = f32::from(i) * 0.005;
        let at = |m: u16| f32::from(i % m) * 0.1;
        rows.push([at(97), at(89), z], [1.0, 0.0, 0.0, 0.0], 0.9);
    }
    let half = std::f32::consts::FRAC_1_SQRT_2;
    rows.0.iter_mut().for_each(|r| r.quat = [half, half, 0.0, 0.0]);
    let floors = rows.floors();
    assert!(!floors.has_plane(), "{floors:?}");
    assert!((floors.heights[0] - 0.1).abs() < 1e-3, "{floors:?}");
    assert_eq!(Floors::of(0, |_| unreachable!()).heights, [0.0]);
    let mut one = Rows::default();
    one.push([0.0, 0.0, f32::NAN], [0.0; 4], f32::NAN);
    one.push([0.0, 0.0, 2.0], [0.0; 4], 0.5);
    assert_eq!(one.floors().heights, [2.0]);
}

#[test]
fn a_given_floor_is_taken() {
    let floors = Floors::given(1.5);
    assert_eq!((floors.height(2.0), floors.height(1.0)), (0.5, -0.5));
    assert!(floors.given && floors.has_plane());
}
