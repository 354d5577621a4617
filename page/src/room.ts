// The sides of a room that hide it from outside: walls and ceiling between the camera and what stands in the room.

import { isKind } from "./classes";
import { scaleOf, type SceneData } from "./data";

/** What is cut away with the wall that it is in or hangs on, where the scene has labels. */
const ON_WALLS = ["wall", "window", "door", "curtain", "picture", "mirror"];
/** Part of the surface that lies beyond each side of the box. */
const BEYOND = 0.02;
/** A wall is so deep on either side of the box, in units of the shortest side. */
const DEPTH = 0.08;
/** Cells along each side of a wall whose coverage is counted, without those at its edges, where other walls are. */
const CELLS = 8;
/** The part of them that makes it a wall: what has the label of one is one where little of it was seen. */
const COVERED = { labeled: 0.15, unlabeled: 0.5 };
/** Walls and ceiling that a scene without labels needs besides a floor, and corners: a lone object is rounder. */
const LEAST_SIDES = 3, LEAST_CORNERS = 3;
/** A corner reaches so far, in units of each side, and holds so much of the surface. */
const CORNER = 1 / 12, CORNER_SHARE = 0.002;
/** Gaussians that are looked at for the box, and those that stand for all. */
const MOST_ROWS = 40_000, SAMPLE = 4096;
/** Walls whose turn saves less ground than this are taken to lie along the axes. */
const ASKEW = 0.97;

type Vector = [number, number, number];

/** Sides in the order of their bits, low and high along both level axes, and above; then the floor, which stays. */
const SIDES: readonly [axis: 0 | 1 | 2, way: -1 | 1][] = [[0, -1], [0, 1], [1, -1], [1, 1], [2, 1], [2, -1]];
const ABOVE = 4, FLOOR = 5;

/** Part of the picture that the first view fills. */
const FILLED = 0.94;

export interface Box {
  /** How the walls are turned about the vertical, radians. */
  yaw: number;
  /** Corners along the axes of the room, meters; z is up. */
  low: Vector;
  high: Vector;
}

export interface Room extends Box {
  /** The sides that are walls or a ceiling, a bit for each. */
  mask: number;
  /** The sides that each Gaussian is cut away with, a bit for each. [N] */
  sides: Uint8Array;
}

/** The sides that an eye is beyond, as bits: none from inside. `eye`: meters, z up. */
export function facing(room: Room, eye: readonly number[]): number {
  const at = turned(eye, room.yaw);
  let bits = 0;
  for (let s = 0; s < FLOOR; s++) if (beyond(room, s, at) > 0) bits |= 1 << s;
  return bits & room.mask;
}

/** From how far the whole box is in the picture. `yaw`, `pitch`: where the camera looks, radians; `slopes`: half the width
 * and half the height of the picture at a distance of 1. */
export function wholeFrom(box: Box, yaw: number, pitch: number, slopes: readonly [number, number]): number {
  const half = [0, 1, 2].map((a) => (box.high[a] - box.low[a]) / 2);
  let most = 0;
  for (let corner = 0; corner < 8; corner++) {
    const p = half.map((h, a) => ((corner >> a) & 1 ? h : -h));
    // The first axis is where the camera looks in plan, the second is to its left.
    const [along, left, z] = turned(p, yaw - box.yaw);
    const ahead = along * Math.cos(pitch) + z * Math.sin(pitch), up = z * Math.cos(pitch) - along * Math.sin(pitch);
    most = Math.max(most, Math.abs(left) / (FILLED * slopes[0]) - ahead, Math.abs(up) / (FILLED * slopes[1]) - ahead);
  }
  return most;
}

/** The room that a scene is, or null for one without walls and ceiling. */
export function roomOf(data: SceneData): Room | null {
  const level = axesOf(data, 0);
  const points = sample(data).map((row) => placeOf(data, level, row, [0, 0, 0]));
  if (points.length === 0) return null;
  const yaw = yawOf(points);
  const inside = points.map((p) => turned(p, yaw));
  const spans = spansOf(inside, [0, 1, 2]);
  const box = { yaw, low: spans.map((s) => s[0]) as Vector, high: spans.map((s) => s[1]) as Vector };
  const depth = DEPTH * Math.min(...spans.map((s) => s[1] - s[0]));
  if (!(depth > 0)) return null;
  const labeled = data.about.classes.some((c) => c.count > 0 && isKind(c.name, ["wall", "ceiling"]));
  const { sides, shares } = sidesOf(data, box, depth, labeled);
  const least = labeled ? COVERED.labeled : COVERED.unlabeled;
  let mask = 0, count = 0;
  for (let s = 0; s < FLOOR; s++) {
    if (shares[s] < least) continue;
    mask |= 1 << s;
    count++;
  }
  if (mask === 0) return null;
  if (!labeled && (shares[FLOOR] < least || count < LEAST_SIDES || cornersOf(box, inside) < LEAST_CORNERS)) return null;
  for (let i = 0; i < sides.length; i++) sides[i] &= mask;
  return { ...box, mask, sides };
}

