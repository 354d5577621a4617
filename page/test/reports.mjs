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
    const shown = () => page.$$eval(".panels section", (all) => all.filter((s) => !s.hidden).length);
    // The loss and the first evaluation are large; then a term with a name that would be markup.
    assert.equal(await shown(), 3);
    const names = await page.$$eval(".panels h2", (all) => all.map((h) => h.textContent));
    assert.deepEqual(names.slice(0, 2), ["train/loss", "unseen/mIoU"]);
    assert.match(names[2], /^train\/<img src=x/);
    const wide = await page.$$eval(".panels section", (all) => all.map((s) => s.getBoundingClientRect().width));
    assert.ok(wide[0] > 1.3 * wide[2] && Math.abs(wide[0] - wide[1]) < 1, wide.join());
    assert.match(await page.$eval("#large section", (e) => e.textContent), /of 4\u2009000 values are drawn/);
    // Noisy ones say which line is which.
    const keys = await page.$$eval(".panels section .legend", (all) => all.map((e) => !e.hidden && e.textContent));
    assert.deepEqual(keys.map((k) => k !== false), [true, false, true]);
    assert.match(keys[0], /mean around each value.*single values/);
    // What never changes is in a table.
    const rest = await page.$$eval("#rest tr", (all) => all.map((r) => [...r.children].map((c) => c.textContent)));
    assert.deepEqual(rest.slice(1), [["train/lr_factor", "constant", "1", ""], ["unseen/oracle/mIoU", "oracle", "0.99", ""]]);
    // Neighboring ticks have different texts, though the curve hardly rises.
    const ticks = await page.$$eval("#large section:last-child .tick", (all) => all.map((t) => [t.getAttribute("text-anchor"), t.textContent]));
    for (const anchor of ["middle", "end"]) {
      const texts = ticks.filter(([a]) => a === anchor).map(([, t]) => t);
      assert.ok(texts.length >= 3 && texts.every((t, i) => t !== texts[i + 1]), texts.join(" "));
    }
    // What is below the pointer is said in every panel.
    const at = await page.$eval("#large svg", (e) => {
      const box = e.getBoundingClientRect();
      return [box.x + box.width * 0.55, box.y + box.height / 2];
    });
    await page.mouse.move(...at);
    const said = await page.$$eval(".panels section p", (all) => all.map((p) => p.textContent));
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
