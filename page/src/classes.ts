// What names of classes say: the building's parts, and the order of the legend.

import type { ClassEntry } from "./data";

/** The building's parts, as the lists of `objects` leave them out. */
const BUILDING = ["wall", "floor", "ceiling"];

/** Whether a class is of one of the kinds: its last word is its name, as `is_kind` of the library has it. */
export function isKind(name: string, kinds: readonly string[]): boolean {
  // A name may have a megabyte.
  const last = name.slice(-60).trim().split(/[^\p{L}\p{N}]|(?<=\p{Ll})(?=\p{Lu})/u).at(-1) ?? "";
  return kinds.includes(last.toLowerCase());
}

/** Whether a class is a part of the building. */
export const isBuilding = (name: string): boolean => isKind(name, BUILDING);

/** Places of the classes that occur, those with most Gaussians first, the building's parts behind all others. */
export function legendOrder(classes: readonly ClassEntry[]): number[] {
  const building = classes.map((c) => Number(isBuilding(c.name)));
  return classes.map((_, i) => i).filter((i) => classes[i].count > 0)
    .sort((a, b) => building[a] - building[b] || classes[b].count - classes[a].count || a - b);
}
