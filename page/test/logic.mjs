// What the page answers, against what is worked out by hand, without a browser: node test/logic.mjs.
import assert from "node:assert/strict";
import { build } from "esbuild";
import { webAssembly } from "../wat.mjs";

const here = new URL("..", import.meta.url).pathname;

/** The modules of the page, with some of their text replaced: [file, from, to]. */
export async function modules(replaced = []) {
  const plant = {
    name: "plant",
    setup(b) {
      for (const [file, from, to] of replaced) {
        b.onLoad({ filter: new RegExp(`/src/${file.replace(/[.]/g, "\\.")}$`) }, async ({ path }) => {
          const { readFile } = await import("node:fs/promises");
          const text = await readFile(path, "utf8");
          if (text.split(from).length !== 2) throw new Error(`${file}: ${JSON.stringify(from)} is not there once`);
          return { contents: text.replace(from, () => to), loader: "ts" };
        });
      }
    },
  };
  const out = await build({
    stdin: {
      contents: ["classes", "codes", "query", "phrases", "editing", "exporting", "hash", "colors", "data", "room", "kit/numbers"]
        .map((name) => `export * from "./src/${name}";`).join("\n"),
      resolveDir: here,
      loader: "ts",
    },
    bundle: true, format: "esm", target: "es2022", write: false, logLevel: "silent", plugins: [plant, webAssembly],
  });
  const text = Buffer.from(out.outputFiles[0].contents).toString("base64");
  return import(`data:text/javascript;base64,${text}`);
}

const near = (a, b, by) => assert.ok(Math.abs(a - b) <= by, `${a} is not ${b}`);

/** Codes of 3 numbers: rows lie along a class each; the last has none. */
function scene({ Codes }) {
  const rows = [[127, 0, 0], [100, 78, 0], [0, 127, 0], [0, 90, 90], [0, 0, 127]];
  // Offset and weights: the dot product with the direction of each class. "red chair" leans to the third number.
  const texts = Float32Array.from([
    0, 1 / 127, 0, 0, // chair
    0, 0, 1 / 127, 0, // desk
    0, 0, 0, 1 / 127, // lamp
    0.05, 0.8 / 127, 0, 0.5 / 127, // red chair
  ]);
  const classes = ["chair", "desk", "lamp"].map((name, i) => ({ name, color: [40 * i, 200, 90], count: 2 }));
  const corners = Array.from({ length: 8 }, () => [0, 0, 0]);
  const object = (id, label) => ({ id, label, count: 2, corners, size: [1, 1, 1], position: [0, 0, 0] });
  const n = 6;
  return {
    about: {
      count: n, total: 9, classes, objects: [object(1, 0), object(2, 1), object(3, 2)],
      relations: [[2, "on", 1], [0, "near", 1], [1, "under", 2]], texts: ["chair", "desk", "lamp", "red chair"], colorWords: ["red"],
      foreign: { articles: ["der", "une", "dans"], names: [["stuhl", 0], ["sessel", 0], ["bureau", 1], ["abat jour", 2]] },
      denials: ["not", "no", "except", "other than"], places: [["on", "on"], ["on top of", "on"], ["under", "under"], ["left of", null]],
      groups: [{ name: "furniture", members: [0, 1] }], codes: { width: 3, slots: 5 }, hasScores: true, phrases: 2,
      metresPerUnit: 1, title: "t", warnings: [], remarks: [], chunks: null,
    },
    codes: new Codes(Int8Array.from(rows.flat()), 5, 3, texts, 3),
    label: Uint16Array.from([1, 1, 2, 2, 3, 0]),
    score: Uint8Array.from([255, 128, 255, 90, 51, 0]),
    object: Uint16Array.from([1, 1, 2, 2, 3, 0]),
    objectSizes: Uint32Array.from([1, 2, 2, 1]),
    slot: Uint32Array.from([0, 1, 2, 3, 4, 0xffffffff]),
    ownSlots: false,
    rows: Uint32Array.from([0, 2, 3, 5, 6, 8]),
    position: Float32Array.from({ length: 3 * n }, (_, i) => i / 4),
    // Planes: all x, then all y, then all z.
    scale: Uint8Array.from([...Array(n).fill(1), ...Array(n).fill(2), ...Array(n).fill(3)]),
    scales: Float32Array.from({ length: 256 }, (_, i) => i / 100),
    rotation: Int8Array.from([...Array(n).fill(127), ...Array(n).fill(0), ...Array(n).fill(0), ...Array(n).fill(-127)]),
    color: Uint8Array.from({ length: 4 * n }, (_, i) => (i % 4 === 3 ? 128 : 10 * i)),
    phrases: ["seat", "work table"],
    near: Uint8Array.from([1, 250, 0, 0, 0, 0, 0, 0, 2, 200, 0, 0, 0, 0, 0, 0]),
  };
}

