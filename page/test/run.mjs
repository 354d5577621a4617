// Looks at pages as a browser shows them: node test/run.mjs FOLDER [SCREENSHOTS].
//
// FOLDER holds what `cargo test --workspace --test suite -- page::` wrote. SCENESPLAT_PROGRAM names the
// program whose `view --serve` is tried as well.
import assert from "node:assert/strict";
import { existsSync, mkdirSync, readFileSync } from "node:fs";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";
import { accessible } from "./accessible.mjs";
import { chromium, launch, open, percentiles, pixels, ready, seen, settled } from "./browser.mjs";
import { controls } from "./controls.mjs";
import { large } from "./large.mjs";
import { reports } from "./reports.mjs";
import { served } from "./served.mjs";

const folder = resolve(process.argv[2] ?? "pages");
const shots = process.argv[3] ? resolve(process.argv[3]) : null;
if (shots) mkdirSync(shots, { recursive: true });
const executable = chromium();
if (executable === null) {
  console.error("*** NOT RUN: no chromium; install it, or name it in CHROMIUM ***");
  process.exit(3);
}
const url = (name) => pathToFileURL(`${folder}/${name}`).href;
const shot = async (page, name) => {
  if (shots) await page.screenshot({ path: `${shots}/${name}.png` });
};
const text = (page, id) => page.$eval(`#${id}`, (e) => e.textContent);
const truth = JSON.parse(readFileSync(`${folder}/room.json`, "utf8"));

