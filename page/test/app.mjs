// The page of `scenesplat app` in a browser: node test/app.mjs APP.html SHOTS [SCENE FOLDER]...
//
// FOLDER is what `scenesplat segment SCENE --out FOLDER` wrote: at least 99.9 % of the labels have to be its. Without scenes only
// files that are none are tried.
import assert from "node:assert/strict";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, resolve } from "node:path";
import { pathToFileURL } from "node:url";
import { none } from "./accessible.mjs";
import { chromium, launch, open, seen, settled } from "./browser.mjs";
import { npy } from "./engine.mjs";

const [app, shots, ...given] = process.argv.slice(2);
const url = pathToFileURL(resolve(app)).href;
mkdirSync(shots, { recursive: true });
const executable = chromium();
if (executable === null) {
  console.error("*** NOT RUN: no chromium; install it, or name it in CHROMIUM ***");
  process.exit(3);
}
const browser = await launch(executable);
const text = (page, id) => page.$eval(`#${id}`, (e) => e.textContent);

/** Lets a file fall onto the page, as from a desktop. */
async function drop(page, path) {
  const session = await page.createCDPSession();
  const data = { items: [], files: [resolve(path)], dragOperationsMask: 1 };
  for (const type of ["dragEnter", "dragOver", "drop"]) {
    await session.send("Input.dispatchDragEvent", { type, x: 300, y: 300, data });
  }
  await session.detach();
}

async function waiting(page) {
  await page.waitForSelector("#drop", { timeout: 120_000 });
}

/** Waits until a scene is shown or a message says why not; gives the message. */
async function done(page) {
  await page.waitForFunction(() => !document.body.classList.contains("working")
    && (document.querySelector("#message:not([hidden])") !== null || globalThis.scenesplat?.ready === true), { timeout: 3_600_000, polling: 200 });
  return page.$eval("#message", (e) => (e.hidden ? null : e.textContent));
}

/** Files that are no scene, or too much of one: [name, bytes, what the message says]. */
function hostile() {
  const ply = (count, body) => Buffer.concat([Buffer.from(`ply\nformat binary_little_endian 1.0\nelement vertex ${count}\n${
    ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
      .map((f) => `property float ${f}\n`).join("")}end_header\n`), body]);
  const one = new Float32Array([0, 0, 0, 0, 0, 0, 0, -3, -3, -3, 1, 0, 0, 0]);
  const splats = Buffer.alloc(32 * 2_000_001);
  for (let at = 0; at < splats.length; at += 32) {
    for (let k = 0; k < 3; k++) splats.writeFloatLE(0.01, at + 12 + 4 * k);
    splats.set([200, 200, 200, 255, 255, 128, 128, 128], at + 24);
  }
  return [
    ["empty.ply", Buffer.alloc(0), /empty.ply/],
    ["text.ply", Buffer.from("this is no scene <img src=x onerror=attacked=1>"), /text.ply/],
    ["cut.ply", ply(1000, Buffer.from(one.buffer)), /cut.ply/],
    ["huge.ply", ply(4_000_000_000_000, Buffer.from(one.buffer)), /huge.ply/],
    ["nan.ply", ply(1, Buffer.from(new Float32Array(14).fill(NaN).buffer)), /nan.ply/],
    ["zip.sog", Buffer.from("504b0304140000000800", "hex"), /zip.sog/],
    ["gzip.spz", Buffer.from("1f8b0800000000000003ffff", "hex"), /gzip.spz/],
    ["<b>&.glb", Buffer.from("glTF\x02\0\0\0\xff\xff\xff\xff", "latin1"), /glb/],
    ["many.splat", splats, /2000001 Gaussians.*at most 2000000.*crop/s],
  ];
}

