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
}

/** Writes red, green, blue, opacity of every Gaussian. */
export function paint(data: SceneData, shown: Shown, out: Uint8Array): void {
  const n = data.about.count;
  const { color, label, object, score } = data;
  const classes = data.about.classes;
  const table = new Float32Array(3 * (classes.length + 1));
  table.set(UNLABELLED, 0);
  classes.forEach((c, i) => table.set(c.color, 3 * (i + 1)));
  const objects = new Float32Array(3 * (data.about.objects.length + 1));
  objects.set(UNLABELLED, 0);
  data.about.objects.forEach((_, i) => objects.set(numberColor(i), 3 * (i + 1)));
  const ramp = new Float32Array(256 * 3);
  for (let v = 0; v < 256; v++) ramp.set(viridis(v / 255), 3 * v);
  const features = shown.mode === "features" ? featureColors(data) : null;
  const isHidden = new Uint8Array(classes.length + 1);
  shown.hidden.forEach((h) => (isHidden[h] = 1));
  const { found, selected, mode } = shown;
  // Heat begins at the threshold, so that differences among the selected are seen.
  for (let i = 0; i < n; i++) {
    const at = 4 * i;
    const r = color[at], g = color[at + 1], b = color[at + 2];
    out[at + 3] = isHidden[label[i]] === 1 ? 0 : color[at + 3];
    const light = 0.299 * r + 0.587 * g + 0.114 * b;
    if (found !== null && selected !== null) {
      if (selected[i] === 1) {
        const v = 3 * found.heat[i];
        const shade = 0.7 + 0.3 * (light / 255);
        out[at] = ramp[v] * shade;
        out[at + 1] = ramp[v + 1] * shade;
        out[at + 2] = ramp[v + 2] * shade;
      } else {
        const grey = 26 + 0.3 * light;
        out[at] = grey;
        out[at + 1] = grey;
        out[at + 2] = grey + 4;
      }
      continue;
    }
    if (mode === "colors") {
      out[at] = r;
      out[at + 1] = g;
      out[at + 2] = b;
      continue;
    }
    let from: Float32Array = table, v = 3 * label[i];
    if (mode === "objects") {
      from = objects;
      v = 3 * object[i];
    } else if (mode === "confidence") {
      from = ramp;
      v = score.length > 0 ? 3 * score[i] : 0;
    } else if (features !== null) {
      from = features;
      v = data.slot[i] < features.length / 3 ? 3 * data.slot[i] : 0;
    }
    // Light of the scene keeps shapes apart where colours are one.
    const shade = 0.6 + 0.55 * (light / 255);
    out[at] = Math.min(255, from[v] * shade);
    out[at + 1] = Math.min(255, from[v + 1] * shade);
    out[at + 2] = Math.min(255, from[v + 2] * shade);
  }
}

/** The first three code numbers as red, green, blue, each over the middle of its range. */
function featureColors(data: SceneData): Float32Array {
  const width = data.about.codes?.width ?? 0, slots = data.about.codes?.slots ?? 0;
  const out = new Float32Array(3 * Math.max(slots, 1)).fill(127);
  for (let c = 0; c < Math.min(3, width); c++) {
    const counts = new Uint32Array(256);
    for (let s = 0; s < slots; s++) counts[data.codes[s * width + c] + 128]++;
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
      const t = (data.codes[s * width + c] - low) / (high - low);
      out[3 * s + c] = 255 * Math.min(Math.max(t, 0), 1);
    }
  }
  return out;
}
