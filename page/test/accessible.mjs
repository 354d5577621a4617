// Who uses pages without a mouse or without eyes: axe-core on what is seen at first and after use, wide and narrow.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { open, ready, settled } from "./browser.mjs";

const AXE = readFileSync(new URL("../node_modules/axe-core/axe.min.js", import.meta.url), "utf8");

/** What axe-core finds: [impact, rule, first element]. */
async function findings(page) {
  await page.evaluate(AXE);
  const violations = await page.evaluate(async () => (await globalThis.axe.run(document, { resultTypes: ["violations"] })).violations);
  return violations.map((v) => [v.impact, v.id, v.nodes[0].html.slice(0, 120)]);
}

/** Fails if axe-core finds anything. */
export async function none(page, what) {
  assert.deepEqual(await findings(page), [], what);
}

export async function accessible(browser, url) {
  const sizes = [{ width: 1440, height: 900 }, { width: 390, height: 844, mobile: true }];
  for (const name of ["room.html", "hostile.html"]) for (const size of sizes) {
    const { page, bad } = await open(browser, url(name), size);
    await ready(page);
    await settled(page);
    const what = `${name}, ${size.width} pixels`;
    await none(page, what);
    await page.evaluate(() => {
      globalThis.scenesplat.ask("chair");
      document.getElementById("help").open = true;
    });
    const { x, y, width, height } = await (await page.$("#canvas")).boundingBox();
    await page.mouse.click(x + width / 2, y + height / 2);
    assert.equal(await page.$eval("#card", (e) => e.hidden), false, what);
    await none(page, `${what}, with a selection`);
    if (name === "room.html") {
      // That axe-core works on a page whose policy forbids scripts.
      await page.$eval("#query", (e) => ["aria-label", "title", "placeholder"].forEach((a) => e.removeAttribute(a)));
      assert.deepEqual((await findings(page)).map(([impact, id]) => [impact, id]), [["critical", "label"]]);
    }
    assert.deepEqual(bad, []);
    await page.close();
  }
  for (const name of ["pareto.html", "curves.html"]) for (const scheme of ["light", "dark"]) {
    const { page, bad } = await open(browser, url(name), { width: 1180, height: 1000, scheme });
    await none(page, `${name}, ${scheme}`);
    assert.deepEqual(bad, []);
    await page.close();
  }
}
