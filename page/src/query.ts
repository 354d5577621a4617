// Scores of a text, and what they select.

import type { Codes } from "./codes";
import type { SceneData } from "./data";
import { PhraseBook, type Relation } from "./phrases";

export interface Found {
  /** What was asked. */
  text: string;
  /** How it was understood. */
  how: string;
  isUnknown: boolean;
  /** Score of each Gaussian, 0..=255 of `range`; empty where nothing has one. */
  heat: Uint8Array;
  range: [number, number];
  /** Whether a Gaussian is more like this than like any class. */
  wins: Uint8Array;
  threshold: number;
  /** Objects that answer by themselves (relations); else null. */
  objects: number[] | null;
}

/** Scores below the best class by less than this still win: i8 codes round. */
const SLACK = 0.02;

export function answer(data: SceneData, book: PhraseBook, text: string): Found {
  if (book.denies(text)) {
    return nothing(data, text, "a page does not answer what a phrase denies: ask for it, then invert the selection");
  }
  const relation = book.relation(text);
  if (relation !== null) {
    const found = byRelation(data, book, text, relation);
    if (found !== null) return found;
  }
  const versus = text.split(/\s+(?:vs\.?|versus)\s+/i);
  if (versus.length === 2) return difference(data, book, text, versus);
  const meaning = book.meaning(text);
  if (meaning.isUnknown) return nothing(data, text, meaning.how);
  const asked = meaning.text >= 0 ? [meaning.text] : meaning.members;
  if (data.codes !== null && asked.length > 0) {
    return byCodes(data, data.codes, text, meaning.how, asked);
  }
  if (meaning.members.length > 0) return byLabels(data, text, meaning.how, meaning.members);
  return nothing(data, text, "this page has no language codes, only classes");
}

function byCodes(data: SceneData, codes: Codes, text: string, how: string, asked: number[]): Found {
  const { range, heat, wins } = codes.graded(asked, SLACK);
  const counts = new Uint32Array(512);
  for (let s = 0; s < heat.length; s++) counts[(wins[s] << 8) | heat[s]]++;
  const winners = counts.subarray(256);
  const won = winners.reduce((sum, c) => sum + c, 0);
  // All but the weakest twentieth of what wins.
  let threshold = 0;
  for (let sum = 0; threshold < 255; threshold++) {
    sum += winners[threshold];
    if (sum > won * 0.05) break;
  }
  const found = { text, how, isUnknown: false, range, threshold, objects: null };
  if (data.ownSlots) return { ...found, heat, wins };
  return { ...found, heat: spread(data, heat), wins: spread(data, wins) };
}

/** What each Gaussian has of its slot; 0 without one. */
function spread(data: SceneData, ofSlots: Uint8Array): Uint8Array {
  const { slot, about: { count: n } } = data;
  const out = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    if (slot[i] < ofSlots.length) out[i] = ofSlots[slot[i]];
  }
  return out;
}

function byLabels(data: SceneData, text: string, how: string, labels: number[]): Found {
  const n = data.about.count;
  const heat = new Uint8Array(n), wins = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    if (labels.includes(data.label[i] - 1)) {
      wins[i] = 1;
      heat[i] = data.score.length > 0 ? data.score[i] : 255;
    }
  }
  return { text, how, isUnknown: false, heat, range: [0, 1], wins, threshold: 0, objects: null };
}

function difference(data: SceneData, book: PhraseBook, text: string, sides: string[]): Found {
  const [a, b] = sides.map((side) => book.meaning(side));
  if (a.isUnknown || b.isUnknown || a.text < 0 || b.text < 0 || data.codes === null) {
    return nothing(data, text, a.how || b.how || "two texts with language codes are compared");
  }
  const x = data.codes.scores([a.text]).slice(), y = data.codes.scores([b.text]);
  let most = 1e-6;
  for (let s = 0; s < x.length; s++) most = Math.max(most, Math.abs(x[s] - y[s]));
  const { slot, about: { count: n } } = data;
  const heat = new Uint8Array(n).fill(127), wins = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    const s = slot[i];
    if (s >= x.length) continue;
    const d = (x[s] - y[s]) / most;
    heat[i] = 127.5 + 127.5 * d;
    wins[i] = d > 0 ? 1 : 0;
  }
  const how = [a.how, b.how].filter((h) => h !== "").join("; ");
  return { text, how, isUnknown: false, heat, range: [-most, most], wins, threshold: 128, objects: null };
}

function byRelation(data: SceneData, book: PhraseBook, text: string, asked: Relation): Found | null {
  const to = book.meaning(asked.to);
  // "Something soft under my head" says by what it is what it is.
  if (to.members.length === 0) return null;
  if (asked.relation === null) {
    return nothing(data, text, `objects do not tell “${asked.word}”; they tell on, above, under, in, near`);
  }
  const what = book.meaning(asked.what);
  if (what.members.length === 0) return nothing(data, text, what.how || "objects are told by class, not by color");
  const { objects, relations } = data.about;
  const found = new Set<number>();
  for (const [a, relation, b] of relations) {
    const fits = relation === asked.relation || (relation === "on" && asked.relation === "above");
    if (fits && what.members.includes(objects[a].label) && to.members.includes(objects[b].label)) found.add(a);
  }
  const n = data.about.count;
  const heat = new Uint8Array(n), wins = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    if (found.has(data.object[i] - 1)) {
      wins[i] = 1;
      heat[i] = 255;
    }
  }
  const names = [asked.what, asked.to];
  const parts = [what.how, to.how, `${names[0]} ${asked.relation} ${names[1]}`];
  return {
    text, how: parts.filter((p) => p !== "").join("; "), isUnknown: found.size === 0,
    heat, range: [0, 1], wins, threshold: 0, objects: [...found],
  };
}

function nothing(data: SceneData, text: string, how: string): Found {
  const none = new Uint8Array(data.about.count);
  return { text, how, isUnknown: true, heat: none, range: [0, 1], wins: none, threshold: 0, objects: null };
}

/** What a threshold selects. */
export function selection(found: Found, threshold: number, onlyWins: boolean): Uint8Array {
  const { heat, wins } = found;
  const out = new Uint8Array(heat.length), wanted = onlyWins ? 1 : 0;
  // A heat of 0 is no answer, whatever the threshold.
  const least = Math.max(1, threshold);
  for (let i = 0; i < out.length; i++) out[i] = heat[i] >= least && wins[i] >= wanted ? 1 : 0;
  return out;
}

export interface FoundObject {
  object: number;
  /** Selected Gaussians, and their part of the object's. */
  count: number;
  share: number;
}

/** How much is selected, and the objects of which a third is, those with most of it first. */
export function foundObjects(data: SceneData, selected: Uint8Array): { count: number; objects: FoundObject[] } {
  const { object, objectSizes } = data;
  const counts = new Uint32Array(data.about.objects.length + 1);
  for (let i = 0; i < selected.length; i++) counts[object[i]] += selected[i];
  const objects: FoundObject[] = [];
  for (let i = 1; i < counts.length; i++) {
    const share = objectSizes[i] > 0 ? counts[i] / objectSizes[i] : 0;
    if (share >= 0.33) objects.push({ object: i - 1, count: counts[i], share });
  }
  objects.sort((a, b) => b.share - a.share || b.count - a.count);
  return { count: counts.reduce((sum, c) => sum + c, 0), objects };
}
