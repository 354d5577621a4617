//! What surfaces are made of: named colors and textures.

use crate::dice::{between, chance, pick, scramble, smooth_noise, whole};
use crate::vector::{V3, mix};
use scenesplat_kernels::random::SampleRng;

/// A basic color word of English, as objects are described by.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum ColorName {
    /// Light, without hue.
    White,
    /// Dark, without hue.
    Black,
    /// Between black and white.
    Grey,
    /// Dark orange; most wood.
    Brown,
    /// Light brown; light wood.
    Beige,
    /// Hue around 0°.
    Red,
    /// Hue around 25°.
    Orange,
    /// Hue around 50°.
    Yellow,
    /// Hue around 120°.
    Green,
    /// Hue around 220°.
    Blue,
    /// Hue around 280°.
    Purple,
    /// Light red.
    Pink,
}

impl ColorName {
    /// All of them, in the order of their declaration.
    pub const ALL: [Self; 12] = [
        Self::White,
        Self::Black,
        Self::Grey,
        Self::Brown,
        Self::Beige,
        Self::Red,
        Self::Orange,
        Self::Yellow,
        Self::Green,
        Self::Blue,
        Self::Purple,
        Self::Pink,
    ];

    /// The word, in lower case.
    pub fn word(self) -> &'static str {
        COLORS[self as usize].0
    }

    /// The name whose middle color is the nearest, sRGB 0..=255.
    pub(crate) fn nearest(color: V3) -> Self {
        let far = |name: Self| {
            let (from, to) = name.range();
            let middle = mix(from, to, 0.5);
            (0..3).map(|i| (middle[i] - color[i]) * (middle[i] - color[i])).sum::<f64>()
        };
        let first = (Self::White, far(Self::White));
        let all = Self::ALL.into_iter().map(|name| (name, far(name)));
        all.fold(first, |best, next| if next.1 < best.1 { next } else { best }).0
    }

    /// A color of this name, sRGB 0..=255.
    pub(crate) fn sample(self, rng: &mut SampleRng) -> V3 {
        let (from, to) = self.range();
        mix(from, to, between(rng, 0.0, 1.0)).map(|c| c + between(rng, -5.0, 5.0))
    }

    /// Darkest and lightest color of this name.
    fn range(self) -> (V3, V3) {
        let (_, from, to) = COLORS[self as usize];
        (from, to)
    }
}

/// The word of each name, its darkest and its lightest color, in the order of [`ColorName::ALL`].
const COLORS: [(&str, V3, V3); 12] = [
    ("white", [222.0, 220.0, 214.0], [250.0, 250.0, 248.0]),
    ("black", [18.0, 18.0, 20.0], [48.0, 46.0, 46.0]),
    ("grey", [88.0, 88.0, 90.0], [172.0, 172.0, 176.0]),
    ("brown", [78.0, 46.0, 24.0], [154.0, 104.0, 64.0]),
    ("beige", [190.0, 166.0, 128.0], [228.0, 208.0, 176.0]),
    ("red", [136.0, 18.0, 22.0], [206.0, 54.0, 48.0]),
    ("orange", [206.0, 98.0, 20.0], [240.0, 144.0, 58.0]),
    ("yellow", [208.0, 170.0, 26.0], [244.0, 216.0, 96.0]),
    ("green", [30.0, 84.0, 40.0], [118.0, 164.0, 92.0]),
    ("blue", [22.0, 48.0, 106.0], [92.0, 144.0, 204.0]),
    ("purple", [76.0, 36.0, 108.0], [148.0, 104.0, 178.0]),
    ("pink", [218.0, 130.0, 150.0], [242.0, 186.0, 198.0]),
];

/// How color varies over a surface. Lengths in meters.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Texture {
    Plain,
    /// Soft spots of this size: plaster, stone, velvet.
    Mottled(f64),
    /// Long fibres of this width along the first direction.
    Grain(f64),
    /// Boards of this width and length, each its own shade, with joints.
    Boards(f64, f64),
    /// Tiles of this size with joints of the second color.
    Tiles(f64),
    /// Squares of two colors.
    Checks(f64),
    /// Stripes of two colors across the first direction.
    Stripes(f64),
    /// Upright stripes, each in a color of its own: backs of books.
    Books(f64),
    /// Blots of three colors: a painting.
    Painting(f64),
    /// Dark grid on keys of this size.
    Keys(f64),
    /// Bright windows and lines on a dark ground of this size.
    Screen(f64),
    /// A light from one side to the other: glass, mirrors.
    Sheen(f64),
}

/// Colors and texture of a surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Material {
    /// Main color, sRGB 0..=255.
    pub(crate) base: V3,
    /// Second color of the texture.
    pub(crate) second: V3,
    pub(crate) texture: Texture,
    /// Makes textures of equal materials differ.
    pub(crate) salt: u32,
}

