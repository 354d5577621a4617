// The curves of a training run: a panel for each thing that changes, the two that matter most large, and a table of the
// rest; what stands below the pointer is said in all panels.

import { byId, dataOf, element, rows, shape, short, thousands } from "../kit/dom";
import { digits } from "../kit/numbers";
import { legend, Plot, rangeOf, type Box } from "../kit/plot";

interface Curve {
  name: string;
  /** Step and value. */
  points: [number, number][];
  /** Mean around each of the same points; empty where the curve has few. */
  smooth: [number, number][];
  /** Values that were logged, and how many of them are not finite. */
  logged: number;
  bad: number;
  last: number | null;
}
interface LeftOut { name: string; reason: string; last: number | null; bad: number }
/** The first `large` curves are large. */
interface Data { title: string; curves: Curve[]; large: number; left_out: LeftOut[] }

const BOX = { left: 84, right: 510, top: 14, bottom: 250 };
const LARGE = { ...BOX, right: 760, bottom: 420 };
const data = dataOf<Data>("data");

/** A count as it is, other numbers in so many digits. */
function figure(v: number | null, most = 5): string {
  return v === null ? "–" : Number.isInteger(v) && Math.abs(v) < 1e15 ? thousands(v) : digits(v, most);
}

/** Five digits, or as many as tell a thousandth of the range. */
function digitsOf(points: [number, number][]): number {
  const { low, high } = rangeOf(points.map((p) => p[1]), false);
  const parts = Math.max(Math.abs(low), Math.abs(high)) / (high - low);
  return Math.max(5, Math.min(15, Math.ceil(Math.log10(parts)) + 3));
}

class Panel {
  readonly node: HTMLElement;
  private svg = shape("svg", { class: "plot", role: "img" });
  private said = element("p");
  private key = legend([{ name: "mean around each value", color: "smooth" }, { name: "single values", color: "raw" }]);
  private plot: Plot | null = null;
  private digits: number;
  private cross = shape("line", { class: "cross" });

  constructor(readonly curve: Curve, private box: Box, private point: (step: number | null) => void) {
    this.digits = digitsOf(curve.points);
    const width = box.right + 14;
    this.svg.setAttribute("viewBox", `0 0 ${width} ${box.bottom + 32}`);
    this.svg.setAttribute("aria-label", curve.name.slice(0, 200));
    this.key.hidden = curve.smooth.length === 0;
    this.node = element("section", { className: "card" }, [element("h2", { text: short(curve.name, 80), className: "named" }), this.said, this.key, this.svg]);
    this.svg.addEventListener("pointermove", (e) => {
      const at = this.svg.getBoundingClientRect();
      const step = this.plot?.valueAt(((e.clientX - at.left) / at.width) * width) ?? 0;
      this.point(step);
    });
    this.svg.addEventListener("pointerleave", () => this.point(null));
  }

  draw(log: boolean, raw: boolean): void {
    const { points, smooth } = this.curve;
    const own = smooth.length === 0 || raw ? points : smooth;
    const x = rangeOf(points.map((p) => p[0]), false);
    const y = rangeOf(own.map((p) => p[1]), log);
    (this.key.lastElementChild as HTMLElement).hidden = !raw;
    this.plot = new Plot(this.svg, this.box, { ...x, label: "", text: digits }, { ...y, label: "", text: digits });
    if (smooth.length === 0) this.plot.line(points, "front");
    else {
      if (raw) this.plot.line(points, "raw");
      this.plot.line(smooth, "front");
    }
    this.plot.add(this.cross);
    this.say(null);
  }

  say(step: number | null): void {
    const { points, smooth, logged, bad, last } = this.curve;
    if (step === null || this.plot === null) {
      this.cross.setAttribute("visibility", "hidden");
      const thinned = logged - bad > points.length ? `; ${thousands(points.length)} of ${thousands(logged - bad)} values are drawn` : "";
      this.said.textContent = `last ${figure(last, this.digits)}${bad > 0 ? `; ${thousands(bad)} not finite` : ""}${thinned}`;
      return;
    }
    const i = nearest(points, step);
    const x = this.plot.atX(points[i][0]);
    for (const [name, value] of [["x1", x], ["x2", x], ["y1", this.box.top], ["y2", this.box.bottom], ["visibility", "visible"]]) {
      this.cross.setAttribute(name as string, String(value));
    }
    const mean = smooth.length > 0 ? `, mean ${figure(smooth[i][1], this.digits)}` : "";
    this.said.textContent = `step ${thousands(points[i][0])}: ${figure(points[i][1], this.digits)}${mean}`;
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
const most = Math.max(0, ...data.curves.map((c) => c.points[c.points.length - 1][0]));
byId("about").textContent = data.curves.length === 0 ? "Nothing changes from step to step; the last values:"
  : `${data.curves.length} curves over ${thousands(most)} steps`;
byId("left-out").hidden = data.left_out.length === 0;
byId("rest").replaceChildren(...rows(["name", "why", "last value", "not finite"],
  data.left_out.map((c) => ({ cells: [short(c.name, 80), c.reason, figure(c.last), c.bad > 0 ? thousands(c.bad) : ""] }))));
const panels = data.curves.map((curve, i) =>
  new Panel(curve, i < data.large ? LARGE : BOX, (step) => panels.forEach((p) => !p.node.hidden && p.say(step))));
byId("large").append(...panels.slice(0, data.large).map((p) => p.node));
byId("panels").append(...panels.slice(data.large).map((p) => p.node));

function show(): void {
  const part = byId<HTMLInputElement>("filter").value.trim().toLowerCase();
  const log = byId<HTMLInputElement>("log").checked, raw = byId<HTMLInputElement>("raw").checked;
  for (const panel of panels) {
    panel.node.hidden = !panel.curve.name.toLowerCase().includes(part);
    if (!panel.node.hidden) panel.draw(log, raw);
  }
  byId("none").hidden = panels.length === 0 || panels.some((p) => !p.node.hidden);
}
for (const id of ["filter", "log", "raw"]) byId(id).addEventListener("input", show);
show();
