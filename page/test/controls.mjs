// What people meet first: colors, labels of controls, the search text, near walls, pictures, warnings, phones.
import assert from "node:assert/strict";
import { open, pixels, ready, settled } from "./browser.mjs";

/** Controls without a name: text that is seen, or a label for those who do not see and a title for those who do. */
const unnamed = () => [...document.querySelectorAll("button, input, select, textarea, summary")].filter((e) => {
  const worded = (text) => /\p{L}/u.test(text ?? "");
  const seen = e.tagName === "INPUT" ? [...e.labels ?? []].some((l) => worded(l.innerText)) : worded(e.textContent);
  return !seen && !(worded(e.getAttribute("aria-label")) && worded(e.title));
}).map((e) => e.outerHTML.slice(0, 120));

/** How far the text of the empty field is from its right edge, pixels. */
const room = () => {
  const input = document.getElementById("query"), style = getComputedStyle(input);
  const context = document.createElement("canvas").getContext("2d");
  context.font = `${style.fontStyle} ${style.fontWeight} ${style.fontSize} ${style.fontFamily}`;
  // Browsers draw an arrow for suggestions into the field.
  const arrow = 28;
  return input.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight) - arrow
    - context.measureText(input.placeholder).width;
};

const rect = (page, selector) => page.$eval(selector, (e) => {
  const { top, bottom, left, right, width, height } = e.getBoundingClientRect();
  return { top, bottom, left, right, width, height };
});

/** What is not cut away of the kinds of Gaussians: [shown, all]. */
const shown = (page, names) => page.evaluate((names) => {
  const { data, drawn } = globalThis.scenesplat, alpha = drawn();
  const of = names.map((name) => data.about.classes.findIndex((c) => c.name === name) + 1);
  const counts = [0, 0];
  data.label.forEach((label, i) => {
    if (!of.includes(label) || data.color[4 * i + 3] < 12) return;
    counts[1]++;
    if (alpha[4 * i + 3] > 0) counts[0]++;
  });
  return counts;
}, names);

export async function controls(browser, url, shot) {
  await first(browser, url, shot);
  await edits(browser, url, shot);
  await phone(browser, url, shot);
}

async function first(browser, url, shot) {
  const { page, bad } = await open(browser, url("room.html"), { width: 1440, height: 900 });
  await ready(page);
  await settled(page);
  await shot(page, "first");
  assert.equal(await page.$eval('#modes [aria-pressed="true"]', (b) => b.dataset.mode), "colors");
  const own = await page.evaluate(() => {
    const { data, drawn } = globalThis.scenesplat, now = drawn();
    return data.color.every((v, i) => i % 4 === 3 || v === now[i]);
  });
  assert.ok(own, "the page opens in other colors than the scene's own");
  assert.deepEqual(await page.evaluate(unnamed), []);
  const sizes = await page.$$eval("#classes li:not(.none)", (rows) => rows.map((r) => [
    r.querySelector(".name").textContent, Number(r.querySelector(".count").textContent.replace(/\D/g, ""))]));
  const building = sizes.map(([name]) => ["wall", "floor", "ceiling"].includes(name));
  assert.ok(building.indexOf(true) > 3 && building.slice(building.indexOf(true)).every((is) => is), sizes.join(" "));
  for (const part of [sizes.filter((_, i) => !building[i]), sizes.filter((_, i) => building[i])]) {
    part.forEach(([, count], i) => assert.ok(i === 0 || count <= part[i - 1][1], sizes.join(" ")));
  }
  await walls(page, shot);
  await picture(page);
  for (const width of [320, 360, 390, 430, 600, 700, 701, 768, 1024, 1440]) {
    await page.setViewport({ width, height: 800 });
    const left = await page.evaluate(room);
    assert.ok(left >= 0, `${width} pixels: the text of the search field is cut by ${-left}`);
  }
  assert.deepEqual(bad, []);
  await page.close();
}

