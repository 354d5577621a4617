// Language codes of the scene and their scores with texts.

import scoreProgram from "./score.wat";

type Score = (
  codes: number, rows: number, groups: number, weights: number, offset: number, factor: number, out: number,
) => void;
type Best = (
  codes: number, rows: number, groups: number, weights: number, fours: number, factor: number, out: number,
) => void;

type Range = (scores: number, rows: number, out: number) => void;
type Grade = (
  scores: number, best: number, rows: number, low: number, scale: number, slack: number, heat: number, wins: number,
) => void;

interface Program {
  score: Score;
  best: Best;
  range: Range;
  grade: Grade;
  /** Where codes, weights, scores, best scores, heat and wins begin. */
  at: number[];
}

/** Scores in their range. */
export interface Graded {
  range: [number, number];
  /** (score − low) · 255 / (high − low), rounded down. [rows] */
  heat: Uint8Array;
  /** 1 where the score is the best of any class, or nearly. [rows] */
  wins: Uint8Array;
}

const PAGE = 65_536;
/** Largest weight of a text as a whole number. */
const MOST = 32_767;
/** Texts that are compared at once, at most; a multiple of four. */
const TEXTS = 256;

/** Codes in rows, compared with texts: by WebAssembly where the browser has its SIMD, else in plain code. */
export class Codes {
  /** Best score of any class of each row; −1 without classes. [rows] */
  readonly best: Float32Array;
  /** Numbers from one row to the next. */
  readonly stride: number;
  /** [rows, stride] */
  readonly values: Int8Array;
  private out: Float32Array;
  private weights: Int16Array;
  private offsets: Int32Array;
  private program: Program | null = null;

  /**
   * `packed`: rows of `width` numbers; `texts`: an offset and `width` weights for each text, the classes first.
   * `plain`: without WebAssembly, for tests.
   */
  constructor(
    packed: Int8Array, readonly rows: number, readonly width: number, private texts: Float32Array, classes: number,
    plain = false,
  ) {
    const groups = Math.max(1, Math.ceil(width / 8));
    this.stride = 8 * groups;
    const size = [rows * this.stride, (TEXTS / 4) * (16 + 8 * this.stride), 4 * rows, 4 * rows, rows, rows];
    const at = size.map((_, i) => size.slice(0, i).reduce((sum, s) => sum + 16 * Math.ceil(s / 16), 0));
    // Rows are graded in fours.
    const total = at[5] + size[5] + 16;
    const memory = plain ? null : memoryOf(total);
    const buffer = memory === null ? new ArrayBuffer(total) : memory.buffer;
    this.values = new Int8Array(buffer, at[0], size[0]);
    this.weights = new Int16Array(buffer, at[1], size[1] / 2);
    this.offsets = new Int32Array(buffer, at[1], size[1] / 4);
    this.out = new Float32Array(buffer, at[2], rows);
    this.best = new Float32Array(buffer, at[3], rows);
    if (this.stride === width) this.values.set(packed.subarray(0, rows * width));
    else {
      for (let row = 0; row < rows; row++) {
        this.values.set(packed.subarray(row * width, (row + 1) * width), row * this.stride);
      }
    }
    if (memory !== null) {
      const module = new WebAssembly.Module(scoreProgram as BufferSource);
      const made = new WebAssembly.Instance(module, { page: { memory } });
      const { score, best, range, grade } = made.exports;
      this.program = { score: score as Score, best: best as Best, range: range as Range, grade: grade as Grade, at };
    }
    const known = Math.min(classes, Math.floor(texts.length / (width + 1)));
    if (known === 0) this.best.fill(-1);
    else this.into(this.best, Array.from({ length: known }, (_, text) => text));
  }

  /** Scores with a text, or the best with any of several; valid until the next call. [rows] */
  scores(texts: number[]): Float32Array {
    this.into(this.out, texts);
    return this.out;
  }

