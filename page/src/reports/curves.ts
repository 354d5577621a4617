// The curves of a training run: a panel for each thing that was measured; what stands below the pointer is said in all.

import { byId, dataOf, element, shape, short, thousands } from "../kit/dom";
import { digits } from "../kit/numbers";
import { legend, Plot, rangeOf } from "../kit/plot";

interface Curve {
  name: string;
  /** Step and value. */
  points: [number, number][];
  /** Mean around each of the same points; empty where the curve has few. */
  smooth: [number, number][];
  /** Values that were logged, and how many of them are not finite. */
  logged: number;
  bad: number;
  last: number;
}
interface Data { title: string; curves: Curve[] }

const BOX = { left: 66, right: 510, top: 14, bottom: 250 };
const data = dataOf<Data>("data");

class Panel {
  readonly node: HTMLElement;
  private svg = shape("svg", { viewBox: "0 0 524 282", class: "plot", role: "img" });
  private said = element("p");
  private plot: Plot | null = null;
  private cross = shape("line", { class: "cross" });

  constructor(readonly curve: Curve, private point: (step: number | null) => void) {
    this.svg.setAttribute("aria-label", curve.name.slice(0, 200));
    this.node = element("section", { className: "card" }, [element("h2", { text: short(curve.name, 80), className: "named" }), this.said, this.svg]);
    this.svg.addEventListener("pointermove", (e) => {
      const at = this.svg.getBoundingClientRect();
      const step = this.plot?.valueAt(((e.clientX - at.left) / at.width) * 524) ?? 0;
      this.point(step);
    });
    this.svg.addEventListener("pointerleave", () => this.point(null));
  }

  draw(log: boolean, raw: boolean): void {
    const { points, smooth } = this.curve;
    const own = smooth.length === 0 || raw ? points : smooth;
    const x = rangeOf(points.map((p) => p[0]), false);
    const y = rangeOf(own.map((p) => p[1]), log);
    this.plot = new Plot(this.svg, BOX, { ...x, label: "", text: digits }, { ...y, label: "", text: digits });
    if (smooth.length === 0) this.plot.line(points, "front");
    else {
      if (raw) this.plot.line(points, "raw");
      this.plot.line(smooth, "front");
    }
    if (points.length === 1) this.plot.mark(points[0][0], points[0][1], 4, "front");
    this.plot.add(this.cross);
    this.say(null);
  }

  say(step: number | null): void {
    const { points, smooth, logged, bad, last } = this.curve;
    if (step === null || this.plot === null) {
      this.cross.setAttribute("visibility", "hidden");
      const thinned = logged - bad > points.length ? `; ${thousands(points.length)} of ${thousands(logged - bad)} values are drawn` : "";
      this.said.textContent = `last ${digits(last)}${bad > 0 ? `; ${thousands(bad)} not finite` : ""}${thinned}`;
      return;
    }
    const i = nearest(points, step);
    const x = this.plot.atX(points[i][0]);
    for (const [name, value] of [["x1", x], ["x2", x], ["y1", BOX.top], ["y2", BOX.bottom], ["visibility", "visible"]]) {
      this.cross.setAttribute(name as string, String(value));
    }
    const mean = smooth.length > 0 ? `, mean ${digits(smooth[i][1])}` : "";
    this.said.textContent = `step ${thousands(points[i][0])}: ${digits(points[i][1])}${mean}`;
  }
}

/** The place of the point whose step is nearest; points rise. */
function nearest(points: [number, number][], step: number): number {
  let low = 0, high = points.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (points[middle][0] < step) low = middle;
    else high = middle;
  }
  return Math.abs(points[high][0] - step) < Math.abs(points[low][0] - step) ? high : low;
}

byId("title").textContent = short(data.title, 200);
const most = Math.max(...data.curves.map((c) => c.points[c.points.length - 1][0]));
byId("about").textContent = `${data.curves.length} curves over ${thousands(most)} steps`;
byId("legend").append(legend([{ name: "mean around each value", color: "smooth" }, { name: "single values", color: "raw" }]));
const panels = data.curves.map((curve) => new Panel(curve, (step) => panels.forEach((p) => !p.node.hidden && p.say(step))));
byId("panels").append(...panels.map((p) => p.node));

function show(): void {
  const part = byId<HTMLInputElement>("filter").value.trim().toLowerCase();
  const log = byId<HTMLInputElement>("log").checked, raw = byId<HTMLInputElement>("raw").checked;
  for (const panel of panels) {
    panel.node.hidden = !panel.curve.name.toLowerCase().includes(part);
    if (!panel.node.hidden) panel.draw(log, raw);
  }
  byId("none").hidden = panels.some((p) => !p.node.hidden);
}
for (const id of ["filter", "log", "raw"]) byId(id).addEventListener("input", show);
show();
