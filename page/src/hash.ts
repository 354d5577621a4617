// What is seen, as the part of the address after #.

import { MODES, type Mode } from "./colors";

export interface Shared {
  mode: Mode | null;
  query: string;
  threshold: number | null;
  hidden: number[];
  camera: number[] | null;
  /** Whether near walls are cut away. */
  cut: boolean;
}

export function readHash(hash: string): Shared {
  const parts = new URLSearchParams(hash.replace(/^#/, ""));
  const mode = MODES.find((m) => m === parts.get("mode")) ?? null;
  const numbers = (text: string | null) => (text === null || text === "" ? [] : text.split(",").map(Number));
  const camera = numbers(parts.get("camera"));
  const threshold = numbers(parts.get("threshold"))[0];
  return {
    mode,
    query: (parts.get("query") ?? "").slice(0, 500),
    threshold: threshold >= 0 && threshold <= 255 ? threshold : null,
    hidden: numbers(parts.get("hide")).filter((h) => Number.isInteger(h) && h >= 0 && h < 65536),
    camera: camera.length === 6 && camera.every(Number.isFinite) ? camera : null,
    cut: parts.get("cut") !== "0",
  };
}

let last = "";

export function writeHash(shared: Shared): void {
  const parts = new URLSearchParams();
  if (shared.mode !== null) parts.set("mode", shared.mode);
  if (shared.query !== "") {
    parts.set("query", shared.query.slice(0, 500));
    parts.set("threshold", String(shared.threshold));
  }
  if (shared.hidden.length > 0) parts.set("hide", shared.hidden.join(","));
  if (!shared.cut) parts.set("cut", "0");
  if (shared.camera !== null) parts.set("camera", shared.camera.map((v) => v.toFixed(3)).join(","));
  const text = `#${parts.toString()}`;
  if (text === last) return;
  last = text;
  // Some browsers refuse this for files on disk; then there is no link to share.
  try {
    history.replaceState(null, "", text);
  } catch {
    return;
  }
}