/** A selection grows, shrinks and comes back; two clicks tell how far apart things are. */
async function edits(browser, url, shot) {
  const { page, bad } = await open(browser, url("room.html"));
  await ready(page);
  await settled(page);
  const count = () => page.evaluate(() => globalThis.scenesplat.selected()?.reduce((sum, s) => sum + s, 0) ?? null);
  const undo = () => page.$eval("#undo", (b) => b.disabled);
  assert.deepEqual([await count(), await undo()], [null, true]);
  await page.type("#query", "chair");
  await page.keyboard.press("Enter");
  const floor = () => page.evaluate(() => {
    const { data, selected } = globalThis.scenesplat, floor = data.about.classes.findIndex((c) => c.name === "floor") + 1;
    return selected().reduce((sum, s, i) => sum + (data.label[i] === floor ? s : 0), 0);
  });
  const chairs = await count(), ground = await floor();
  await page.click("#grow");
  const more = await count();
  assert.ok(await floor() > ground, "the floor under the chairs is not taken in");
  await page.focus("#canvas");
  await page.keyboard.press("G");
  const again = await count();
  assert.ok(chairs > 0 && more > chairs && again < more, `${chairs} grow to ${more} and shrink to ${again}`);
  // Floor that is hidden is not taken in.
  const taken = await floor();
  await page.$$eval("#classes li", (rows) => rows.find((r) => r.querySelector(".name").textContent === "floor").querySelector("input").click());
  await page.keyboard.press("g");
  assert.equal(await floor(), taken);
  // Back, a change at a time, by each of the ways; the class is shown again.
  await page.keyboard.press("u");
  assert.equal(await count(), again);
  await page.click("#undo");
  assert.equal(await page.$$eval("#classes input", (all) => all.every((box) => box.checked)), true);
  await page.focus("#canvas");
  await page.keyboard.down("Control");
  await page.keyboard.press("z");
  await page.keyboard.up("Control");
  assert.equal(await count(), more);
  await page.keyboard.press("u");
  assert.equal(await count(), chairs);
  // Another question, and what was typed for the first.
  await page.click("#query", { clickCount: 3 });
  await page.keyboard.type("table");
  await page.keyboard.press("Enter");
  await page.keyboard.press("Escape");
  assert.equal(await count(), null);
  await page.keyboard.press("u");
  assert.deepEqual([await page.$eval("#query", (e) => e.value), (await count()) > 0], ["table", true]);
  await page.keyboard.press("u");
  assert.deepEqual([await page.$eval("#query", (e) => e.value), await count()], ["chair", chairs]);
  await page.keyboard.press("u");
  assert.deepEqual([await count(), await undo()], [null, true]);
  // The distance is that of the places the card names; it is drawn, and goes with Esc.
  const { x, y, width, height } = await (await page.$("#canvas")).boundingBox();
  const card = async (dx, dy) => {
    await page.mouse.click(x + dx * width, y + dy * height);
    return page.$$eval("#facts > *", (all) => Object.fromEntries(all.filter((e) => e.tagName === "DT").map((e) => [e.textContent, e.nextSibling.textContent])));
  };
  const one = await card(0.35, 0.5);
  assert.ok(one.place !== undefined && one["from before"] === undefined, JSON.stringify(one));
  const two = await card(0.65, 0.6);
  const [p, q] = [one, two].map((c) => c.place.match(/-?[\d.]+/g).map(Number));
  const apart = Math.hypot(...p.map((v, a) => v - q[a]));
  assert.ok(apart > 0.3 && Math.abs(apart - parseFloat(two["from before"])) < 0.003, JSON.stringify([one, two]));
  const drawn = (is) => page.waitForFunction((is) => {
    const canvas = document.getElementById("canvas"), copy = new OffscreenCanvas(canvas.width, canvas.height), context = copy.getContext("2d");
    context.drawImage(canvas, 0, 0);
    const { data } = context.getImageData(0, 0, copy.width, copy.height);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) count += Math.abs(data[i] - 90) + Math.abs(data[i + 1] - 162) + Math.abs(data[i + 2] - 242) < 12 ? 1 : 0;
    return is ? count > 50 : count === 0;
  }, { timeout: 20_000, polling: 200 }, is);
  await drawn(true);
  await shot(page, "distance");
  await page.keyboard.press("Escape");
  await drawn(false);
  assert.equal((await card(0.5, 0.5))["from before"], undefined);
  assert.deepEqual(bad, []);
  await page.close();
}

/** Near walls and the ceiling are not drawn from outside; they are from inside, and where they are asked for. */
async function walls(page, shot) {
  const [some, all] = await shown(page, ["wall", "ceiling"]);
  assert.ok(some > 0.2 * all && some < 0.75 * all, `${some} of ${all} of walls and ceiling are drawn at first`);
  const kept = await shown(page, ["floor", "desk", "chair"]);
  assert.equal(kept[0], kept[1], "what is no wall is cut away");
  // The floor beside the near walls is seen, which they hid.
  const floors = () => page.evaluate(() => {
    const { data, pick, project } = globalThis.scenesplat, floor = data.about.classes.findIndex((c) => c.name === "floor") + 1;
    const rows = [...data.label.keys()].filter((i) => data.label[i] === floor);
    const picked = rows.filter((_, k) => k % Math.ceil(rows.length / 60) === 0).map((i) => project(i)).filter((at) => at !== null)
      .map(([x, y]) => data.label[pick(x, y)] === floor);
    return picked.filter((is) => is).length / picked.length;
  });
  const open = await floors();
  await page.click("#cut");
  await settled(page);
  await shot(page, "walls");
  const whole = await shown(page, ["wall", "ceiling"]);
  assert.equal(whole[0], whole[1], "walls are cut away that should not be");
  const closed = await floors();
  assert.ok(open > closed + 0.15, `${open} of the floor is seen without near walls, ${closed} with them`);
  await page.waitForFunction(() => /cut=0/.test(location.hash), { timeout: 10_000 });
  await page.click("#cut");
  await page.waitForFunction(() => !/cut=0/.test(location.hash), { timeout: 10_000 });
  assert.deepEqual(await shown(page, ["wall", "ceiling"]), [some, all]);
  // Into the room and out again, as a visitor goes.
  await page.focus("#canvas");
  for (let i = 0; i < 16; i++) await page.keyboard.press("+");
  assert.equal(await becomes(page, all), all, "walls do not come back inside the room");
  await page.keyboard.press("h");
  assert.equal(await becomes(page, some), some, "walls stay when the camera leaves the room");
}

