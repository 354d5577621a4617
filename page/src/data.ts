// What the page shows: blocks of numbers, and what they mean. They stand in the file as base64 text, each deflated, or
// come in chunks from the program that serves the page, or were made in the page itself.

import { Codes } from "./codes";

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
  groups: { name: string; members: number[]; purposes?: string[] }[];
  /** Articles, and names with their classes, in German and French. */
  foreign: { articles: string[]; names: [string, number][] };
  /** Words that deny what follows. */
  denials: string[];
  /** Words for places, and the relation of objects that they are, if any. */
  places: [string, string | null][];
  codes: { width: number; slots: number } | null;
  hasScores: boolean;
  phrases: number;
  /** What makes labels doubtful. */
  warnings: string[];
  remarks: string[];
  /** Bytes of each chunk of each block, where they are served; else null. */
  chunks: Record<string, number[]> | null;
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
  /** Places of the standard deviations among `scales`, [3, N]. */
  scale: Uint8Array;
  /** Standard deviations, unit of the scene [256]. */
  scales: Float32Array;
  /** w, x, y, z of any length [4, N]. */
  rotation: Int8Array;
  /** Red, green, blue, opacity [N, 4]. */
  color: Uint8Array;
  /** Class + 1 [N], 0 = none. */
  label: Uint16Array;
  /** Place of the score in its range [N], empty without scores. */
  score: Uint8Array;
  /** Object + 1 [N], 0 = none. */
  object: Uint16Array;
  /** Gaussians of each object + 1, of none at 0 [objects + 1]. */
  objectSizes: Uint32Array;
  /** Row of the code of each Gaussian [N]; 2^32 − 1 = none. */
  slot: Uint32Array;
  /** Whether row `i` of the codes is that of Gaussian `i`, for all. */
  ownSlots: boolean;
  /** Language codes of the slots, and how they are compared with texts; null without. */
  codes: Codes | null;
  /** Rows of the scene's file, where some were left out; else empty. */
  rows: Uint32Array;
  phrases: string[];
  /** The four nearest classes of each phrase: class + 1, similarity · 255. [phrases, 8] */
  near: Uint8Array;
}

/** How much has come, 0..=1. */
export type Arrived = (share: number) => void;
/** Blocks that are there already. */
export type Parts = Map<string, Uint8Array>;

/** Where blocks come from. */
class Blocks {
  private done = 0;
  private total: number;

  constructor(
    private chunks: Record<string, number[]> | null, private arrived: Arrived, private parts: Parts | null = null,
  ) {
    const sizes = parts !== null ? [] : chunks === null
      ? Array.from(document.querySelectorAll('script[id^="block-"]'), (e) => e.textContent?.length ?? 0)
      : Object.values(chunks).flat();
    this.total = Math.max(1, sizes.reduce((sum, size) => sum + size, 0));
  }

  async bytes(name: string): Promise<Uint8Array> {
    if (this.parts !== null) return this.parts.get(name) ?? new Uint8Array(0);
    if (this.chunks === null) return this.unpacked(name);
    const sizes = Object.hasOwn(this.chunks, name) ? this.chunks[name] : [];
    const out = new Uint8Array(sizes.reduce((sum, size) => sum + size, 0));
    let at = 0;
    for (const [i, size] of sizes.entries()) {
      out.set(await chunk(name, i, size), at);
      at += size;
      this.add(size);
    }
    return out;
  }

  private async unpacked(name: string): Promise<Uint8Array> {
    const { bytes, length } = await carried(name, "deflate");
    this.add(length);
    return bytes;
  }

  private add(size: number): void {
    this.done += size;
    this.arrived(Math.min(1, this.done / this.total));
  }
}

/** A block that the page carries, and the length of its text; it can be read once. */
export async function carried(name: string, packing: CompressionFormat): Promise<{ bytes: Uint8Array<ArrayBuffer>; length: number }> {
  const element = document.getElementById(`block-${name}`);
  const text = element?.textContent ?? "";
  // Text and bytes need not be there twice.
  element?.remove();
  if (text === "") return { bytes: new Uint8Array(0), length: 0 };
  const binary = atob(text);
  const packed = new Uint8Array(binary.length);
  for (let i = 0; i < packed.length; i++) packed[i] = binary.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream(packing));
  return { bytes: new Uint8Array(await new Response(stream).arrayBuffer()), length: text.length };
}

