// The reports of `pareto` and of training, which share the kit of the page.
import assert from "node:assert/strict";
import { open } from "./browser.mjs";

const quiet = async (page, bad) => {
  assert.equal(await page.evaluate(() => globalThis.attacked), undefined);
  assert.equal(await page.$$eval("img", (all) => all.length), 0);
  assert.deepEqual(bad, []);
};

export async function reports(browser, url, shot) {
  {
    const { page, bad } = await open(browser, url("pareto.html"), { width: 1180, height: 1000 });
    const text = (id) => page.$eval(`#${id}`, (e) => e.textContent);
    assert.match(await text("about"), /<\/script><script>/);
    assert.equal(await page.$$eval("#plot circle.front, #plot circle.knee", (all) => all.length), 3);
    assert.equal(await page.$$eval("#plot circle.beaten", (all) => all.length), 1);
    assert.equal(await page.$$eval("#points tr.picked", (all) => all.length), 1);
    assert.match(await text("setting"), /^k=25$/);
    // Half of the budget.
    await page.$eval("#slider", (e) => { e.value = "500"; e.dispatchEvent(new Event("input")); });
    assert.match(await text("setting"), /^k=8,net=/);
    assert.match(await text("why"), /the best of 2 that fit/);
    const at = await page.$eval("#plot circle.knee", (e) => {
      const box = e.getBoundingClientRect();
      return [box.x + box.width / 2, box.y + box.height / 2];
    });
    await page.mouse.move(...at);
    assert.match(await page.$eval(".tip", (e) => (e.hidden ? "" : e.textContent)), /<img src=x.*62\.00 %/);
    await shot(page, "pareto");
    for (const [id, value] of [["cost", "peak_bytes"], ["worth", "ece"]]) {
      await page.select(`#${id}`, value);
      assert.ok((await page.$$eval("#plot circle.mark, #plot circle", (all) => all.length)) >= 4, id);
    }
    // Training curves of the same kit.
    assert.equal(await page.$$eval("#curves circle", (all) => all.length), 3);
    assert.match(await text("runs"), /best 55\.00 %, 99 % of it after 3\.33 min/);
    await quiet(page, bad);
    await page.close();
  }
  {
    const { page, bad } = await open(browser, url("curves.html"), { width: 1180, height: 800 });
    const shown = () => page.$$eval("#panels section", (all) => all.filter((s) => !s.hidden).length);
    assert.equal(await shown(), 2);
    assert.match(await page.$eval("#panels section", (e) => e.textContent), /4\u2009000 values are drawn|of 4\u2009000 values/);
    // What is below the pointer is said in every panel.
    const at = await page.$eval("#panels svg", (e) => {
      const box = e.getBoundingClientRect();
      return [box.x + box.width * 0.55, box.y + box.height / 2];
    });
    await page.mouse.move(...at);
    const said = await page.$$eval("#panels section p", (all) => all.map((p) => p.textContent));
    assert.ok(said.every((s) => /^step [\d\u2009]+: /.test(s)), said.join(" | "));
    await shot(page, "curves");
    await page.type("#filter", "miou");
    assert.equal(await shown(), 1);
    await page.type("#filter", "xyz");
    assert.equal(await page.$eval("#none", (e) => e.hidden), false);
    await quiet(page, bad);
    await page.close();
  }
}