const browser = await launch(executable);
const times = {};
try {
  {
    const { page, bad, began } = await open(browser, url("room.html"));
    await ready(page);
    times.loaded_ms = Math.round(performance.now() - began);
    const drawn = await seen(page, 0.15);
    times.first_picture_ms = Math.round(performance.now() - began);
    assert.ok(drawn > 0.15, `the picture is blank: ${drawn}`);
    await settled(page);
    assert.match(await text(page, "count"), /Gaussians/);

    // A typed query: what the program says is selected is selected, and has the colors of heat.
    await page.type("#query", "chair");
    await page.keyboard.press("Enter");
    await settled(page);
    assert.match(await text(page, "summary"), /“chair”: [\d\u2009]+ Gaussians, \d+ object/);
    const found = await page.evaluate((rows) => {
      const selected = globalThis.scenesplat.selected();
      const both = rows.filter((r) => selected[r] === 1).length;
      const all = selected.reduce((sum, s) => sum + s, 0);
      return { iou: both / (all + rows.length - both), all };
    }, truth.chair);
    assert.ok(found.iou > truth.least_iou, `chair: IoU ${found.iou} with the labels of the program`);
    await shot(page, "chair");
    const where = await page.evaluate(() => {
      const { selected, project, pick } = globalThis.scenesplat;
      const s = selected();
      const hits = [];
      for (let row = 0; row < s.length && hits.length < 40; row += 7) {
        if (s[row] !== 1) continue;
        const at = project(row);
        if (at === null || at[0] < 360 || at[0] > 940 || at[1] < 20 || at[1] > 620) continue;
        const seen = pick(at[0], at[1]);
        if (seen >= 0 && s[seen] === 1) hits.push(at);
      }
      return hits;
    });
    assert.ok(where.length > 5, "no selected Gaussian is in the picture");
    const heat = await pixels(page, where);
    const colored = heat.at.filter(([r, g, b]) => Math.max(r, g, b) - Math.min(r, g, b) > 25).length;
    assert.ok(colored > 0.6 * where.length, `${colored} of ${where.length} selected places have a color`);

    // A click names what is there.
    await page.mouse.click(where[0][0], where[0][1]);
    assert.match(await text(page, "facts"), /chair/);
    assert.match(await text(page, "facts"), /place/);
    await shot(page, "click");

    // Typing errors, plurals, phrases, colors, relations, nonsense.
    for (const [typed, expected] of truth.phrases) {
      await page.evaluate((t) => globalThis.scenesplat.ask(t), typed);
      const said = `${await text(page, "summary")} ${await text(page, "how")}`;
      assert.match(said, new RegExp(expected, "i"), `${typed}: ${said}`);
    }

    // Keys alone: find, another mode, clear, home, what is in the middle, inverted.
    await page.focus("#canvas");
    await page.keyboard.press("/");
    assert.equal(await page.evaluate(() => document.activeElement.id), "query");
    await page.keyboard.down("Control");
    await page.keyboard.press("a");
    await page.keyboard.up("Control");
    await page.keyboard.type("floor");
    await page.keyboard.press("Enter");
    assert.match(await text(page, "summary"), /floor/);
    await page.keyboard.press("Escape");
    assert.equal(await page.$eval("#results", (e) => e.hidden), true);
    for (const [key, mode] of [["1", "colors"], ["2", "labels"], ["3", "objects"], ["4", "confidence"], ["5", "features"]]) {
      await page.keyboard.press(key);
      const pressed = await page.$eval('#modes [aria-pressed="true"]', (b) => b.dataset.mode);
      assert.equal(pressed, mode);
      await settled(page);
      assert.ok((await pixels(page, [])).drawn > 0.15, `${mode} is blank`);
      await shot(page, mode);
    }
    const before = await page.evaluate(() => location.hash);
    await page.keyboard.down("w");
    await new Promise((r) => setTimeout(r, 400));
    await page.keyboard.up("w");
    await page.waitForFunction((old) => location.hash !== old, { timeout: 10_000 }, before);
    await page.keyboard.press("h");
    // Tab reaches every control, in order.
    const reached = new Set();
    for (let i = 0; i < 60; i++) {
      await page.keyboard.press("Tab");
      reached.add(await page.evaluate(() => document.activeElement.id || document.activeElement.className || document.activeElement.tagName));
    }
    assert.ok(reached.has("query") && reached.has("name"), [...reached].join(" "));

    // Queries are fast; the address brings the same view back.
    times.query_ms = percentiles(await page.evaluate(() => {
      const { ask, queryTimes } = globalThis.scenesplat;
      queryTimes.length = 0;
      for (let i = 0; i < 40; i++) ask(["chair", "table", "red chair", "floor", "something to sit on"][i % 5]);
      return [...queryTimes];
    }));
    await page.evaluate(() => { document.getElementById("query").value = "table"; globalThis.scenesplat.ask("table"); });
    await page.waitForFunction(() => /query=table/.test(location.hash), { timeout: 10_000 });
    const summary = await text(page, "summary");
    const link = page.url();
    assert.deepEqual(bad, []);
    await page.close();
    const again = await open(browser, link);
    await ready(again.page);
    assert.equal(await text(again.page, "summary"), summary);
    assert.deepEqual(again.bad, []);
    await again.page.close();
  }
  await controls(browser, url, shot);
  await accessible(browser, url);
  {
    // Names that would be markup, a class of a megabyte, emoji: text, and nothing runs.
    const { page, bad } = await open(browser, url("hostile.html"));
    await ready(page);
    await settled(page);
    await shot(page, "hostile");
    assert.equal(await page.evaluate(() => globalThis.attacked), undefined);
    // Warnings are seen without a click, as text.
    const warned = await page.$eval("#warnings", (e) => ({ text: e.textContent, height: e.getBoundingClientRect().height, inside: e.querySelector("img, script") }));
    assert.ok(warned.text.startsWith("up is unclear ") && warned.height > 10 && warned.inside === null, JSON.stringify(warned));
    const names = await page.$$eval("#classes .name", (all) => all.map((e) => e.textContent));
    assert.ok(names.some((n) => n.includes("</script>")), names.join(" | ").slice(0, 300));
    assert.ok(names.some((n) => n.includes("🪑")));
    assert.ok(names.every((n) => n.length <= 70), "long names are cut");
    assert.equal(await page.$$eval("#classes img, #classes script, #object-list img", (all) => all.length), 0);
    for (const typed of ["</script>", "<img src=x onerror=globalThis.attacked=1>", "🪑", "\u202e", "a".repeat(5000)]) {
      await page.evaluate((t) => globalThis.scenesplat.ask(t), typed);
    }
    assert.equal(await page.evaluate(() => globalThis.attacked), undefined);
    assert.deepEqual(bad, []);
    await page.close();
    const evil = "#mode=%3Cscript%3E&query=%3Cimg%20src%3Dx%20onerror%3Dattacked%3D1%3E&hide=-1,1e9,x&camera=NaN,1,2,3,4,Infinity";
    const hash = await open(browser, url("hostile.html") + evil);
    await ready(hash.page);
    assert.equal(await hash.page.evaluate(() => globalThis.attacked), undefined);
    assert.deepEqual(hash.bad, []);
    await hash.page.close();
  }
  {
    // Without labels there is still the scene.
    const { page, bad } = await open(browser, url("plain.html"));
    await ready(page);
    await settled(page);
    assert.ok((await pixels(page, [])).drawn > 0.1, "plain is blank");
    assert.equal(await page.$$eval("#modes button", (all) => all.length), 1);
    assert.equal(await page.$eval("#warnings", (e) => e.getBoundingClientRect().height), 0);
    assert.deepEqual(bad, []);
    await page.close();
  }
  await reports(browser, url, shot);
  if (existsSync(`${folder}/large.html`)) times.large = await large(browser, folder, url, shot);
  else console.error("NOT RUN: the page of 1.5 million Gaussians (LARGE=1 .ci/page)");
} finally {
  await browser.close();
}
if (process.env.SCENESPLAT_PROGRAM) {
  await served((more) => launch(executable, true, more), process.env.SCENESPLAT_PROGRAM, folder, shot);
} else {
  console.error("*** NOT RUN: view --serve in a browser; name the program in SCENESPLAT_PROGRAM ***");
}
const blind = await launch(executable, false);
try {
  const { page, bad } = await open(blind, url("room.html"));
  await page.waitForSelector("#message:not([hidden])", { timeout: 30_000 });
  assert.match(await text(page, "message"), /WebGL 2/);
  assert.match(await text(page, "classes"), /chair/);
  await shot(page, "no-webgl");
  assert.deepEqual(bad, []);
} finally {
  await blind.close();
}
console.log(`pages: all right; ${JSON.stringify(times)}`);
