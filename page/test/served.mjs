// `view --serve`: chunks and progress, nothing but its own address, other sites get nothing, Ctrl-C ends it.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { readdirSync } from "node:fs";
import { createServer } from "node:http";
import { open, ready, settled } from "./browser.mjs";

/** Starts the program; gives its address, what it says, and a promise of its end. */
async function start(program, folder) {
  const scene = readdirSync(folder).find((name) => name.endsWith("attacked=1>.ply"));
  const words = ["view", `${folder}/${scene}`, "--label-names", `${folder}/served-names.json`, "--serve"];
  const child = spawn(program, words, { stdio: ["ignore", "pipe", "pipe"] });
  let said = "";
  child.stderr.on("data", (text) => (said += text));
  const ended = new Promise((resolve) => child.on("exit", (code) => resolve(code)));
  const url = await new Promise((resolve, reject) => {
    let text = "";
    const late = setTimeout(() => reject(new Error(`no address: ${text} ${said}`)), 120_000);
    child.stdout.on("data", (part) => {
      text += part;
      const found = /open (http:\/\/127\.0\.0\.1:\d+\/[0-9a-f]{32}\/) in a browser/.exec(text);
      if (found) {
        clearTimeout(late);
        resolve(found[1]);
      }
    });
    void ended.then((code) => reject(new Error(`ended with ${code}: ${text} ${said}`)));
  });
  return { child, url, ended, said: () => said };
}

export async function served(launched, program, folder, shot) {
  const { child, url, ended, said } = await start(program, folder);
  const { port } = new URL(url);
  // A site whose name was made to point at this machine.
  const browser = await launched([`--host-resolver-rules=MAP attacker.example 127.0.0.1`]);
  const other = createServer((_, answer) => answer.end("<!doctype html><title>another site</title>"));
  await new Promise((resolve) => other.listen(0, "127.0.0.1", resolve));
  try {
    const { page, bad } = await open(browser, url, { served: true });
    const chunks = [];
    page.on("request", (r) => chunks.push(r.url()));
    await ready(page);
    await settled(page);
    assert.equal(await page.evaluate(() => globalThis.attacked), undefined);
    assert.match(await page.$eval("#title", (e) => e.textContent), /"><img src=x/);
    assert.equal(await page.$eval("#arrived", (e) => e.value), 1);
    assert.equal(await page.$$eval("#panel img, #panel script", (all) => all.length), 0);
    await page.type("#query", "floor");
    await page.keyboard.press("Enter");
    assert.match(await page.$eval("#summary", (e) => e.textContent), /“floor”: [\d\u2009]+ Gaussians, 1 object/);
    await shot(page, "served");

    // From another site: by fetch, as a script, as a picture, in a frame. None of them gets anything.
    const site = await browser.newPage();
    await site.goto(`http://127.0.0.1:${other.address().port}/`);
    const got = await site.evaluate(async (target) => {
      const tried = async (work) => work().then(() => "got it", () => "nothing");
      const element = (tag, attribute) => new Promise((resolve, reject) => {
        const e = document.createElement(tag);
        e.addEventListener("load", resolve);
        e.addEventListener("error", reject);
        e[attribute] = target;
        document.body.append(e);
      });
      return [
        await tried(() => fetch(target).then((r) => r.text())),
        await tried(() => fetch(`${target}chunk/position/0`, { mode: "no-cors" }).then((r) => r.arrayBuffer()).then((b) => {
          if (b.byteLength === 0) throw new Error("empty");
        })),
        await tried(() => element("script", "src")),
        await tried(() => element("img", "src")),
      ];
    }, url);
    assert.deepEqual(got, ["nothing", "nothing", "nothing", "nothing"]);
    await site.setContent(`<iframe src="${url}"></iframe>`);
    await new Promise((resolve) => setTimeout(resolve, 300));
    const framed = site.frames().filter((f) => f !== site.mainFrame());
    const texts = await Promise.all(framed.map((f) => f.evaluate(() => document.title).catch(() => "")));
    assert.ok(texts.every((t) => !t.includes("scenesplat") && !t.includes("img")), texts.join());
    const rebound = await site.goto(`${url.replace("127.0.0.1", "attacker.example")}`);
    assert.equal(rebound.status(), 403);
    for (const path of ["../", "../../etc/passwd", "chunk/../../../etc/passwd", "chunk/position/99"]) {
      const answer = await fetch(url + path);
      assert.equal(answer.status, 404, path);
    }
    await site.close();

    // Ctrl-C: a clean end; the page has all it needs.
    child.kill("SIGINT");
    assert.equal(await ended, 0, said());
    await assert.rejects(fetch(`http://127.0.0.1:${port}/`));
    for (const line of ["a browser opened the page", "the page needs this program no longer", "a request got nothing (403)"]) {
      assert.ok(said().includes(line), `${line}: ${said()}`);
    }
    await page.evaluate(() => globalThis.scenesplat.ask("wall"));
    assert.match(await page.$eval("#summary", (e) => e.textContent), /Gaussians|nothing found/);
    assert.deepEqual(bad, []);
    await page.close();
  } finally {
    child.kill("SIGKILL");
    other.close();
    await browser.close();
  }
}
