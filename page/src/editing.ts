// Selections made larger and smaller, and what undo goes back to.

import type { SceneData } from "./data";

/** How far one step grows or shrinks, meters. */
export const REACH = 0.05;
/** The part of the scene's longest side that a step is at most: small things are edited finely. */
const SHARE = 0.02;

/** Cells that a step reaches: their places in a ball of two cells. */
const BALL: [number, number, number][] = [];
for (let x = -2; x <= 2; x++) for (let y = -2; y <= 2; y++) for (let z = -2; z <= 2; z++) {
  if (x * x + y * y + z * z <= 4) BALL.push([x, y, z]);
}

/** Gaussians by cells of half a step. */
interface Cells {
  /** Cell of each Gaussian. */
  of: Uint32Array;
  count: number;
  /** Cells in the ball of a cell, with itself. */
  near(cell: number): number[];
}

const known = new WeakMap<SceneData, Cells>();

function cellsOf(data: SceneData): Cells {
  const before = known.get(data);
  if (before !== undefined) return before;
  const { position, about: { count: n, metresPerUnit } } = data;
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < 3 * n; i++) {
    low[i % 3] = Math.min(low[i % 3], position[i]);
    high[i % 3] = Math.max(high[i % 3], position[i]);
  }
  const longest = Math.max(...high.map((h, a) => h - low[a]), 0);
  const side = Math.max(Math.min(REACH / metresPerUnit, SHARE * longest) / 2, 1e-12);
  // Keys are whole numbers that a double holds: 17 bits an axis, of scenes of up to 3 km; what lies beyond shares cells.
  const axis = 1 << 17;
  const at = (v: number, a: number) => Math.min(Math.max(Math.floor((v - low[a]) / side) + 2, 2), axis - 3);
  const numbers = new Map<number, number>(), keys: number[] = [];
  const of = new Uint32Array(n);
  for (let i = 0; i < n; i++) {
    const key = (at(position[3 * i], 0) * axis + at(position[3 * i + 1], 1)) * axis + at(position[3 * i + 2], 2);
    let number = numbers.get(key);
    if (number === undefined) {
      number = keys.length;
      numbers.set(key, number);
      keys.push(key);
    }
    of[i] = number;
  }
  const steps = BALL.map(([x, y, z]) => (x * axis + y) * axis + z);
  const near = (cell: number) => {
    const out: number[] = [];
    for (const step of steps) {
      const number = numbers.get(keys[cell] + step);
      if (number !== undefined) out.push(number);
    }
    return out;
  };
  const cells = { of, count: keys.length, near };
  known.set(data, cells);
  return cells;
}

/**
 * The selection with what is within a step of it (`by` 1), or without what is within a step of what is not selected (`by` −1).
 * Gaussians of hidden classes (+ 1) stay as they are, and hold nothing back.
 */
export function grown(data: SceneData, selected: Uint8Array, hidden: Set<number>, by: 1 | -1): Uint8Array {
  const { of, count, near } = cellsOf(data);
  const shown = Uint8Array.from(selected, (_, i) => (hidden.has(data.label[i]) ? 0 : 1));
  // Shrinking begins where most is not selected: single Gaussians that are missing inside make no holes.
  const balance = new Int32Array(count), some = new Uint8Array(count);
  for (let i = 0; i < selected.length; i++) {
    if (shown[i] === 0) continue;
    balance[of[i]] += selected[i] === 1 ? 1 : -1;
    if (selected[i] === 1) some[of[i]] = 1;
  }
  const reached = new Uint8Array(count);
  for (let cell = 0; cell < count; cell++) {
    if (by === 1 ? some[cell] === 0 : balance[cell] >= 0) continue;
    for (const other of near(cell)) reached[other] = 1;
  }
  const now = by === 1 ? 1 : 0;
  return selected.map((s, i) => (shown[i] === 1 && reached[of[i]] === 1 ? now : s));
}

/** States before changes, the oldest of many forgotten. Steps of one kind that follow one another are one change. */
export class Past<T> {
  private states: { state: T; kind: string | null }[] = [];

  constructor(private most: number) {}

  get isEmpty(): boolean {
    return this.states.length === 0;
  }

  /** Notes the state before a change; `kind`: of changes by degrees, as a slider makes them. */
  note(state: T, kind: string | null = null): void {
    if (kind !== null && this.states.at(-1)?.kind === kind) return;
    this.states.push({ state, kind });
    if (this.states.length > this.most) this.states.shift();
  }

  back(): T | null {
    return this.states.pop()?.state ?? null;
  }
}
