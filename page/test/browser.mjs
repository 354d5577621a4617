// A browser that notes every request, message and error of a page.
import puppeteer from "puppeteer-core";
import { existsSync } from "node:fs";

const PLACES = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];

export function chromium() {
  return PLACES.find((path) => path && existsSync(path)) ?? null;
}

export async function launch(executablePath, webgl = true, more = []) {
  const graphics = webgl
    ? ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    : ["--disable-gpu", "--disable-3d-apis"];
  return puppeteer.launch({
    executablePath,
    headless: true,
    protocolTimeout: 300_000,
    args: ["--no-sandbox", "--disable-dev-shm-usage", ...graphics, ...more],
  });
}

/** Opens a page; everything it does that it must not is in `bad`. `served`: its chunks may be asked for. */
export async function open(browser, url, { width = 960, height = 640, mobile = false, served = false, scheme = "light" } = {}) {
  const page = await browser.newPage();
  await page.setViewport({ width, height, isMobile: mobile, hasTouch: mobile });
  await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
  const bad = [];
  page.on("request", (request) => {
    const to = request.url();
    const own = to.split("#")[0] === url.split("#")[0] || /^(blob|data):/.test(to)
      || (served && to.startsWith(`${url.split("#")[0]}chunk/`));
    if (!own) bad.push(`request: ${to.slice(0, 200)}`);
  });
  page.on("console", (message) => {
    const text = message.text();
    // What the software renderer says of itself when pixels are read.
    if (message.type() === "error" || (message.type() === "warn" && !/GPU stall|swiftshader|WebGL/i.test(text))) {
      bad.push(`${message.type()}: ${text.slice(0, 300)}`);
    }
  });
  // With what was thrown even where that is no error, and where.
  const session = await page.createCDPSession();
  await session.send("Runtime.enable");
  session.on("Runtime.exceptionThrown", ({ exceptionDetails: { text, exception, stackTrace } }) => {
    const what = exception?.description ?? exception?.value ?? "";
    const where = stackTrace?.callFrames.map((f) => `${f.functionName}:${f.lineNumber}:${f.columnNumber}`).join(" ");
    bad.push(`error: ${text} ${what} ${where ?? ""}`.slice(0, 600));
  });
  page.on("dialog", (dialog) => {
    bad.push(`dialog: ${dialog.message()}`);
    void dialog.dismiss();
  });
  const began = performance.now();
  await page.goto(url, { waitUntil: "domcontentloaded" });
  return { page, bad, began };
}

export async function ready(page, timeout = 120_000) {
  await page.waitForFunction(() => globalThis.scenesplat?.ready === true, { timeout, polling: 50 });
}

/** Sorted values' 50th and 95th percentile. */
export function percentiles(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const at = (q) => Math.round(10 * sorted[Math.min(sorted.length - 1, Math.ceil(q * sorted.length) - 1)]) / 10;
  return { p50: at(0.5), p95: at(0.95) };
}

/** Waits until nothing new was drawn for a while. */
export async function settled(page) {
  await page.evaluate(async () => {
    let last = -1;
    for (let quiet = 0; quiet < 3;) {
      const now = globalThis.scenesplat.frames();
      quiet = now === last ? quiet + 1 : 0;
      last = now;
      await new Promise((resolve) => setTimeout(resolve, 120));
    }
  });
}

/** Red, green, blue of the canvas at some places of the window, and how many of all pixels differ from the ground. */
export async function pixels(page, places) {
  return page.evaluate((places) => {
    const canvas = document.getElementById("canvas");
    const copy = document.createElement("canvas");
    copy.width = canvas.width;
    copy.height = canvas.height;
    const context = copy.getContext("2d", { willReadFrequently: true });
    context.drawImage(canvas, 0, 0);
    const { data } = context.getImageData(0, 0, copy.width, copy.height);
    let drawn = 0;
    for (let i = 0; i < data.length; i += 4) {
      drawn += Math.abs(data[i] - 20) + Math.abs(data[i + 1] - 22) + Math.abs(data[i + 2] - 26) > 24 ? 1 : 0;
    }
    const rect = canvas.getBoundingClientRect();
    const at = places.map(([x, y]) => {
      const column = Math.round(((x - rect.left) / rect.width) * copy.width);
      const row = Math.round(((y - rect.top) / rect.height) * copy.height);
      const i = 4 * (row * copy.width + column);
      return [data[i], data[i + 1], data[i + 2]];
    });
    return { drawn: drawn / (data.length / 4), at };
  }, places);
}

/** Waits until so much of the canvas is drawn; gives how much is. */
export async function seen(page, share, timeout = 240_000) {
  const until = performance.now() + timeout;
  for (;;) {
    const { drawn } = await pixels(page, []);
    if (drawn > share || performance.now() > until) return drawn;
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
}
