// node node_modules/scenesplat/examples/node.mjs ROOM.ply: what is in a scene.
import { Scenesplat } from "scenesplat";
import { readFile } from "node:fs/promises";

const path = process.argv[2];
const splat = await Scenesplat.load();
const { gaussians, format } = splat.parse(await readFile(path), path);
const { classes, objects } = splat.segment();
const counts = new Map();
for (const label of splat.values("labels")) counts.set(label, (counts.get(label) ?? 0) + 1);
console.log(`${gaussians} Gaussians (${format}), ${objects.length} objects`);
for (const [label, count] of [...counts].sort((a, b) => b[1] - a[1])) {
  console.log(`${count.toString().padStart(8)} ${classes[label] ?? "without a class"}`);
}
const asked = await splat.query("chair");
console.log(`chair: ${asked.count} Gaussians, objects ${asked.objects.join(", ")}`);
console.log(`as .spz: ${splat.convert("spz").length} bytes`);
