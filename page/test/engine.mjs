// The library as WebAssembly against the program: node test/engine.mjs APP.html SCENE FOLDER [FEATURES.npy], where FOLDER is what
// `SCENESPLAT_ISA=portable scenesplat segment SCENE --instances --out FOLDER` wrote. Prints how much is equal, and fails below
// 99.9 % of the labels.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { basename } from "node:path";
import { build } from "esbuild";
import { assets } from "../assets.mjs";

const here = new URL("..", import.meta.url).pathname;

/** The classes of the page's side of the library. */
export async function library() {
  const out = await build({ entryPoints: [`${here}src/app/engine.ts`], bundle: true, format: "esm", target: "es2022", write: false });
  return import(`data:text/javascript;base64,${Buffer.from(out.outputFiles[0].contents).toString("base64")}`);
}

/** Numbers of a .npy file. */
export function npy(path) {
  const bytes = readFileSync(path);
  const length = bytes.readUInt16LE(8);
  const header = bytes.toString("latin1", 10, 10 + length);
  const type = /'descr': '([^']+)'/.exec(header)[1];
  const data = bytes.subarray(10 + length);
  const types = { "<i4": Int32Array, "<f4": Float32Array };
  assert.ok(types[type], `${path}: ${type}`);
  return new types[type](data.buffer.slice(data.byteOffset, data.byteOffset + data.length));
}

/** The part of values that have the same bits, and the largest difference. */
function compared(a, b) {
  assert.equal(a.length, b.length, "another number of values");
  const [x, y] = [a, b].map((v) => new Int32Array(v.buffer, v.byteOffset, v.length));
  let same = 0, most = 0;
  for (let i = 0; i < x.length; i++) {
    if (x[i] === y[i]) same++;
    else most = Math.max(most, Math.abs(a[i] - b[i]));
  }
  return { same: same / x.length, different: x.length - same, most };
}

async function main([app, scene, folder, features]) {
  const { Engine } = await library();
  const { program, weights, phrases } = assets(app);
  const seconds = {};
  let last = null;
  const note = (stage) => {
    const now = performance.now();
    if (last !== null) seconds[last[0]] = Math.round((seconds[last[0]] ?? 0) * 1000 + now - last[1]) / 1000;
    last = [stage, now];
  };
  note("start");
  const engine = await Engine.start(program, { weights, phrases });
  engine.tell = (stage) => last[0] !== stage && note(stage);
  const parsed = engine.parse(readFileSync(scene), basename(scene));
  const found = engine.segment();
  const parts = engine.page("t");
  note("end");
  const report = { scene: basename(scene), gaussians: parsed.gaussians, format: parsed.format, objects: found.objects.length, seconds,
    memoryMiB: engine.memory / 2 ** 20, pageBytes: [...parts.values()].reduce((sum, p) => sum + p.length, 0), remarks: found.remarks };
  if (folder) {
    report.labels = compared(engine.values("labels"), npy(`${folder}/labels.npy`));
    report.scores = compared(engine.values("scores"), npy(`${folder}/scores.npy`));
    report.instances = compared(engine.values("instances"), npy(`${folder}/instances.npy`));
  }
  if (features) report.features = compared(engine.values("features"), npy(features));
  console.log(JSON.stringify(report, null, 1));
  if (folder) assert.ok(report.labels.same >= 0.999, `only ${report.labels.same} of the labels are the program's`);
}

if (process.argv[1] === new URL(import.meta.url).pathname) await main(process.argv.slice(2));
