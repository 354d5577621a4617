// Would the tests of the page notice? Plants known bugs in its sources, one at a time, and expects `logic.mjs` to fail:
// node test/mutations.mjs. (.ci/mutations does the same for what is written in Rust.)
import { check, modules } from "./logic.mjs";

const BUGS = [
  ["the runner-up answers", "codes.ts", "p.grade(p.at[2], p.at[3],", "p.grade(p.at[3], p.at[2],"],
  ["the runner-up answers in plain code", "codes.ts", "out[row] >= Math.fround", "out[row] < Math.fround"],
  ["the last rows are not graded", "codes.ts", "p.at[3], rows, low", "p.at[3], rows & ~3, low"],
  ["the lowest of the last rows is forgotten", "codes.ts", "p.range(p.at[2], rows,", "p.range(p.at[2], rows & ~3,"],
  ["every Gaussian has the code of its number", "query.ts", "if (data.ownSlots)", "if (!data.ownSlots)"],
  ["the threshold is turned round", "query.ts", "heat[i] >= least &&", "heat[i] <= least &&"],
  ["the threshold leaves out what is as warm", "query.ts", "heat[i] >= least &&", "heat[i] > least &&"],
  ["a relation goes both ways", "query.ts", "what.members.includes(objects[a].label) && to.members.includes(objects[b].label)",
    "what.members.includes(objects[b].label) && to.members.includes(objects[a].label)"],
  ["what is denied is what is asked for", "query.ts", "if (book.denies(text))", "if (book.denies(text) && text.length > 500)"],
  ["denials of several words are none", "phrases.ts", "phrase.includes(` ${denial} `)", "all.includes(denial)"],
  ["articles of other languages are part of the name", "phrases.ts", "(word) => !this.articles.has(word)", "() => true"],
  ["a place that objects do not tell is left out", "query.ts", "if (asked.relation === null)", "if (asked.relation === undefined)"],
  ["objects are counted from one", "query.ts", "found.has(data.object[i] - 1)", "found.has(data.object[i])"],
  ["a group is its first class", "codes.ts", "this.into(this.out, texts);", "this.into(this.out, texts.slice(0, 1));"],
  ["a text before the last many is forgotten", "codes.ts", "if (v > out[s]) out[s] = v;", ""],
  ["offsets of several texts are those of the next", "codes.ts", "four / 2 + (i & 3)", "four / 2 + ((i + 1) & 3)"],
  ["codes of a width that fills no eight shift", "codes.ts", "row * this.stride);", "row * width);"],
  ["the offset of a text is forgotten", "codes.ts", "let sum = weights[0];\n        for", "let sum = 0;\n        for"],
  ["formulas are formulas", "exporting.ts", "/^[=+\\-@\\t\\r]/.test(text)", "/^[=+@\\t\\r]/.test(text)"],
  ["the real part of a rotation comes last", "exporting.ts", "...rotationOf(data, i),",
    "...[1, 2, 3, 0].map((k) => rotationOf(data, i)[k]),"],
  ["rows are those of the page", "exporting.ts", "data.rows.length > 0 ? data.rows[i] : i", "i"],
  ["hidden classes stay", "colors.ts", "shown.hidden.forEach((h) => (opaque[h] = 0));", ""],
  ["near walls stay", "room.ts", "sides[i] |= 1 << s;", ""],
  ["far walls are cut away", "room.ts", "way < 0 ? box.low[axis] - p[axis]", "way > 0 ? box.low[axis] - p[axis]"],
  ["walls are cut away from inside, too", "room.ts", "beyond(room, s, at) > 0", "beyond(room, s, at) > -10"],
  ["what stands at a wall is cut away with it", "room.ts", "!labeled || isKind(c.name, kinds)", "true"],
  ["walls lie along the axes", "room.ts", "if (area < least) [best", "if (area < 0) [best"],
  ["scenes lie as their file has them", "room.ts", "row[c] * metresPerUnit", "row[c]"],
  ["a lone object has walls", "room.ts", "|| cornersOf(box, inside) < LEAST_CORNERS", ""],
  ["the first view is cropped", "room.ts", "(FILLED * slopes[0]) - ahead", "(FILLED * slopes[0])"],
  ["what is cut away is drawn", "colors.ts", "out[4 * i + 3] = 0;", ";"],
  ["the building comes first", "classes.ts", "building[a] - building[b] ||", ""],
  ["a wall clock is a wall", "classes.ts", ".at(-1) ??", ".at(0) ??"],
  ["what shrinks grows", "editing.ts", "const now = by === 1 ? 1 : 0;", "const now = 1;"],
  ["what is hidden is taken in", "editing.ts", "(hidden.has(data.label[i]) ? 0 : 1)", "1"],
  ["single Gaussians make holes", "editing.ts", "balance[cell] >= 0", "balance[cell] > 3"],
  ["steps are in the unit of the file", "editing.ts", "REACH / metresPerUnit", "REACH"],
  ["small things are edited by as much as rooms", "editing.ts", "SHARE * longest", "Infinity"],
  ["a slider fills what can be undone", "editing.ts", "if (kind !== null && this.states.at(-1)?.kind === kind) return;", ""],
  ["a camera that is none is believed", "hash.ts", "camera.length === 6 && camera.every(Number.isFinite)", "camera.length === 6"],
];

await check(await modules());
let survived = 0;
for (const [what, file, from, to] of BUGS) {
  let caught = null;
  const planted = await modules([[file, from, to]]);
  try {
    await check(planted);
  } catch (error) {
    caught = String(error.message).split("\n")[0].slice(0, 80);
  }
  if (caught === null) survived++;
  console.log(`${caught === null ? "SURVIVED" : "caught"}: ${what}${caught === null ? "" : ` (${caught})`}`);
}
console.log(`${BUGS.length} planted, ${BUGS.length - survived} caught`);
process.exit(survived > 0 ? 1 : 0);
