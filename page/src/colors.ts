// The colour of each Gaussian in each mode.

import type { SceneData } from "./data";
import type { Found } from "./query";

export const MODES = ["colors", "labels", "objects", "confidence", "features"] as const;
export type Mode = (typeof MODES)[number];

/** Viridis at eleven places: light rises evenly, and colour-blind eyes see its order. */
const VIRIDIS = [
  [68, 1, 84], [72, 36, 117], [65, 68, 135], [53, 95, 141], [42, 120, 142], [33, 145, 140],
  [34, 168, 132], [68, 191, 112], [122, 209, 81], [189, 223, 38], [253, 231, 37],
];

export function viridis(t: number): [number, number, number] {
  const at = Math.min(Math.max(t, 0), 1) * 10;
  const i = Math.min(Math.floor(at), 9), f = at - i;
  return [0, 1, 2].map((c) => VIRIDIS[i][c] * (1 - f) + VIRIDIS[i + 1][c] * f) as [number, number, number];
}

const UNLABELLED: [number, number, number] = [110, 110, 118];

/** A colour for a number, far from that of its neighbours. */
export function numberColor(i: number): [number, number, number] {
  const hue = (i * 0.618034) % 1, light = 0.5 + 0.12 * ((i % 3) - 1);
  const a = 0.62 * Math.min(light, 1 - light);
  const f = (n: number) => {
    const k = (n + hue * 12) % 12;
    return 255 * (light - a * Math.max(-1, Math.min(k - 3, 9 - k, 1)));
  };
  return [f(0), f(8), f(4)];
}

export interface Shown {
  mode: Mode;
  /** Classes (+ 1) that are not shown. */
  hidden: Set<number>;
  found: Found | null;
  selected: Uint8Array | null;
  /** Sides of each Gaussian, as bits, and those that are cut away. */
  cut: { sides: Uint8Array; away: number } | null;
}

/** Writes red, green, blue, opacity of every Gaussian. */
export function paint(data: SceneData, shown: Shown, out: Uint8Array): void {
  paintAll(data, shown, out);
  const { cut } = shown;
  if (cut === null || cut.away === 0) return;
  for (let i = 0; i < cut.sides.length; i++) if ((cut.sides[i] & cut.away) !== 0) out[4 * i + 3] = 0;
}

function paintAll(data: SceneData, shown: Shown, out: Uint8Array): void {
  const { count: n, classes } = data.about;
  const { label } = data;
  // Four bytes at once, the lowest first as on every machine that browsers run on.
  const from = new Uint32Array(data.color.buffer, data.color.byteOffset, n);
  const to = new Uint32Array(out.buffer, out.byteOffset, n);
  const opaque = new Uint32Array(classes.length + 1).fill(0xff000000);
  shown.hidden.forEach((h) => (opaque[h] = 0));
  const { found, selected } = shown;
  if (found !== null && selected !== null) {
    paintHeat(data, found.heat, selected, opaque, to);
    return;
  }
  if (shown.mode === "colors") {
    for (let i = 0; i < n; i++) to[i] = from[i] & (opaque[label[i]] | 0xffffff);
    return;
  }
  const own = tableOf(data, shown.mode);
  // Light of the scene keeps shapes apart where colours are one.
  const shades = Float32Array.from({ length: 256 }, (_, light) => 0.6 + (0.55 * light) / 255);
  for (let i = 0; i < n; i++) {
    const c = from[i], v = 3 * own.place(i), shade = shades[lightOf(c)];
    const r = Math.min(255, own.colors[v] * shade), g = Math.min(255, own.colors[v + 1] * shade);
    const b = Math.min(255, own.colors[v + 2] * shade);
    to[i] = (r | (g << 8) | (b << 16)) | (c & opaque[label[i]]);
  }
}

/** How light a colour is, 0..=255. */
function lightOf(color: number): number {
  return (77 * (color & 255) + 150 * ((color >> 8) & 255) + 29 * ((color >> 16) & 255)) >> 8;
}

/** What is selected by its heat, all else grey. */
function paintHeat(data: SceneData, heat: Uint8Array, selected: Uint8Array, opaque: Uint32Array, to: Uint32Array): void {
  const { label, about: { count: n } } = data;
  const from = new Uint32Array(data.color.buffer, data.color.byteOffset, n);
  const grey = Uint32Array.from({ length: 256 }, (_, light) => {
    const v = Math.round(26 + 0.3 * light);
    return v | (v << 8) | ((v + 4) << 16);
  });
  // Grey first, then each heat under each light.
  const table = new Uint32Array(256 * 257);
  table.set(grey);
  for (let v = 0; v < 256; v++) {
    const [r, g, b] = viridis(v / 255);
    for (let light = 0; light < 256; light++) {
      const shade = 0.7 + (0.3 * light) / 255;
      table[256 * (v + 1) + light] = (r * shade) | ((g * shade) << 8) | ((b * shade) << 16);
    }
  }
  for (let i = 0; i < n; i++) {
    const c = from[i], row = selected[i] === 0 ? 0 : heat[i] + 1;
    to[i] = table[256 * row + lightOf(c)] | (c & opaque[label[i]]);
  }
}

/** The colours of a mode, and which of them each Gaussian has. */
function tableOf(data: SceneData, mode: Mode): { colors: Float32Array; place: (i: number) => number } {
  const { label, object, score, slot } = data;
  if (mode === "objects") {
    const colors = new Float32Array(3 * (data.about.objects.length + 1));
    colors.set(UNLABELLED, 0);
    data.about.objects.forEach((_, i) => colors.set(numberColor(i), 3 * (i + 1)));
    return { colors, place: (i) => object[i] };
  }
  if (mode === "confidence") {
    const colors = new Float32Array(3 * 256);
    for (let v = 0; v < 256; v++) colors.set(viridis(v / 255), 3 * v);
    return { colors, place: (i) => (score.length > 0 ? score[i] : 0) };
  }
  if (mode === "features") {
    // What has no code is grey.
    const codes = featureColors(data), none = codes.length / 3;
    const colors = new Float32Array(codes.length + 3);
    colors.set(codes);
    colors.set(UNLABELLED, codes.length);
    return { colors, place: (i) => (slot[i] < none ? slot[i] : none) };
  }
  const colors = new Float32Array(3 * (data.about.classes.length + 1));
  colors.set(UNLABELLED, 0);
  data.about.classes.forEach((c, i) => colors.set(c.color, 3 * (i + 1)));
  return { colors, place: (i) => label[i] };
}

/** The first three code numbers as red, green, blue, each over the middle of its range. */
function featureColors(data: SceneData): Float32Array {
  const { codes } = data;
  const width = codes?.width ?? 0, slots = codes?.rows ?? 0, stride = codes?.stride ?? 0;
  const values = codes?.values ?? new Int8Array(0);
  const out = new Float32Array(3 * Math.max(slots, 1)).fill(127);
  for (let c = 0; c < Math.min(3, width); c++) {
    const counts = new Uint32Array(256);
    for (let s = 0; s < slots; s++) counts[values[s * stride + c] + 128]++;
    const at = (share: number) => {
      let sum = 0, v = 0;
      for (; v < 255; v++) {
        sum += counts[v];
        if (sum > slots * share) break;
      }
      return v - 128;
    };
    const low = at(0.02), high = Math.max(at(0.98), low + 1);
    for (let s = 0; s < slots; s++) {
      const t = (values[s * stride + c] - low) / (high - low);
      out[3 * s + c] = 255 * Math.min(Math.max(t, 0), 1);
    }
  }
  return out;
}