/** Points on the sides of a room of 5 × 4 × 2.5 m, on a table in it and on a cabinet at a wall, as the page has them. `turn`: radians about
 * the vertical; `lies`: up is y and the unit is half a meter. */
function roomScene({ ceiling = true, labels = true, turn = 0, lies = false } = {}) {
  const size = [5, 4, 2.5], places = [], kinds = [];
  const add = (kind, p) => {
    kinds.push(kind);
    places.push(p);
  };
  const fill = (kind, low, high) => {
    const step = [0, 1, 2].map((a) => (high[a] - low[a]) / Math.max(1, Math.round((high[a] - low[a]) / 0.05)));
    const counts = step.map((s, a) => (s > 0 ? Math.round((high[a] - low[a]) / s) : 1));
    for (let i = 0; i < counts[0]; i++) for (let j = 0; j < counts[1]; j++) for (let k = 0; k < counts[2]; k++) {
      add(kind, [low[0] + (i + 0.5) * step[0], low[1] + (j + 0.5) * step[1], low[2] + (k + 0.5) * step[2]]);
    }
  };
  fill("floor", [0, 0, 0], [size[0], size[1], 0]);
  if (ceiling) fill("ceiling", [0, 0, size[2]], size);
  fill("wall x0", [0, 0, 0], [0, size[1], size[2]]);
  fill("wall x1", [size[0], 0, 0], size);
  fill("wall y0", [0, 0, 0], [size[0], 0, size[2]]);
  fill("wall y1", [0, size[1], 0], size);
  fill("table", [2, 1.5, 0.7], [3, 2.5, 0.7]);
  fill("cabinet", [0.05, 1, 0], [0.05, 2, 1.5]);
  return shaped(places, kinds, { labels, turn, lies });
}

function shaped(places, kinds, { labels, turn, lies }) {
  const n = places.length, names = ["floor", "ceiling", "wall", "table", "cabinet"];
  const c = Math.cos(turn), s = Math.sin(turn);
  const toFile = ([x, y, z]) => {
    const p = [c * x - s * y, s * x + c * y, z];
    return lies ? [2 * p[0], 2 * p[2], -2 * p[1]] : p;
  };
  const label = kinds.map((kind) => (labels ? names.indexOf(kind.split(" ")[0]) + 1 : 0));
  const classes = labels ? names.map((name, i) => ({ name, color: [0, 0, 0], count: label.filter((l) => l === i + 1).length })) : [];
  return {
    about: { count: n, classes, up: lies ? [[1, 0, 0], [0, 0, -1], [0, 1, 0]] : [[1, 0, 0], [0, 1, 0], [0, 0, 1]], metresPerUnit: lies ? 0.5 : 1 },
    position: Float32Array.from(places.flatMap(toFile)), label: Uint16Array.from(label),
    scale: new Uint8Array(3 * n).fill(3), scales: Float32Array.from({ length: 256 }, (_, i) => i / 100),
    color: new Uint8Array(4 * n).fill(200),
    kinds, places, eye: ([x, y, z]) => [c * x - s * y, s * x + c * y, z],
  };
}

