// From what somebody types to what is looked for.

import type { SceneData } from "./data";

/** What a phrase asks for. */
export interface Meaning {
  /** Row of the texts, or −1. */
  text: number;
  /** Class, or −1. */
  label: number;
  /** Classes of a group, the class itself, or none. */
  members: number[];
  /** How it was understood, in words; empty if as typed. */
  how: string;
  /** Whether nothing in this scene's classes is like it. */
  isUnknown: boolean;
}

/** "the lamp on the desk" in its parts. */
export interface Relation {
  what: string;
  /** Null if no relation of objects is this place. */
  relation: string | null;
  /** Its words. */
  word: string;
  to: string;
}

const ARTICLES = new Set(["the", "a", "an", "some", "any", "my"]);
/** As `ALIKE`, `LEAD` and `SURE` of the program. */
const ALIKE = 0.4;
const LEAD = 0.05;
const SURE = 0.55;
/** Words before a purpose, as `LEADING`, `OPENING`, `PLACES` and `THINGS` of the program. */
const LEADING = new Set(("something thing object item furniture piece of place spot area room one what where which to for used use i " +
  "child kid guest person can could may might do does will would should usually normally always often want need in on " +
  "comfortable comfy nice good it be go show me find").split(" "));
const OPENING = new Set("something thing object item furniture place spot what where to for".split(" "));
const KINDS: Record<string, Set<string>> = {
  "@": new Set("place where spot area room".split(" ")),
  "#": new Set("something thing object item what which".split(" ")),
};
/** Words that say nothing in a purpose, and those that count as another, as `DROPPED` and `SAME` of the program. */
const SILENT = new Set("this that these those your his her its our their please is are am".split(" "));
const SAME: Record<string, string> = {
  we: "i", you: "i", he: "i", she: "i", they: "i", people: "i", somewhere: "place", anywhere: "place", anything: "something",
  stuff: "something", feet: "foot", teeth: "tooth", children: "child",
};
/** Denials that no English word is a letter from. */
const MISSPELT = ["without", "except", "excluding"];

export function words(text: string): string[] {
  const parts = text.toLowerCase().split(/[^\p{L}\p{N}]+/u);
  return parts.filter((w) => w !== "" && !ARTICLES.has(w)).slice(0, 32);
}

function singular(word: string): string {
  if (word.length > 4 && /(ches|shes|xes|sses)$/.test(word)) return word.slice(0, -2);
  if (word.length > 4 && word.endsWith("ies")) return word.slice(0, -3) + "y";
  if (word.length > 3 && word.endsWith("ves")) return word.slice(0, -3) + "f";
  return word.length > 3 && word.endsWith("s") && !word.endsWith("ss") ? word.slice(0, -1) : word;
}

/** A word and what it may be a form of: a plural, a verb in -s, -ing or -ed. */
function forms(word: string): string[] {
  const found = [word, word.replace(/s$/, ""), word.replace(/es$/, ""), singular(word)];
  const stem = word.replace(/(ing|ed)$/, "");
  if (stem.length > 2) found.push(stem, stem + "e", stem.replace(/(.)\1$/, "$1"));
  return found;
}

/** Whether words fill all slots of a purpose. */
function fits(all: string[], slots: string[]): boolean {
  if (slots.length === 0) return all.length === 0;
  return slots[0].split("|").some((own) => own === "_" ? fits(all, slots.slice(1))
    : all.length > 0 && forms(all[0]).includes(own) && fits(all.slice(1), slots.slice(1)));
}

/** Whether two words differ by one letter more, less, other or by two swapped neighbours. */
export function isTypo(a: string, b: string): boolean {
  if (Math.abs(a.length - b.length) > 1 || a === b) return false;
  let start = 0;
  while (start < a.length && a[start] === b[start]) start++;
  let end = 0;
  const most = Math.min(a.length, b.length) - start;
  while (end < most && a[a.length - 1 - end] === b[b.length - 1 - end]) end++;
  const left = a.slice(start, a.length - end), right = b.slice(start, b.length - end);
  if (left.length <= 1 && right.length <= 1) return true;
  return left.length === 2 && right.length === 2 && left[0] === right[1] && left[1] === right[0];
}

export class PhraseBook {
  private texts = new Map<string, number>();
  private phrases = new Map<string, number>();
  private groups = new Map<string, number[]>();
  private purposes: SceneData["about"]["groups"];
  private known = new Set<string>();
  private colors: Set<string>;
  private articles: Set<string>;
  private foreign: Map<string, number>;

