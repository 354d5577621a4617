// The selection as files.

import { rotationOf, scaleOf, type SceneData } from "./data";

function sourceRow(data: SceneData, i: number): number {
  return data.rows.length > 0 ? data.rows[i] : i;
}

/** A field of a CSV line; what a spreadsheet would take for a formula begins with an apostrophe. */
export function field(text: string): string {
  const safe = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\n\r]/.test(safe) ? `"${safe.replace(/"/g, '""')}"` : safe;
}

export function csv(data: SceneData, selected: Uint8Array): string {
  const lines = ["row,x,y,z,class,score,object"];
  const names = data.about.classes.map((c) => field(c.name));
  for (let i = 0; i < selected.length; i++) {
    if (selected[i] === 0) continue;
    const p = data.position.subarray(3 * i, 3 * i + 3);
    const score = data.score.length > 0 ? (data.score[i] / 255).toFixed(3) : "";
    const object = data.object[i] > 0 ? data.about.objects[data.object[i] - 1].id.toString() : "";
    const name = data.label[i] > 0 ? names[data.label[i] - 1] : "";
    lines.push(`${sourceRow(data, i)},${p[0].toFixed(5)},${p[1].toFixed(5)},${p[2].toFixed(5)},${name},${score},${object}`);
  }
  return lines.join("\n") + "\n";
}

const C0 = 0.28209479177387814;

/** A splat PLY of the selection with the rounding of this page, and `label`, `instance`, `source_row`. */
export function ply(data: SceneData, selected: Uint8Array): Uint8Array {
  const count = selected.reduce((sum, s) => sum + s, 0);
  const floats = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
  ];
  const ints = ["label", "instance", "source_row"];
  const header = [
    "ply", "format binary_little_endian 1.0", `element vertex ${count}`,
    ...floats.map((f) => `property float ${f}`), ...ints.map((f) => `property int ${f}`), "end_header", "",
  ].join("\n");
  const head = new TextEncoder().encode(header);
  const size = 4 * (floats.length + ints.length);
  const out = new Uint8Array(head.length + count * size);
  out.set(head);
  const view = new DataView(out.buffer, head.length);
  let at = 0;
  for (let i = 0; i < selected.length; i++) {
    if (selected[i] === 0) continue;
    const alpha = Math.min(Math.max(data.color[4 * i + 3] / 255, 0.001), 0.999);
    const values = [
      ...data.position.subarray(3 * i, 3 * i + 3),
      ...[0, 1, 2].map((c) => (data.color[4 * i + c] / 255 - 0.5) / C0),
      Math.log(alpha / (1 - alpha)),
      ...scaleOf(data, i).map(Math.log),
      ...rotationOf(data, i),
    ];
    values.forEach((v, k) => view.setFloat32(at + 4 * k, v, true));
    const rest = at + 4 * floats.length;
    view.setInt32(rest, data.label[i] - 1, true);
    view.setInt32(rest + 4, data.object[i] - 1, true);
    view.setInt32(rest + 8, sourceRow(data, i), true);
    at += size;
  }
  return out;
}

export function save(name: string, content: BlobPart, type: string): void {
  const url = URL.createObjectURL(new Blob([content], { type }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
