// What the page carries: blocks of base64 text, each deflated, and what they mean.

/** What `about` says; all lengths in the unit of the scene unless they say metres. */
export interface About {
  version: number;
  title: string;
  count: number;
  /** Gaussians of the scene that the page was made from. */
  total: number;
  up: number[][];
  metresPerUnit: number;
  /** Lowest corner and step of the positions. */
  origin: number[];
  step: number;
  scaleRange: [number, number];
  classes: ClassEntry[];
  objects: ObjectEntry[];
  /** [object, relation, object], places in `objects`. */
  relations: [number, string, number][];
  texts: string[];
  colorWords: string[];
  groups: { name: string; members: number[] }[];
  codes: { width: number; slots: number } | null;
  hasScores: boolean;
  phrases: number;
  remarks: string[];
}

export interface ClassEntry {
  name: string;
  color: [number, number, number];
  count: number;
}

export interface ObjectEntry {
  id: number;
  label: number;
  score: number | null;
  count: number;
  position: number[];
  corners: number[][];
  size: number[];
  volume: number;
  aboveFloor: number;
  wallDistance: number | null;
}

export interface SceneData {
  about: About;
  /** [N, 3], frame and unit of the scene. */
  position: Float32Array;
  /** Standard deviations [N, 3], unit of the scene. */
  scale: Float32Array;
  /** x, y, z, w [N, 4]. */
  rotation: Float32Array;
  /** Red, green, blue, opacity [N, 4]. */
  color: Uint8Array;
  /** Class + 1 [N], 0 = none. */
  label: Uint16Array;
  /** Place of the score in its range [N], empty without scores. */
  score: Uint8Array;
  /** Object + 1 [N], 0 = none. */
  object: Uint16Array;
  /** Row of the code of each Gaussian [N]; 2^32 − 1 = none. */
  slot: Uint32Array;
  /** [slots, width] */
  codes: Int8Array;
  /** Best score of any class of each slot [slots]. */
  best: Float32Array;
  /** Offset and one weight a code number [texts, 1 + width]. */
  texts: Float32Array;
  /** Rows of the scene's file, where some were left out; else empty. */
  rows: Uint32Array;
  phrases: string[];
  /** The four nearest classes of each phrase: class + 1, similarity · 255. [phrases, 8] */
  near: Uint8Array;
}

async function bytes(name: string): Promise<Uint8Array> {
  const element = document.getElementById(`block-${name}`);
  const text = element?.textContent ?? "";
  // Text and bytes need not be there twice.
  element?.remove();
  if (text === "") return new Uint8Array(0);
  const binary = atob(text);
  const packed = new Uint8Array(binary.length);
  for (let i = 0; i < packed.length; i++) packed[i] = binary.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Planes of bytes, the lowest first, as numbers. */
function planes(from: Uint8Array, count: number, bytesEach: number): Uint32Array {
  const out = new Uint32Array(count);
  for (let b = 0; b < bytesEach; b++) {
    const plane = from.subarray(b * count, (b + 1) * count);
    const factor = 2 ** (8 * b);
    for (let i = 0; i < count; i++) out[i] += plane[i] * factor;
  }
  return out;
}

function floats(from: Uint8Array): Float32Array {
  return new Float32Array(from.buffer, from.byteOffset, from.byteLength / 4);
}

export async function readAbout(): Promise<About> {
  return JSON.parse(new TextDecoder().decode(await bytes("about"))) as About;
}

export async function readScene(about: About): Promise<SceneData> {
  const n = about.count;
  const placed = planes(await bytes("position"), 3 * n, 3);
  const position = new Float32Array(3 * n);
  for (let axis = 0; axis < 3; axis++) {
    for (let i = 0; i < n; i++) {
      position[3 * i + axis] = about.origin[axis] + about.step * placed[axis * n + i];
    }
  }
  const [low, high] = about.scaleRange;
  const logs = await bytes("scale");
  const scales = new Float32Array(256);
  for (let v = 0; v < 256; v++) scales[v] = Math.exp(low + ((high - low) * v) / 255);
  const scale = new Float32Array(3 * n);
  for (let axis = 0; axis < 3; axis++) {
    for (let i = 0; i < n; i++) scale[3 * i + axis] = scales[logs[axis * n + i]];
  }
  const turns = new Int8Array((await bytes("rotation")).buffer);
  const rotation = new Float32Array(4 * n);
  for (let i = 0; i < n; i++) {
    const w = turns[i], x = turns[n + i], y = turns[2 * n + i], z = turns[3 * n + i];
    const length = Math.hypot(w, x, y, z) || 1;
    rotation[4 * i] = x / length;
    rotation[4 * i + 1] = y / length;
    rotation[4 * i + 2] = z / length;
    rotation[4 * i + 3] = length === 1 && w === 0 && x === 0 && y === 0 && z === 0 ? 1 : w / length;
  }
  const paint = await bytes("color");
  const color = new Uint8Array(4 * n);
  for (let c = 0; c < 4; c++) for (let i = 0; i < n; i++) color[4 * i + c] = paint[c * n + i];
  const width = about.codes?.width ?? 0;
  const slots = about.codes?.slots ?? 0;
  const texts = floats(await bytes("texts"));
  const codes = new Int8Array((await bytes("codes")).buffer);
  return {
    about,
    position,
    scale,
    rotation,
    color,
    label: Uint16Array.from(planes(await bytes("label"), n, 2)),
    score: await bytes("score"),
    object: Uint16Array.from(planes(await bytes("object"), n, 2)),
    slot: slots > 0 ? planes(await bytes("slot"), n, 4) : new Uint32Array(0),
    codes,
    best: bestScores(codes, slots, width, texts, about.classes.length),
    texts,
    rows: about.count < about.total ? planes(await bytes("rows"), n, 4) : new Uint32Array(0),
    phrases: about.phrases > 0 ? new TextDecoder().decode(await bytes("phrases")).split("\n") : [],
    near: await bytes("near"),
  };
}

/** The best score of any class in each slot; texts begin with the classes. */
function bestScores(
  codes: Int8Array, slots: number, width: number, texts: Float32Array, classes: number,
): Float32Array {
  const best = new Float32Array(slots).fill(-1);
  const known = Math.min(classes, texts.length / (width + 1));
  for (let c = 0; c < known; c++) {
    const row = texts.subarray(c * (width + 1), (c + 1) * (width + 1));
    for (let s = 0, at = 0; s < slots; s++) {
      let sum = row[0];
      for (let j = 1; j <= width; j++) sum += row[j] * codes[at++];
      if (sum > best[s]) best[s] = sum;
    }
  }
  return best;
}