/** A chunk of a block from the program that serves the page. */
async function chunk(name: string, i: number, size: number): Promise<Uint8Array> {
  let response: Response;
  try {
    response = await fetch(`chunk/${name}/${i}`, { cache: "no-store", credentials: "omit", redirect: "error" });
  } catch {
    throw new Error("the program that serves this page does not answer; is it still running?");
  }
  if (!response.ok) throw new Error(`the program that serves this page says ${response.status}`);
  const bytes = new Uint8Array(await response.arrayBuffer());
  if (bytes.length !== size) throw new Error(`a part of ${name} is cut: ${bytes.length} of ${size} bytes`);
  return bytes;
}

/** Planes of bytes, the lowest first, as numbers. */
function planes<T extends Uint32Array | Uint16Array>(from: Uint8Array, out: T, bytesEach: number): T {
  const count = out.length;
  // What is not there is 0.
  if (from.length === 0) return out;
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

export async function readAbout(parts: Parts | null = null): Promise<About> {
  const bytes = await new Blocks(null, () => undefined, parts).bytes("about");
  return JSON.parse(new TextDecoder().decode(bytes)) as About;
}

export async function readScene(about: About, arrived: Arrived, parts: Parts | null = null): Promise<SceneData> {
  const n = about.count;
  const blocks = new Blocks(about.chunks, arrived, parts);
  const placed = await blocks.bytes("position");
  const position = new Float32Array(3 * n);
  for (let axis = 0; axis < 3; axis++) {
    const [low, middle, high] = [0, 1, 2].map((b) => placed.subarray((3 * b + axis) * n, (3 * b + axis + 1) * n));
    for (let i = 0; i < n; i++) {
      position[3 * i + axis] = about.origin[axis] + about.step * (low[i] + 256 * middle[i] + 65_536 * high[i]);
    }
  }
  const [least, most] = about.scaleRange;
  const scales = Float32Array.from({ length: 256 }, (_, v) => Math.exp(least + ((most - least) * v) / 255));
  const scale = await blocks.bytes("scale");
  const rotation = new Int8Array((await blocks.bytes("rotation")).buffer);
  const paint = await blocks.bytes("color");
  const color = new Uint8Array(4 * n);
  for (let c = 0; c < 4; c++) for (let i = 0; i < n; i++) color[4 * i + c] = paint[c * n + i];
  const object = planes(await blocks.bytes("object"), new Uint16Array(n), 2);
  const objectSizes = new Uint32Array(about.objects.length + 1);
  for (let i = 0; i < n; i++) objectSizes[object[i]]++;
  const texts = floats(await blocks.bytes("texts"));
  const packed = new Int8Array((await blocks.bytes("codes")).buffer);
  const slot = planes(await blocks.bytes("slot"), new Uint32Array(about.codes === null ? 0 : n), 4);
  return {
    about,
    position,
    scale,
    scales,
    rotation,
    color,
    label: planes(await blocks.bytes("label"), new Uint16Array(n), 2),
    score: await blocks.bytes("score"),
    object,
    objectSizes,
    slot,
    ownSlots: about.codes?.slots === n && slot.every((s, i) => s === i),
    codes: about.codes === null ? null
      : new Codes(packed, about.codes.slots, about.codes.width, texts, about.classes.length),
    rows: planes(await blocks.bytes("rows"), new Uint32Array(about.count < about.total ? n : 0), 4),
    phrases: about.phrases > 0 ? new TextDecoder().decode(await blocks.bytes("phrases")).split("\n") : [],
    near: await blocks.bytes("near"),
  };
}

/** Standard deviations of a Gaussian. */
export function scaleOf(data: SceneData, row: number): [number, number, number] {
  const { scale, scales, about: { count: n } } = data;
  return [scales[scale[row]], scales[scale[n + row]], scales[scale[2 * n + row]]];
}

/** w, x, y, z of a Gaussian, of length 1. */
export function rotationOf(data: SceneData, row: number): [number, number, number, number] {
  const { rotation: r, about: { count: n } } = data;
  const w = r[row], x = r[n + row], y = r[2 * n + row], z = r[3 * n + row];
  const length = Math.hypot(w, x, y, z);
  return length > 0 ? [w / length, x / length, y / length, z / length] : [1, 0, 0, 0];
}