/** Walls and ceiling before the camera are cut away, and nothing else. */
function rooms(m) {
  for (const labels of [true, false]) for (const ceiling of [true, false]) {
    for (const [turn, lies] of [[0, false], [0.5, false], [-0.6, true]]) {
      const scene = roomScene({ ceiling, labels, turn, lies }), room = m.roomOf(scene), said = JSON.stringify({ labels, ceiling, turn, lies });
      assert.ok(room !== null, said);
      near(room.yaw, turn, 0.02);
      /** The part of each kind that is not drawn; away from edges, where two sides meet. */
      const gone = (eye) => {
        const away = m.facing(room, scene.eye(eye)), all = {}, cut = {};
        scene.kinds.forEach((kind, i) => {
          const atEdge = [[5, 0], [4, 1], [2.5, 2]].filter(([size, a]) => Math.min(scene.places[i][a], size - scene.places[i][a]) < 0.3).length > 1;
          if (atEdge) return;
          all[kind] = (all[kind] ?? 0) + 1;
          cut[kind] = (cut[kind] ?? 0) + ((room.sides[i] & away) !== 0 ? 1 : 0);
        });
        return Object.fromEntries(Object.entries(all).map(([kind, count]) => [kind, cut[kind] / count]));
      };
      const whole = { floor: 0, ...(ceiling ? { ceiling: 0 } : {}), "wall x0": 0, "wall x1": 0, "wall y0": 0, "wall y1": 0, table: 0, cabinet: 0 };
      const above = ceiling ? { ceiling: 1 } : {};
      // A cabinet at a wall stays where labels tell it from the wall.
      const beside = { "wall x0": 1, cabinet: labels ? 0 : 1 };
      assert.deepEqual(gone([-3, -4, 5]), { ...whole, ...above, ...beside, "wall y0": 1 }, said);
      assert.deepEqual(gone([8, 9, 5]), { ...whole, ...above, "wall x1": 1, "wall y1": 1 }, said);
      assert.deepEqual(gone([-3, 2, 1.5]), { ...whole, ...beside }, said);
      assert.deepEqual(gone([2.5, 2, 8]), { ...whole, ...above }, said);
      // From inside all is there.
      for (const eye of [[2.5, 2, 1.5], [0.4, 0.4, 1.5], [4.6, 3.6, 0.3]]) assert.deepEqual(gone(eye), whole, said);
    }
  }
  // A ball has no walls, and neither has uneven ground.
  const ball = Array.from({ length: 6000 }, (_, i) => {
    const z = 1 - (2 * i + 1) / 6000, r = Math.sqrt(1 - z * z);
    return [r * Math.cos(2.4 * i), r * Math.sin(2.4 * i), z];
  });
  const ground = Array.from({ length: 3600 }, (_, i) => [(i % 60) / 20, Math.floor(i / 60) / 20, 0.2 * Math.sin(i / 9) * Math.cos(i / 500)]);
  for (const points of [ball, ground]) {
    assert.equal(m.roomOf(shaped(points, points.map(() => "thing"), { labels: false, turn: 0, lies: false })), null);
  }
  assert.equal(m.roomOf(shaped([], [], { labels: false, turn: 0, lies: false })), null);
  // The first view: a corner touches what is filled of the picture, none is beyond it.
  const box = { yaw: 0.4, low: [-2, -1, 0], high: [2, 1, 2.5] };
  for (const [yaw, pitch, slopes] of [[1.3, -0.75, [0.6, 0.5]], [1.3, -0.75, [0.24, 0.5]], [0, 0.3, [1, 1]]]) {
    const distance = m.wholeFrom(box, yaw, pitch, slopes), c = Math.cos(box.yaw), s = Math.sin(box.yaw);
    const ahead = [Math.cos(pitch) * Math.cos(yaw), Math.cos(pitch) * Math.sin(yaw), Math.sin(pitch)];
    const right = [Math.sin(yaw), -Math.cos(yaw), 0];
    const up = [-Math.sin(pitch) * Math.cos(yaw), -Math.sin(pitch) * Math.sin(yaw), Math.cos(pitch)];
    let most = 0;
    for (let i = 0; i < 8; i++) {
      const [x, y, z] = [i & 1 ? 2 : -2, i & 2 ? 1 : -1, i & 4 ? 1.25 : -1.25];
      const p = [c * x - s * y, s * x + c * y, z], dot = (a) => a[0] * p[0] + a[1] * p[1] + a[2] * p[2];
      const depth = distance + dot(ahead);
      assert.ok(depth > 0);
      most = Math.max(most, Math.abs(dot(right)) / depth / slopes[0], Math.abs(dot(up)) / depth / slopes[1]);
    }
    near(most, 0.94, 1e-6);
  }
}