impl Material {
    pub(crate) fn new(base: V3, texture: Texture, rng: &mut SampleRng) -> Self {
        let second = base.map(|c| c * 0.72);
        Self { base, second, texture, salt: whole(rng, 0, 1 << 30) }
    }

    pub(crate) fn plain(base: V3) -> Self {
        Self { base, second: base, texture: Texture::Plain, salt: 0 }
    }

    pub(crate) fn with_second(self, second: V3) -> Self {
        Self { second, ..self }
    }

    /// The same, darker or lighter.
    pub(crate) fn shaded(self, by: f64) -> Self {
        Self { base: self.base.map(|c| c * by), second: self.second.map(|c| c * by), ..self }
    }

    /// Color at a place of the surface, sRGB; may leave 0..=255 a little.
    pub(crate) fn color_at(&self, [s, t]: [f64; 2]) -> V3 {
        let shade = |by: f64| self.base.map(|c| c + by);
        let either =
            |place: f64| if place.rem_euclid(2.0) >= 1.0 { self.second } else { self.base };
        let noise = |s, t, salt| smooth_noise(s, t, self.salt ^ salt);
        match self.texture {
            Texture::Plain => self.base,
            Texture::Mottled(size) => {
                let coarse = noise(s / size, t / size, 0);
                let fine = noise(3.1 * s / size, 3.1 * t / size, 1);
                shade(26.0 * (coarse - 0.5) + 12.0 * (fine - 0.5))
            }
            Texture::Grain(width) => {
                let fibre = noise(s / (14.0 * width), t / width, 0);
                let fine = noise(s / (30.0 * width), 3.3 * t / width, 1);
                mix(self.base, self.second, 0.55 * fibre + 0.35 * fine)
            }
            Texture::Boards(width, length) => {
                self.board([s, t], [width, length], noise(s / 0.4, t / 0.02, 2))
            }
            Texture::Tiles(size) => {
                let (x, y) = (s / size, t / size);
                let (column, row) = (x.floor(), y.floor());
                let joint = 0.02_f64.max(0.006 / size);
                if x - column < joint || y - row < joint {
                    return self.second;
                }
                shade(14.0 * (scramble(column as i64, row as i64, self.salt) - 0.5))
            }
            Texture::Checks(size) => either((s / size).floor() + (t / size).floor()),
            Texture::Stripes(width) => either((s / width).floor()),
            Texture::Books(width) => {
                // Some books are wider: neighbors share a place.
                let place = (s / width + 0.6 * noise(s / width, 0.0, 0)).floor() as i64;
                let channel = |k| 30.0 + 200.0 * scramble(place, k, self.salt);
                [channel(1), channel(2), channel(3)]
            }
            Texture::Painting(size) => {
                let a = noise(s / size, t / size, 0);
                let b = noise(2.3 * s / size, 2.3 * t / size, 5);
                let third = [self.second[2], self.base[0], self.base[1]];
                let ground = if a > 0.52 { self.second } else { self.base };
                mix(ground, third, if b > 0.6 { 0.8 } else { 0.25 * b })
            }
            Texture::Keys(size) => {
                let gap = |v: f64| v / size - (v / size).floor() < 0.22;
                if gap(s) || gap(t) { self.second } else { self.base }
            }
            Texture::Screen(size) => self.screen(s / size, t / size, 8.0 * t / size),
            Texture::Sheen(size) => {
                let a = noise((s + t) / size, (s - t) / (3.0 * size), 0);
                mix(self.base, self.second, a)
            }
        }
    }

    fn board(&self, [s, t]: [f64; 2], [width, length]: [f64; 2], fibre: f64) -> V3 {
        let row = (t / width).floor();
        let shifted = s / length + scramble(row as i64, 7, self.salt);
        let tone = scramble(row as i64, shifted.floor() as i64, self.salt);
        let joint = t / width - row < 0.012 / width || shifted - shifted.floor() < 0.01;
        mix(self.base, self.second, 0.6 * tone + 0.3 * fibre)
            .map(|c| c * if joint { 0.75 } else { 1.0 })
    }

    /// A window of a screen, lit or not, with lines in it.
    fn screen(&self, column: f64, row: f64, line: f64) -> V3 {
        let lit = scramble(column.floor() as i64, row.floor() as i64, self.salt);
        if lit < 0.45 {
            return self.base;
        }
        let is_line = line.floor().rem_euclid(2.0) < 1.0;
        mix(self.base, self.second, if is_line { lit } else { 0.4 * lit })
    }
}

/// A material and what its color is called.
pub(crate) type Named = (ColorName, Material);

fn woven(rng: &mut SampleRng) -> Texture {
    match whole(rng, 0, 7) {
        0 => Texture::Stripes(between(rng, 0.03, 0.12)),
        1 => Texture::Checks(between(rng, 0.04, 0.12)),
        2 | 3 => Texture::Mottled(between(rng, 0.03, 0.2)),
        _ => Texture::Plain,
    }
}