  constructor(private data: SceneData) {
    data.about.texts.forEach((name, i) => {
      const key = words(name.slice(0, 200)).map(singular).join(" ");
      if (key !== "" && !this.texts.has(key)) this.texts.set(key, i);
    });
    data.phrases.forEach((phrase, i) => {
      const key = words(phrase).map(singular).join(" ");
      if (!this.phrases.has(key)) this.phrases.set(key, i);
    });
    this.purposes = data.about.groups;
    for (const { name, members } of data.about.groups) {
      const key = words(name).map(singular).join(" ");
      if (key !== "" && !this.groups.has(key)) this.groups.set(key, members);
    }
    for (const key of [...this.texts.keys(), ...this.groups.keys(), ...this.phrases.keys()]) {
      for (const word of key.split(" ")) this.known.add(word);
    }
    this.colors = new Set(data.about.colorWords);
    this.articles = new Set(data.about.foreign.articles);
    this.foreign = new Map(data.about.foreign.names);
  }

  /** Whether a phrase denies what it names; a name of the scene denies nothing. */
  denies(text: string): boolean {
    const all = words(text);
    if (/n['’]t\b|(^|\s)[!¬~-]\p{L}|\bw\/o\b/u.test(text.toLowerCase())) return true;
    if (this.texts.has(all.map(singular).join(" "))) return false;
    if (all.some((word) => MISSPELT.some((right) => isTypo(word, right)))) return true;
    const phrase = ` ${all.join(" ")} `;
    return this.data.about.denials.some((denial) => phrase.includes(` ${denial} `));
  }

  /** The first words of a place, unless the phrase is known as a whole. */
  relation(text: string): Relation | null {
    const all = words(text);
    if (this.phrases.has(all.map(singular).join(" ")) || this.serving(text) !== null) return null;
    for (let at = 0; at < all.length - 1; at++) {
      let best: Relation | null = null, most = 0;
      for (const [word, relation] of this.data.about.places) {
        const parts = word.split(" ");
        if (parts.length <= most || at + parts.length >= all.length) continue;
        if (!parts.every((part, i) => all[at + i] === part)) continue;
        most = parts.length;
        const what = all.slice(0, at).filter((w) => w !== "standing" && w !== "lying").join(" ");
        best = { what, relation, word, to: all.slice(at + most).join(" ") };
      }
      if (best !== null) return best;
    }
    return null;
  }

  /** Names that begin with, or hold, what was typed. */
  suggest(typed: string, most: number): string[] {
    const key = words(typed).join(" ");
    if (key === "") return [];
    const out: string[] = [];
    const add = (name: string) => {
      if (out.length < most && name.length <= 60 && !out.includes(name)) out.push(name);
    };
    const names = this.data.about.texts;
    names.forEach((n) => n.slice(0, 60).toLowerCase().startsWith(key) && add(n));
    this.data.phrases.forEach((p) => p.startsWith(key) && add(p));
    names.forEach((n) => n.slice(0, 60).toLowerCase().includes(key) && add(n));
    return out;
  }

  meaning(text: string): Meaning {
    const typed = words(text).map(singular);
    const none: Meaning = { text: -1, label: -1, members: [], how: "", isUnknown: true };
    if (typed.length === 0) return { ...none, how: "holds no word" };
    const direct = this.texts.get(typed.join(" "));
    if (direct !== undefined) return this.ofText(direct, "");
    const group = this.groups.get(typed.join(" "));
    if (group !== undefined) {
      const names = group.map((m) => this.data.about.classes[m].name);
      return { text: -1, label: -1, members: group, how: names.join(", "), isUnknown: false };
    }
    const foreign = this.foreignClass(text);
    if (foreign !== null) return this.ofText(foreign, `taken as “${this.data.about.classes[foreign].name}”`);
    const remarks: string[] = [];
    const right = typed.map((word) => {
      if (this.known.has(word) || word.length < 4) return word;
      const other = this.correction(word);
      if (other === null) return word;
      remarks.push(`“${word}” taken as “${other}”`);
      return other;
    });
    const serving = this.serving(text) ?? this.serving(right.join(" "));
    if (serving !== null) {
      if (serving.length === 0) return { ...none, how: "no class serves this purpose" };
      const names = serving.map((m) => this.data.about.classes[m].name).join(", ");
      const left = typed.some((word) => this.colors.has(word)) ? "; the color is left out" : "";
      if (serving.length === 1) return this.ofText(serving[0], `taken as “${names}”, which serves this purpose${left}`);
      return { text: -1, label: -1, members: serving, how: `taken as all of ${names}, which serve this purpose${left}`, isUnknown: false };
    }
    const corrected = this.texts.get(right.join(" "));
    if (corrected !== undefined) return this.ofText(corrected, remarks.join("; "));
    const colors = right.filter((w) => this.colors.has(w));
    const rest = right.filter((w) => !this.colors.has(w));
    const similar = this.similarity(rest.length > 0 ? rest : right);
    if (similar === null) return { ...none, how: "none of these words is known" };
    const [best, ...others] = similar;
    if (best === undefined || best[1] < ALIKE) {
      return { ...none, how: "nothing among the classes of this scene is like it" };
    }
    const [label, score] = best;
    const name = this.data.about.classes[label].name.slice(0, 60);
    const near = others.filter(([, other]) => score - other < LEAD).slice(0, 4);
    const isSure = score >= SURE && near.length === 0;
    remarks.push(`taken as “${name}” (${score.toFixed(2)}${isSure ? "" : ", not sure"})`);
    const listed = near.map(([other, own]) => `${this.data.about.classes[other].name.slice(0, 60)} ${own.toFixed(2)}`);
    if (listed.length > 0) remarks.push(`near: ${listed.join(", ")}`);
    const painted = colors.length > 0 ? this.texts.get([colors[0], ...words(name).map(singular)].join(" ")) : undefined;
    return this.ofText(painted ?? label, remarks.join("; "));
  }

  /** The classes that serve the purpose that a phrase names; none if no class does, null if it names something else. */
  private serving(text: string): number[] | null {
    const all = words(text).filter((w) => !SILENT.has(w) && !this.colors.has(w)).map((w) => SAME[w] ?? w);
    if (all.length > 16) return null;
    const isAny = (word: string, list: Set<string>) => forms(word).some((form) => list.has(form));
    let lead = all.findIndex((word) => !isAny(word, LEADING));
    if (lead < 0) lead = all.length;
    const opening = all.slice(0, lead).findIndex((word) => isAny(word, OPENING));
    if (opening < 0) return null;
    // What may lead may also be what is done: "where I go out".
    for (let at = lead; at > opening; at--) {
      const found = this.purposes.find((group) => (group.purposes ?? []).some((pattern) => {
        const kind = KINDS[pattern[0]];
        if (kind !== undefined && !all.slice(0, at).some((word) => isAny(word, kind))) return false;
        return fits(all.slice(at), (kind === undefined ? pattern : pattern.slice(2)).split(" "));
      }));
      if (found !== undefined) return found.members;
    }
    return null;
  }

  /** The class whose name in German or French, or in everyday English, a phrase is. */
  private foreignClass(text: string): number | null {
    const all = words(text.replace(/(^|\s)[ldjc]['’]/giu, "$1"));
    const at = all.findIndex((word) => !this.articles.has(word));
    if (at < 0) return null;
    const name = all.slice(at).join(" ");
    const whole = this.foreign.get(name) ?? this.foreign.get(name.replace(/s$/, ""));
    if (whole !== undefined || name.includes(" ") || this.known.has(name)) return whole ?? null;
    // A German compound is what it ends with; a "Leinwand" is no wall, a "Bettdecke" no ceiling.
    let best: number | null = null, most = 3;
    for (const [end, label] of this.foreign) {
      const isEnd = end.length > most && name.length >= end.length + 3 && name.endsWith(end);
      if (!isEnd || ["wall", "ceiling"].includes(this.data.about.classes[label].name)) continue;
      [best, most] = [label, end.length];
    }
    return best;
  }

  private ofText(text: number, how: string): Meaning {
    const label = text < this.data.about.classes.length ? text : -1;
    return { text, label, members: label >= 0 ? [label] : [], how, isUnknown: false };
  }

  private correction(word: string): string | null {
    for (const other of this.known) {
      if (other.length >= 4 && other[0] === word[0] && isTypo(word, other)) return other;
    }
    return null;
  }

  /** The classes by the longest known parts and how near each is, the nearest first; null if no part is known. */
  private similarity(all: string[]): [number, number][] | null {
    const sums = new Map<number, number>();
    let weight = 0;
    for (let at = 0; at < all.length;) {
      let length = Math.min(4, all.length - at);
      let row: number | undefined;
      for (; length > 0; length--) {
        row = this.phrases.get(all.slice(at, at + length).join(" "));
        if (row !== undefined) break;
      }
      if (row === undefined) {
        at++;
        continue;
      }
      for (let k = 0; k < 4; k++) {
        const label = this.data.near[8 * row + 2 * k] - 1;
        if (label < 0) continue;
        const near = (this.data.near[8 * row + 2 * k + 1] / 255) * length;
        sums.set(label, (sums.get(label) ?? 0) + near);
      }
      weight += length;
      at += length;
    }
    if (weight === 0) return null;
    const found = [...sums].map(([label, sum]): [number, number] => [label, sum / weight]);
    return found.sort((x, y) => y[1] - x[1] || x[0] - y[0]);
  }
}