/** So many Gaussians of walls and ceiling are drawn in the end: slow machines take long for a frame. */
async function becomes(page, wanted) {
  for (const until = performance.now() + 20_000; ;) {
    const [now] = await shown(page, ["wall", "ceiling"]);
    if (now === wanted || performance.now() > until) return now;
    await new Promise((done) => setTimeout(done, 100));
  }
}

/** The button and the key save a picture as large as the canvas, with the scene on it. */
async function picture(page) {
  await page.evaluate(() => {
    globalThis.saved = [];
    const made = URL.createObjectURL;
    URL.createObjectURL = (blob) => {
      globalThis.saved.push({ blob });
      return made(blob);
    };
    HTMLAnchorElement.prototype.click = function click() {
      globalThis.saved.at(-1).name = this.download;
    };
  });
  const ways = [() => page.click("#shot"), () => page.keyboard.press("c")];
  for (const [i, way] of ways.entries()) {
    await page.focus("#canvas");
    await way();
    await page.waitForFunction((n) => globalThis.saved.filter((s) => s.name !== undefined).length === n, { timeout: 60_000 }, i + 1);
  }
  const seen = (await pixels(page, [])).drawn;
  const pictures = await page.evaluate(async () => Promise.all(globalThis.saved.map(async ({ blob, name }) => {
    const bitmap = await createImageBitmap(blob), canvas = document.getElementById("canvas");
    const copy = new OffscreenCanvas(bitmap.width, bitmap.height), context = copy.getContext("2d");
    context.drawImage(bitmap, 0, 0);
    const { data } = context.getImageData(0, 0, copy.width, copy.height);
    let drawn = 0;
    for (let k = 0; k < data.length; k += 4) drawn += Math.abs(data[k] - 20) + Math.abs(data[k + 1] - 22) + Math.abs(data[k + 2] - 26) > 24 ? 1 : 0;
    return { name, type: blob.type, same: bitmap.width === canvas.width && bitmap.height === canvas.height, drawn: drawn / (data.length / 4) };
  })));
  assert.equal(pictures.length, 2);
  for (const { drawn, ...rest } of pictures) {
    assert.deepEqual(rest, { name: "room.png", type: "image/png", same: true });
    assert.ok(Math.abs(drawn - seen) < 0.02 && drawn > 0.1, `${drawn} of the picture is drawn, ${seen} of the page`);
  }
}

/** On a phone two thirds of the screen are the scene; what lists hold is reached by scrolling inside a third; warnings stay. */
async function phone(browser, url, shot) {
  for (const name of ["room.html", "hostile.html"]) {
    const { page, bad } = await open(browser, url(name), { width: 390, height: 844, mobile: true });
    await ready(page);
    await settled(page);
    await shot(page, `phone-${name}`);
    assert.ok((await pixels(page, [])).drawn > 0.1, "blank on a phone");
    const [canvas, panel] = [await rect(page, "#canvas"), await rect(page, "#panel")];
    assert.ok(canvas.width === 390 && canvas.top === 0 && canvas.height >= (2 / 3) * 844, JSON.stringify(canvas));
    assert.ok(panel.top >= canvas.bottom - 1 && panel.height <= 844 / 3 && panel.bottom <= 844, JSON.stringify(panel));
    assert.deepEqual(await page.evaluate(unnamed), []);
    const warned = name === "hostile.html";
    const whole = await page.$eval("#rest", (e) => {
      e.scrollTop = e.scrollHeight;
      return { scrolls: e.scrollHeight > e.clientHeight, least: e.clientHeight };
    });
    assert.ok(whole.scrolls && whole.least >= 60, JSON.stringify(whole));
    for (const id of ["#title", "#query", ...(warned ? ["#warnings"] : [])]) {
      const at = await rect(page, id);
      assert.ok(at.height > 10 && at.top >= panel.top && at.bottom <= panel.bottom, `${id} is scrolled away: ${JSON.stringify(at)}`);
    }
    const last = await rect(page, "#help summary");
    assert.ok(last.top >= panel.top && last.bottom <= 844, JSON.stringify(last));
    // A question shows its answer inside the sheet.
    await page.evaluate(() => globalThis.scenesplat.ask("floor"));
    assert.ok((await rect(page, "#panel")).height <= 844 / 3);
    await page.tap("#fold");
    await page.waitForFunction(() => document.body.classList.contains("folded"), { timeout: 20_000 });
    const folded = await rect(page, "#panel");
    assert.ok(folded.height < panel.height && (await rect(page, "#canvas")).height === 844, JSON.stringify(folded));
    assert.equal(await page.$eval("#fold", (b) => `${b.title} ${b.getAttribute("aria-expanded")}`), "Unfold the panel false");
    assert.ok(!warned || (await rect(page, "#warnings")).height > 10);
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth) <= 390);
    assert.deepEqual(bad, []);
    await page.close();
  }
}