/// Cloth of any color, sometimes patterned.
pub(crate) fn fabric(rng: &mut SampleRng) -> Named {
    let name = pick(rng, &ColorName::ALL);
    let base = name.sample(rng);
    let texture = woven(rng);
    let other = if chance(rng, 0.5) { base.map(|c| c * 0.7) } else { mix(base, [235.0; 3], 0.6) };
    (name, Material::new(base, texture, rng).with_second(other))
}

/// Wood, or boards painted.
pub(crate) fn wood(rng: &mut SampleRng) -> Named {
    use ColorName::{Beige, Black, Brown, Grey, White};
    let name = pick(rng, &[Brown, Brown, Brown, Beige, Beige, White, White, Grey, Black]);
    let base = name.sample(rng);
    let grain = if matches!(name, Brown | Beige) || chance(rng, 0.3) {
        Texture::Grain(between(rng, 0.008, 0.03))
    } else {
        Texture::Plain
    };
    (name, Material::new(base, grain, rng).with_second(base.map(|c| c * between(rng, 0.68, 0.88))))
}

/// Painted or moulded: any color, plain, with more white, black and gray.
pub(crate) fn painted(rng: &mut SampleRng) -> Named {
    use ColorName::{Black, Grey, White};
    let name = if chance(rng, 0.6) {
        pick(rng, &[White, Black, Grey])
    } else {
        pick(rng, &ColorName::ALL)
    };
    (name, Material::plain(name.sample(rng)))
}

/// Metal: gray, black, or brass.
pub(crate) fn metal(rng: &mut SampleRng) -> Named {
    use ColorName::{Black, Grey, White, Yellow};
    let name = pick(rng, &[Grey, Grey, Black, White, Yellow]);
    let base = if name == Yellow { [176.0, 146.0, 84.0] } else { name.sample(rng) };
    let second = mix(base, [240.0; 3], 0.4);
    (name, Material::new(base, Texture::Sheen(between(rng, 0.05, 0.3)), rng).with_second(second))
}

/// Sanitary ware: white, rarely tinted.
pub(crate) fn ceramic(rng: &mut SampleRng) -> Named {
    use ColorName::{Beige, Grey, Pink, White};
    let name = pick(rng, &[White, White, White, White, White, White, Beige, Grey, Pink]);
    (name, Material::plain(name.sample(rng)))
}

/// Dark electronics, sometimes gray or white.
pub(crate) fn casing(rng: &mut SampleRng) -> Named {
    use ColorName::{Black, Grey, White};
    let name = pick(rng, &[Black, Black, Black, Grey, White]);
    (name, Material::plain(name.sample(rng)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::sample_rng;

    #[test]
    fn colors_stay_near_the_byte_range() {
        let mut rng = sample_rng(1, 0, 0);
        let textures = [
            Texture::Plain,
            Texture::Mottled(0.1),
            Texture::Grain(0.01),
            Texture::Boards(0.15, 1.2),
            Texture::Tiles(0.3),
            Texture::Checks(0.2),
            Texture::Stripes(0.05),
            Texture::Books(0.03),
            Texture::Painting(0.2),
            Texture::Keys(0.02),
            Texture::Screen(0.1),
            Texture::Sheen(0.4),
        ];
        for name in ColorName::ALL {
            for texture in textures {
                let material = Material::new(name.sample(&mut rng), texture, &mut rng);
                for _ in 0..50 {
                    let at = [between(&mut rng, -3.0, 3.0), between(&mut rng, -3.0, 3.0)];
                    let color = material.color_at(at);
                    assert!(color.iter().all(|c| (-30.0..290.0).contains(c)), "{color:?}");
                }
            }
        }
    }

    #[test]
    fn names_tell_samples_apart() {
        // The nearest name by mean color is the right one for most samples.
        let mut rng = sample_rng(2, 0, 0);
        let mean = |name: ColorName, rng: &mut SampleRng| {
            (0..200).fold([0.0; 3], |s: V3, _| {
                let c = name.sample(rng);
                std::array::from_fn(|i| s[i] + c[i] / 200.0)
            })
        };
        let means: Vec<V3> = ColorName::ALL.iter().map(|&n| mean(n, &mut rng)).collect();
        for (i, name) in ColorName::ALL.iter().enumerate() {
            let right = (0..200)
                .filter(|_| {
                    let c = name.sample(&mut rng);
                    let far = |m: &V3| (0..3).map(|a| (m[a] - c[a]) * (m[a] - c[a])).sum::<f64>();
                    let best =
                        (0..means.len()).min_by(|&a, &b| far(&means[a]).total_cmp(&far(&means[b])));
                    best == Some(i)
                })
                .count();
            assert!(right > 130, "{} {right}", name.word());
        }
    }
}