/** Selections that grow and shrink by 5 cm, counted in cells of half of that. */
function editing(m) {
  /** A row of Gaussians, one a centimeter, of `length` meters. */
  const row = (length, metresPerUnit) => {
    const n = Math.round(100 * length) + 1;
    return {
      about: { count: n, metresPerUnit }, label: Uint16Array.from({ length: n }, (_, i) => (i < 150 ? 1 : 2)),
      position: Float32Array.from({ length: 3 * n }, (_, k) => (k % 3 === 1 ? Math.floor(k / 3) / 100 / metresPerUnit : 7)),
    };
  };
  const from = (chosen, n) => Uint8Array.from({ length: n }, (_, i) => (chosen(i) ? 1 : 0));
  const ends = (s) => [s.indexOf(1), s.lastIndexOf(1), s.reduce((sum, v) => sum + v, 0)];
  for (const unit of [1, 0.25]) {
    const data = row(3, unit), n = data.about.count, middle = from((i) => i >= 100 && i < 200, n);
    const [a, b, count] = ends(m.grown(data, middle, new Set(), 1));
    assert.ok(a >= 92 && a <= 97 && b >= 202 && b <= 207 && count === b - a + 1, `${a} ${b} ${count}`);
    const [c, d, fewer] = ends(m.grown(data, middle, new Set(), -1));
    assert.ok(c >= 102 && c <= 107 && d >= 192 && d <= 197 && fewer === d - c + 1, `${c} ${d} ${fewer}`);
    // One that is missing inside makes no hole, and what is hidden neither comes in nor holds back.
    const [, , holed] = ends(m.grown(data, from((i) => i >= 100 && i < 200 && i !== 149, n), new Set(), -1));
    assert.equal(holed, fewer - 1);
    const right = from((i) => i >= 150 && i < 200, n);
    assert.equal(ends(m.grown(data, right, new Set([1]), 1))[0], 150);
    assert.equal(ends(m.grown(data, right, new Set([1]), -1))[0], 150);
    assert.ok(ends(m.grown(data, right, new Set(), 1))[0] < 150);
  }
  // Small things by less: a step of a fiftieth of the longest side.
  const small = row(0.8, 1), [a, b] = ends(m.grown(small, from((i) => i >= 20 && i < 30, 81), new Set(), 1));
  assert.ok(a >= 18 && a < 20 && b > 29 && b < 32, `${a} ${b}`);
  assert.deepEqual([...m.grown({ ...row(0, 1), label: Uint16Array.from([1]) }, Uint8Array.from([1]), new Set(), 1)], [1]);
  const past = new m.Past(3);
  for (const [state, kind] of [[0, null], [1, null], [2, "slider"], [3, "slider"], [4, null]]) past.note(state, kind);
  assert.deepEqual([past.back(), past.back(), past.isEmpty, past.back(), past.isEmpty, past.back()], [4, 2, false, 1, true, null]);
}