  /** Where the scores with a text, or the best with any of several, lie in their range; they win if they are less
   * than `slack` below the best of any class. */
  graded(texts: number[], slack: number): Graded {
    const { out, best, rows, program: p } = this;
    this.into(out, texts);
    let low = Infinity, high = -Infinity;
    if (p !== null) {
      // The weights have done their work.
      p.range(p.at[2], rows, p.at[1]);
      [low, high] = new Float32Array(out.buffer, p.at[1], 2);
    } else {
      for (let row = 0; row < rows; row++) {
        if (out[row] < low) low = out[row];
        if (out[row] > high) high = out[row];
      }
    }
    if (rows === 0) low = high = 0;
    if (!(high > low)) high = low + 1e-6;
    // In single precision as there, so that both say the same; a little more, so that the highest is 255.
    const scale = Math.fround(255.0001 / (high - low)), less = Math.fround(slack);
    if (p !== null) {
      p.grade(p.at[2], p.at[3], rows, low, scale, less, p.at[4], p.at[5]);
      const copy = (at: number) => new Uint8Array(out.buffer, at, rows).slice();
      return { range: [low, high], heat: copy(p.at[4]), wins: copy(p.at[5]) };
    }
    const heat = new Uint8Array(rows), wins = new Uint8Array(rows);
    for (let row = 0; row < rows; row++) {
      heat[row] = Math.fround(Math.fround(out[row] - low) * scale);
      wins[row] = out[row] >= Math.fround(best[row] - less) ? 1 : 0;
    }
    return { range: [low, high], heat, wins };
  }

  /** Score of one row with a text. */
  score(row: number, text: number): number {
    const weights = this.row(text);
    let sum = weights[0];
    for (let j = 0; j < this.width; j++) sum += weights[j + 1] * this.values[row * this.stride + j];
    return sum;
  }

  private row(text: number): Float32Array {
    return this.texts.subarray(text * (this.width + 1), (text + 1) * (this.width + 1));
  }

  /** What a whole number stands for, so that the largest weight of some texts is `MOST` of them. */
  private factorOf(texts: number[]): number {
    let largest = 0;
    for (const text of texts) {
      const row = this.row(text);
      for (let j = 1; j <= this.width; j++) largest = Math.max(largest, Math.abs(row[j]));
    }
    return largest > 0 ? largest / MOST : 1;
  }

  private into(out: Float32Array, texts: number[]): void {
    if (this.program === null) this.plainly(out, texts);
    else if (texts.length === 1) this.single(out, texts[0]);
    else {
      for (let at = 0; at < texts.length; at += TEXTS) this.several(out, texts.slice(at, at + TEXTS), at > 0);
    }
  }

  private single(out: Float32Array, text: number): void {
    const p = this.program;
    if (p === null) return;
    const row = this.row(text), factor = this.factorOf([text]);
    this.weights.fill(0, 0, this.stride);
    for (let j = 0; j < this.width; j++) this.weights[j] = Math.round(row[j + 1] / factor);
    p.score(p.at[0], this.rows, this.stride / 8, p.at[1], row[0], factor, out === this.best ? p.at[3] : p.at[2]);
  }

  private several(out: Float32Array, texts: number[], raise: boolean): void {
    const p = this.program;
    if (p === null) return;
    const before = raise ? out.slice() : null;
    const factor = this.factorOf(texts), groups = this.stride / 8;
    const fours = Math.ceil(texts.length / 4);
    this.weights.fill(0);
    for (let i = 0; i < 4 * fours; i++) {
      // The last four are filled up with the last text.
      const row = this.row(texts[Math.min(i, texts.length - 1)]);
      const four = (i >> 2) * (8 + 4 * this.stride);
      this.offsets[four / 2 + (i & 3)] = Math.round(row[0] / factor);
      for (let j = 0; j < this.width; j++) {
        this.weights[four + 8 + (j >> 3) * 32 + 8 * (i & 3) + (j & 7)] = Math.round(row[j + 1] / factor);
      }
    }
    p.best(p.at[0], this.rows, groups, p.at[1], fours, factor, out === this.best ? p.at[3] : p.at[2]);
    before?.forEach((v, s) => { if (v > out[s]) out[s] = v; });
  }

  private plainly(out: Float32Array, texts: number[]): void {
    const { values, stride, width } = this;
    texts.forEach((text, place) => {
      const weights = this.row(text);
      for (let row = 0; row < this.rows; row++) {
        let sum = weights[0];
        for (let j = 0, at = row * stride; j < width; j++) sum += weights[j + 1] * values[at + j];
        if (place === 0 || sum > out[row]) out[row] = sum;
      }
    });
  }
}

/** Memory for so many bytes; `null` where the browser cannot run the program. */
function memoryOf(bytes: number): WebAssembly.Memory | null {
  try {
    if (!WebAssembly.validate(scoreProgram as BufferSource)) return null;
    return new WebAssembly.Memory({ initial: Math.max(1, Math.ceil(bytes / PAGE)) });
  } catch {
    return null;
  }
}