/** The sides that each Gaussian belongs to, and how much of each side they cover. */
function sidesOf(data: SceneData, box: Box, depth: number, labeled: boolean): { sides: Uint8Array; shares: number[] } {
  const { about: { count: n, classes }, label, color } = data;
  // What has no label may be part of any side.
  const are = (kinds: string[]) => [true, ...classes.map((c) => !labeled || isKind(c.name, kinds))];
  const onWall = are(ON_WALLS), onTop = are(["ceiling"]);
  // Ceilings of other rooms may be lower.
  const ceiling = classes.map((c) => isKind(c.name, ["ceiling"]));
  const half = (box.low[2] + box.high[2]) / 2;
  const axes = axesOf(data, box.yaw), p: Vector = [0, 0, 0];
  const sides = new Uint8Array(n);
  const cells = SIDES.map(() => new Uint8Array(CELLS * CELLS));
  for (let i = 0; i < n; i++) {
    if (color[4 * i + 3] < 12) continue;
    placeOf(data, axes, i, p);
    const l = label[i];
    for (let s = 0; s < SIDES.length; s++) {
      const over = beyond(box, s, p);
      // Beyond the wall nothing belongs to the room.
      const is = over > depth || (over > -depth && (s === FLOOR || (s === ABOVE ? onTop : onWall)[l]))
        || (s === ABOVE && l > 0 && ceiling[l - 1] && p[2] > half);
      if (!is) continue;
      sides[i] |= 1 << s;
      const cell = cellOf(box, SIDES[s][0], p);
      if (cell >= 0) cells[s][cell] = 1;
    }
  }
  return { sides, shares: cells.map((c) => c.reduce((sum, is) => sum + is, 0) / c.length) };
}

/** In how many corners of the plan there is something. */
function cornersOf({ low, high }: Box, points: Vector[]): number {
  const counts = [0, 0, 0, 0];
  for (const p of points) {
    const [x, y] = [0, 1].map((a) => (p[a] - low[a]) / (high[a] - low[a]));
    if (Math.min(x, 1 - x) < CORNER && Math.min(y, 1 - y) < CORNER) counts[(x > 0.5 ? 1 : 0) + (y > 0.5 ? 2 : 0)]++;
  }
  return counts.filter((c) => c >= CORNER_SHARE * points.length).length;
}

/** How far a place is beyond a side; below 0 before it. */
function beyond(box: Box, side: number, p: Vector): number {
  const [axis, way] = SIDES[side];
  return way < 0 ? box.low[axis] - p[axis] : p[axis] - box.high[axis];
}

/** The cell of a side that a place lies before, −1 beside it or at its edge. */
function cellOf({ low, high }: Box, axis: 0 | 1 | 2, p: Vector): number {
  const at = (a: number) => Math.floor(((CELLS + 2) * (p[a] - low[a])) / (high[a] - low[a])) - 1;
  const u = at(axis === 0 ? 1 : 0), v = at(axis === 2 ? 1 : 2);
  return u >= 0 && u < CELLS && v >= 0 && v < CELLS ? u * CELLS + v : -1;
}

/** How walls are turned: the box that needs least ground, radians within a quarter turn. */
function yawOf(points: Vector[]): number {
  const some = points.filter((_, i) => i % 4 === 0);
  const ground = (degrees: number) => {
    const [x, y] = spansOf(some.map((p) => turned(p, (degrees * Math.PI) / 180)), [0, 1]);
    return (x[1] - x[0]) * (y[1] - y[0]);
  };
  let best = 0, least = ground(0) * ASKEW;
  for (let degrees = -45; degrees < 45; degrees++) {
    const area = ground(degrees);
    if (area < least) [best, least] = [degrees, area];
  }
  return (best * Math.PI) / 180;
}

/** From where to where most of the points lie along some axes. */
function spansOf(points: Vector[], axes: number[]): [number, number][] {
  return axes.map((axis) => {
    const values = Float64Array.from(points, (p) => p[axis]).sort();
    const at = (share: number) => values[Math.round((values.length - 1) * share)];
    return [at(BEYOND), at(1 - BEYOND)];
  });
}

/** Rows of Gaussians that stand for what is seen: each as often as it has surface and opacity. */
function sample(data: SceneData): number[] {
  const step = Math.max(1, Math.floor(data.about.count / MOST_ROWS));
  const rows: number[] = [], weights: number[] = [];
  for (let i = 0; i < data.about.count; i += step) {
    const scale = scaleOf(data, i);
    rows.push(i);
    weights.push((data.color[4 * i + 3] * scale[0] * scale[1] * scale[2]) / Math.min(...scale));
  }
  // A few Gaussians can be as large as the sky.
  const most = Float64Array.from(weights).sort()[Math.floor(0.9 * weights.length)] ?? 0;
  const each = weights.reduce((sum, w) => sum + Math.min(w, most), 0) / SAMPLE;
  if (!(each > 0)) return [];
  const out: number[] = [];
  let sum = each / 2;
  rows.forEach((row, k) => {
    for (sum += Math.min(weights[k], most); sum >= each; sum -= each) out.push(row);
  });
  return out;
}

/** Axes that are turned about the vertical, in the frame and unit of the scene. */
function axesOf({ about: { up, metresPerUnit } }: SceneData, yaw: number): Vector[] {
  const columns = [0, 1, 2].map((c) => turned(up.map((row) => row[c] * metresPerUnit), yaw));
  return [0, 1, 2].map((a) => columns.map((column) => column[a]) as Vector);
}

/** The place of a Gaussian along axes. */
function placeOf({ position }: SceneData, axes: Vector[], row: number, out: Vector): Vector {
  for (let a = 0; a < 3; a++) {
    const axis = axes[a];
    out[a] = axis[0] * position[3 * row] + axis[1] * position[3 * row + 1] + axis[2] * position[3 * row + 2];
  }
  return out;
}

/** A place along axes that are turned about the vertical. */
function turned(p: readonly number[], yaw: number): Vector {
  const c = Math.cos(yaw), s = Math.sin(yaw);
  return [c * p[0] + s * p[1], c * p[1] - s * p[0], p[2]];
}
