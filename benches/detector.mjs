// What the detector's graph gives by TensorFlow.js: the numbers in crates/vision/src/detector/tests/mod.rs.
//   npm install @tensorflow/tfjs-core @tensorflow/tfjs-converter @tensorflow/tfjs-backend-cpu
//   node benches/detector.mjs nanodet.json
import * as tf from '@tensorflow/tfjs-core';
import '@tensorflow/tfjs-backend-cpu';
import {loadGraphModel} from '@tensorflow/tfjs-converter';
import {readFileSync} from 'node:fs';
import {dirname, join} from 'node:path';

const path = process.argv[2];
const model = JSON.parse(readFileSync(path, 'utf8'));
const groups = model.weightsManifest;
const bytes = Buffer.concat(groups.flatMap((g) => g.paths.map((p) => readFileSync(join(dirname(path), p)))));
const weightData = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
const weightSpecs = groups.flatMap((g) => g.weights);
const {modelTopology, format, signature} = model;
await tf.setBackend('cpu');
const graph = await loadGraphModel({load: async () => ({modelTopology, weightSpecs, weightData, format, signature})});

const side = 416;
const picture = new Float32Array(3 * side * side);
for (let at = 0; at < picture.length; at++) {
  const [c, y, x] = [Math.floor(at / side / side), Math.floor(at / side) % side, at % side];
  picture[at] = ((c * 131 + y * 17 + x * 29 + Math.floor(y / 37) * Math.floor(x / 53) * 41) % 256) / 64 - 2;
}
const outputs = graph.execute(tf.tensor(picture, [1, 3, side, side]), Object.keys(signature.outputs));
for (const output of outputs) {
  const values = Array.from(output.dataSync());
  const sum = values.reduce((s, v) => s + Math.abs(v), 0);
  const weighted = values.reduce((s, v, at) => s + v * (((at * 7919) % 1009) / 1009 - 0.5), 0);
  const n = values.length;
  const probes = [0, Math.floor(n / 3), Math.floor(n / 2) + 7, n - 1].map((at) => values[at].toFixed(6));
  console.log(output.shape.join('x'), sum.toFixed(6), weighted.toFixed(6), probes.join(' '));
}