const report = {};
const folder = mkdtempSync(`${tmpdir()}/app-`);
try {
  {
    const { page, bad } = await open(browser, url);
    await waiting(page);
    await page.screenshot({ path: `${shots}/app-empty.png` });
    await none(page, "the page that waits for a file");
    report.messages = {};
    for (const [name, bytes, says] of hostile()) {
      const path = `${folder}/${name}`;
      writeFileSync(path, bytes);
      await page.evaluate(() => { document.getElementById("message").hidden = true; });
      await drop(page, path);
      await page.waitForFunction(() => document.querySelector("#message:not([hidden])") !== null, { timeout: 300_000 });
      const message = await done(page);
      assert.match(message, says, `${name}: ${message}`);
      report.messages[name] = message;
    }
    assert.equal(await page.evaluate(() => globalThis.attacked), undefined);
    await page.screenshot({ path: `${shots}/app-refused.png` });
    assert.deepEqual(bad, []);
    await page.close();
  }
  report.scenes = {};
  for (let i = 0; i < given.length; i += 2) {
    const [scene, labels] = given.slice(i, i + 2);
    const name = basename(scene);
    const mobile = i === 2;
    const { page, bad } = await open(browser, url, mobile ? { width: 390, height: 844, mobile } : { width: 1280, height: 800 });
    await waiting(page);
    await drop(page, scene);
    await page.waitForFunction(() => /\d %/.test(document.getElementById("loading-text").textContent), { timeout: 120_000 });
    // The page answers while the worker works.
    const lag = await page.evaluate(() => new Promise((done) => {
      let most = 0, last = performance.now(), n = 0;
      const tick = () => {
        const now = performance.now();
        most = Math.max(most, now - last);
        last = now;
        if (++n < 40) setTimeout(tick, 25);
        else done(most);
      };
      tick();
    }));
    await page.screenshot({ path: `${shots}/app-working-${name}.png` });
    assert.equal(await done(page), null);
    await page.waitForFunction(() => globalThis.scenesplat?.ready === true, { timeout: 600_000, polling: 100 });
    const drawn = await seen(page, 0.1);
    await settled(page);
    await page.screenshot({ path: `${shots}/app-${name}.png` });
    const want = npy(`${labels}/labels.npy`);
    const got = Buffer.from(await page.evaluate(() => {
      const { label } = globalThis.scenesplat.data;
      let out = "";
      for (const l of new Uint8Array(label.buffer, label.byteOffset, label.byteLength)) out += String.fromCharCode(l);
      return btoa(out);
    }), "base64");
    const found = new Uint16Array(got.buffer, got.byteOffset, got.length / 2);
    assert.equal(found.length, want.length);
    const same = found.reduce((sum, l, row) => sum + (l - 1 === want[row] ? 1 : 0), 0) / want.length;
    const { seconds, memory, total } = await page.evaluate(() => globalThis.scenesplatApp);
    await page.type("#query", "chair");
    await page.keyboard.press("Enter");
    await settled(page);
    const summary = await text(page, "summary");
    report.scenes[name] = { gaussians: want.length, same, seconds, total, memoryMiB: memory / 2 ** 20, drawn, lagMs: lag, summary, mobile };
    console.log(name, JSON.stringify(report.scenes[name]));
    assert.ok(same >= 0.999, `${name}: ${same} of the labels are the program's`);
    assert.match(summary, /“chair”/);
    // A second scene takes the place of the first.
    if (i === 0) {
      await saved(page, report);
      const small = `${folder}/text.ply`;
      await drop(page, small);
      await page.waitForFunction(() => document.querySelector("#message:not([hidden])") !== null, { timeout: 60_000 });
      await page.evaluate(() => { globalThis.scenesplat = undefined; document.getElementById("message").hidden = true; });
      await drop(page, scene);
      assert.equal(await done(page), null);
      await page.waitForFunction(() => globalThis.scenesplat?.ready === true, { timeout: 600_000, polling: 100 });
      assert.ok(await seen(page, 0.1) > 0.1, "the second scene is blank");
    }
    assert.deepEqual(bad, []);
    await page.close();
  }
} finally {
  await browser.close();
  rmSync(folder, { recursive: true });
}
console.log(JSON.stringify(report, null, 1));

/** Saves what is left without the chairs, and counts its Gaussians. */
async function saved(page, report) {
  await page.evaluate(() => {
    globalThis.savedBlobs = [];
    const made = URL.createObjectURL;
    URL.createObjectURL = (blob) => {
      globalThis.savedBlobs.push(blob);
      return made(blob);
    };
    HTMLAnchorElement.prototype.click = () => undefined;
  });
  await page.click("#invert");
  await settled(page);
  const selected = await page.evaluate(() => globalThis.scenesplat.selected().reduce((sum, s) => sum + s, 0));
  report.saved = {};
  for (const format of ["ply", "spz"]) {
    await page.evaluate((format) => [...document.querySelectorAll("button")].find((b) => b.textContent === `Save .${format}`).dispatchEvent(new MouseEvent("click")), format);
    await page.waitForFunction((n) => globalThis.savedBlobs.length === n, { timeout: 120_000 }, Object.keys(report.saved).length + 1);
    await page.waitForFunction(() => !document.body.classList.contains("working"));
    const { size, head } = await page.evaluate(async () => {
      const blob = globalThis.savedBlobs.at(-1);
      return { size: blob.size, head: await blob.slice(0, 3000).text() };
    });
    report.saved[format] = size;
    if (format === "ply") assert.match(head, new RegExp(`element vertex ${selected}\n`));
  }
}