export async function check(m) {
  // Codes: by WebAssembly, in plain code, and by hand; widths that fill no eight.
  for (const width of [1, 3, 8, 24, 31]) {
    const rows = 37, texts = 5;
    const packed = Int8Array.from({ length: rows * width }, (_, i) => ((i * 37 + 11) % 255) - 127);
    const weights = Float32Array.from({ length: texts * (width + 1) }, (_, i) => Math.sin(i) / (127 * width));
    const hand = (row, text) => {
      let sum = weights[text * (width + 1)];
      for (let j = 0; j < width; j++) sum += weights[text * (width + 1) + 1 + j] * packed[row * width + j];
      return sum;
    };
    const fast = new m.Codes(packed, rows, width, weights, 4), plain = new m.Codes(packed, rows, width, weights, 4, true);
    const all = [0, 1, 2, 3, 4, ...Array.from({ length: 300 }, () => 4)];
    for (const asked of [[0], [4], [1, 3, 2], [4, 3, 2, 1, 0], all]) {
      const [a, b] = [fast.scores(asked).slice(), plain.scores(asked)];
      for (let row = 0; row < rows; row++) {
        const want = Math.max(...asked.map((text) => hand(row, text)));
        near(a[row], want, 1e-4);
        near(b[row], want, 1e-4);
      }
      // Where they lie in their range, and who wins; with no rows left over behind fours, and some.
      const [x, y] = [fast, plain].map((codes) => codes.graded(asked, 0.02));
      const scores = Array.from({ length: rows }, (_, row) => Math.max(...asked.map((text) => hand(row, text))));
      const [low, high] = [Math.min(...scores), Math.max(...scores)];
      for (const graded of [x, y]) {
        near(graded.range[0], low, 1e-4);
        near(graded.range[1], high, 1e-4);
        scores.forEach((score, row) => {
          near(graded.heat[row], (255 * (score - low)) / (high - low), 1.5);
          const lead = score - Math.max(...[0, 1, 2, 3].map((text) => hand(row, text))) + 0.02;
          if (Math.abs(lead) > 1e-3) assert.equal(graded.wins[row], lead > 0 ? 1 : 0, `${width} ${asked} ${row} ${lead}`);
        });
        assert.equal(Math.max(...graded.heat), 255);
      }
    }
    for (let row = 0; row < rows; row++) {
      // The best of the classes; the fifth text is none.
      const want = Math.max(...[0, 1, 2, 3].map((text) => hand(row, text)));
      near(fast.best[row], want, 1e-4);
      near(plain.best[row], want, 1e-4);
      near(fast.score(row, 4), hand(row, 4), 1e-6);
    }
  }

  // One row, none, and rows of the same score.
  for (const plain of [false, true]) {
    const texts = Float32Array.from([0.25, 0.5]);
    const of = (values) => new m.Codes(Int8Array.from(values), values.length, 1, texts, 1, plain).graded([0], 0.02);
    assert.deepEqual([...of([]).heat], []);
    assert.deepEqual([of([3]).heat[0], of([3]).wins[0]], [0, 1]);
    assert.deepEqual([...of([7, 7, 7, 7, 7]).heat], [0, 0, 0, 0, 0]);
    near(of([7, 7, 7, 7, 7]).range[0], 3.75, 1e-3);
    assert.deepEqual([...of([5, 5, 5, 5, 6]).heat], [0, 0, 0, 0, 255]);
    assert.deepEqual([...of([6, 5, 5, 5, 5]).heat], [255, 0, 0, 0, 0]);
  }

  const data = scene(m), book = new m.PhraseBook(data);
  const ask = (text) => m.answer(data, book, text);
  const chosen = (found, wins = true, threshold = found.threshold) => Array.from(m.selection(found, threshold, wins));
  // The winner of each, not the second: rows 0 and 1 are chairs.
  assert.deepEqual(chosen(ask("chairs")), [1, 1, 0, 0, 0, 0]);
  // Row 3 is as much a desk as a lamp.
  assert.deepEqual(chosen(ask("desk")), [0, 0, 1, 1, 0, 0]);
  assert.deepEqual(chosen(ask("lamp")), [0, 0, 0, 1, 1, 0]);
  assert.deepEqual(chosen(ask("furniture")), [1, 1, 1, 1, 0, 0]);
  // Without the other classes, by the threshold alone: what is as warm as it counts, what is colder does not.
  const chair = ask("chair");
  assert.deepEqual([chair.heat[0], chair.heat[2]], [255, 0]);
  near(chair.heat[1], (255 * 100) / 127, 1);
  assert.deepEqual(chosen(chair, false, 1), [1, 1, 0, 0, 0, 0]);
  assert.deepEqual(chosen(chair, false, chair.heat[1]), [1, 1, 0, 0, 0, 0]);
  assert.deepEqual(chosen(chair, false, chair.heat[1] + 1), [1, 0, 0, 0, 0, 0]);
  near(chair.range[1], 1, 1e-3);
  // A color before a class, a phrase, a typing error, nonsense.
  near(ask("red chair").range[1], 0.85, 1e-3);
  assert.match(ask("a seat").how, /taken as “chair” \(0\.98\)/);
  assert.match(ask("work table").how, /taken as “desk”/);
  assert.match(ask("chiar").how, /“chiar” taken as “chair”/);
  assert.deepEqual([ask("xqzzt").isUnknown, chosen(ask("xqzzt"))], [true, [0, 0, 0, 0, 0, 0]]);
  // Names in other languages, with their articles; a sentence around them is none.
  for (const [name, as] of [["der Stuhl", "chair"], ["Sessel", "chair"], ["une bureau", "desk"], ["l’abat-jour", "lamp"]]) {
    assert.equal(ask(name).how, `taken as “${as}”`);
    assert.deepEqual(chosen(ask(name)), chosen(ask(as)));
  }
  assert.deepEqual([ask("zwei Stuhl").isUnknown, ask("der").isUnknown], [true, true]);
  // Relations go one way.
  assert.deepEqual(ask("the lamp on the desk").objects, [2]);
  assert.deepEqual(ask("desk on the lamp").objects, []);
  assert.deepEqual(ask("desk under a lamp").objects, [1]);
  assert.deepEqual(chosen(ask("lamp on desk")), [0, 0, 0, 0, 1, 0]);
  // What is denied, or stands where objects do not tell, is not answered by what is named.
  const refused = [["not a chair", /denies/], ["no desk", /denies/], ["all but not chairs", /denies/], ["everything other than the lamp", /denies/],
    ["what isn’t a chair", /denies/], ["!chair", /denies/], ["exept chairs", /denies/], ["chair left of the desk", /“left of”/],
    ["red chair on the desk", /color/]];
  for (const [text, how] of refused) {
    assert.match(ask(text).how, how);
    assert.deepEqual([text, ask(text).isUnknown, chosen(ask(text))], [text, true, [0, 0, 0, 0, 0, 0]]);
  }
  for (const text of ["another chair", "knot", "button", "north wall", "nonstick pan"]) assert.equal(book.denies(text), false, text);
  // Which of two: warmer than the middle.
  const versus = ask("chair vs lamp");
  assert.ok(versus.heat[0] > 200 && versus.heat[4] < 50 && versus.heat[5] === 127, Array.from(versus.heat).join());
  const some = m.foundObjects(data, Uint8Array.from([1, 0, 1, 1, 0, 1]));
  assert.deepEqual([some.count, some.objects.map((o) => [o.object, o.count])], [4, [[1, 2], [0, 1]]]);
  // Without codes by the labels.
  const labelled = { ...data, codes: null };
  assert.deepEqual(chosen(m.answer(labelled, new m.PhraseBook(labelled), "desk")), [0, 0, 1, 1, 0, 0]);

  // Colors: a class in its own, what is hidden not at all, what is selected by its heat.
  const out = new Uint8Array(24);
  m.paint(data, { mode: "labels", hidden: new Set([2]), found: null, selected: null, cut: null }, out);
  assert.deepEqual([out[3], out[11], out[15]], [128, 0, 0]);
  assert.ok(out[1] > out[0] && out[1] > out[2]);
  m.paint(data, { mode: "labels", hidden: new Set(), found: chair, selected: m.selection(chair, 1, true), cut: null }, out);
  assert.ok(out[0] > 150 && out[2] < 60, "the hottest is yellow");
  assert.ok(Math.abs(out[20] - out[21]) < 3, "what is not selected is grey");
  // What belongs to a side that is cut away is not drawn, in any coloring.
  const cut = { sides: Uint8Array.from([0, 1, 2, 3, 4, 6]), away: 2 };
  for (const mode of m.MODES) {
    m.paint(data, { mode, hidden: new Set(), found: null, selected: null, cut }, out);
    assert.deepEqual([3, 7, 11, 15, 19, 23].map((i) => out[i]), [128, 128, 0, 0, 128, 0], mode);
  }
  rooms(m);
  editing(m);
  // The legend: by size, the building's parts last, what does not occur not at all.
  const legend = [["Wall", 900], ["chair", 5], ["wallpaper", 4], ["inner wall", 800], ["HouseWall", 700], ["lamp", 0], ["floor", 950],
    ["table", 70], ["wall clock", 3], ["ceiling", 1], ["x".repeat(100_000), 2], ["chair two", 5]];
  const sorted = m.legendOrder(legend.map(([name, count]) => ({ name, count, color: [0, 0, 0] }))).map((i) => legend[i][0].slice(0, 10));
  assert.deepEqual(sorted, ["table", "chair", "chair two", "wallpaper", "wall clock", "xxxxxxxxxx",
    "floor", "Wall", "inner wall", "HouseWall", "ceiling"]);

  // Files: rows of the scene's file, formulas that are none, values as they were.
  assert.deepEqual(["=1+1", "-x", "a,b", 'say "x"', "\tx"].map(m.field), ["'=1+1", "'-x", '"a,b"', '"say ""x"""', "'\tx"]);
  const lines = m.csv(data, Uint8Array.from([0, 1, 0, 0, 0, 1])).split("\n");
  assert.deepEqual(lines, ["row,x,y,z,class,score,object", "2,0.75000,1.00000,1.25000,chair,0.502,1", "8,3.75000,4.00000,4.25000,,0.000,", ""]);
  const ply = m.ply(data, Uint8Array.from([0, 0, 0, 0, 1, 0]));
  const text = Buffer.from(ply).toString("latin1");
  const view = new DataView(ply.buffer, text.indexOf("end_header\n") + 11);
  assert.match(text, /element vertex 1\n/);
  assert.deepEqual([0, 1, 2].map((i) => view.getFloat32(4 * i, true)), [3, 3.25, 3.5]);
  [0.01, 0.02, 0.03].forEach((s, i) => near(view.getFloat32(4 * (7 + i), true), Math.log(s), 1e-5));
  [Math.SQRT1_2, 0, 0, -Math.SQRT1_2].forEach((q, i) => near(view.getFloat32(4 * (10 + i), true), q, 1e-6));
  assert.deepEqual([14, 15, 16].map((i) => view.getInt32(4 * i, true)), [2, 2, 6]);

  // Addresses: nothing of them is believed that is out of range.
  const back = m.readHash("#mode=objects&query=red+chair&threshold=77&hide=2,0,-1,99999,x&camera=1,2,3,4,5,6");
  assert.deepEqual(back, { mode: "objects", query: "red chair", threshold: 77, hidden: [2, 0], camera: [1, 2, 3, 4, 5, 6], cut: true });
  assert.deepEqual(m.readHash("#mode=x&threshold=256&camera=1,2,NaN,4,5,6"), { mode: null, query: "", threshold: null, hidden: [], camera: null, cut: true });
  assert.equal(m.readHash("#cut=0").cut, false);
  // Round numbers.
  assert.deepEqual(m.ticks(0, 1, false, 5).map((v) => Math.round(10 * v)), [0, 2, 4, 6, 8, 10]);
  assert.deepEqual(m.ticks(0.4, 30, true), [0.5, 1, 2, 5, 10, 20]);
  // No two ticks have the same text, which says where they are.
  const ranges = [[0.99998, 1.00002], [1e6, 1e6 + 1], [-1e6 - 1, -1e6], [-0.31, -0.29], [99, 101], [0, 3e-7], [1e12, 1e12 + 1], [0.95, 1.05]];
  for (const [low, high] of ranges) {
    const at = m.ticks(low, high, false);
    const said = m.labels(at, m.digits);
    assert.ok(said.length >= 4 && said.every((s, i) => s !== said[i + 1]), said.join(" "));
    said.forEach((s, i) => near(Number(s), at[i], 0.01 * (at[1] - at[0])));
  }
  for (const text of [m.seconds, (v, most) => m.bytes(1e6 * v, most), (v, most) => `${m.digits(100 * v, most)} %`]) {
    for (const [low, high] of [[7000, 7001], [0.02, 0.0201], [119.9, 120.1]]) {
      const said = m.labels(m.ticks(low, high, false), text);
      assert.ok(said.every((s, i) => s !== said[i + 1]), said.join(" | "));
    }
  }
  assert.deepEqual([m.seconds(0.0004), m.seconds(0.02), m.seconds(90), m.seconds(300), m.bytes(5e6)], ["400 µs", "20 ms", "90 s", "5 min", "5 MB"]);
}

if (process.argv[1] === new URL(import.meta.url).pathname) {
  await check(await modules());
  console.log("answers of the page: as by hand");
}
