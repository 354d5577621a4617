// The example of the npm package in a browser: node test/three.mjs FOLDER SCENE PICTURE. FOLDER has the package and three in its
// node_modules.
import assert from "node:assert/strict";
import { createReadStream, existsSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join, normalize, resolve } from "node:path";
import { chromium, launch } from "./browser.mjs";

const [folder, scene, picture] = process.argv.slice(2).map((path) => resolve(path));
const executable = chromium();
if (executable === null) {
  console.error("*** NOT RUN: no chromium; install it, or name it in CHROMIUM ***");
  process.exit(3);
}
const types = { ".html": "text/html", ".js": "text/javascript", ".wasm": "application/wasm" };
const server = createServer((request, response) => {
  const path = join(folder, normalize(new URL(request.url, "http://localhost").pathname));
  if (!existsSync(path) || !statSync(path).isFile()) {
    response.writeHead(404).end();
    return;
  }
  response.writeHead(200, { "content-type": types[extname(path)] ?? "application/octet-stream" });
  createReadStream(path).pipe(response);
}).listen(0, "127.0.0.1");
await new Promise((done) => server.once("listening", done));
const browser = await launch(executable);
try {
  const page = await browser.newPage();
  await page.setViewport({ width: 1000, height: 700 });
  const bad = [];
  page.on("pageerror", (error) => bad.push(String(error)));
  page.on("console", (message) => message.type() === "error" && !/favicon/.test(message.location().url ?? "") && bad.push(message.text()));
  await page.goto(`http://127.0.0.1:${server.address().port}/node_modules/scenesplat/examples/three.html`);
  const input = await page.$("#file");
  await input.uploadFile(scene);
  await page.waitForFunction(() => /Gaussians, \d+ classes/.test(document.getElementById("text").textContent), { timeout: 300_000 });
  await new Promise((done) => setTimeout(done, 3000));
  await page.screenshot({ path: picture });
  console.log(await page.$eval("#text", (e) => e.textContent));
  assert.deepEqual(bad, []);
} finally {
  await browser.close();
  server.close();
}
