// The report of `pareto`: what accuracy costs, what fits a budget, and what training costs.

import { byId, dataOf, element, rows } from "../kit/dom";
import { bytes, digits, percent, seconds } from "../kit/numbers";
import { legend, Plot, rangeOf, Tip, type Axis } from "../kit/plot";

interface Point {
  setting: string;
  seconds_p50: number; seconds_p95: number; seconds_low: number; seconds_high: number;
  peak_bytes: number; bytes_written: number;
  f_miou: number | null; f_miou_low: number | null; f_miou_high: number | null;
  miou: number | null; f_macc: number | null; agreement: number | null; query_hit1: number | null; ece: number | null;
  stages?: { name: string; seconds: number }[];
}
interface View { name: string; points: Point[]; oracle: Point | null; random_labels: Point | null }
interface Curve { name: string; metric: string; points: [number, number][]; best: number; seconds_to_99: number }
interface Data {
  summary: {
    num_scenes: number; scenes: string[]; reference: string; networks: Record<string, string>;
    classes: { share: number; setting: string | null; seconds_p50: number | null; quality: number | null }[];
    neutral: {
      neutral: string; scenes: string; rule: string; holds: boolean; equal: boolean; agreement: number | null;
      seconds_p50: number; peak_bytes: number;
    }[];
    skipped: { setting: string; by: string; no_better_than: string; no_cheaper_than: string }[];
    unmeasured: string[];
    training: Curve[];
  };
  machine: string;
  views: View[];
  findings: string[];
}

type CostKey = "seconds_p50" | "seconds_p95" | "peak_bytes" | "bytes_written";
type WorthKey = "f_miou" | "miou" | "f_macc" | "agreement" | "query_hit1" | "ece";
const COSTS: Record<CostKey, [string, (v: number, most?: number) => string]> = {
  seconds_p50: ["seconds a scene, median", seconds], seconds_p95: ["seconds a scene, 95th percentile", seconds],
  peak_bytes: ["peak memory", bytes], bytes_written: ["bytes written a scene", bytes],
};
/** Names, and whether more is better. */
const WORTHS: Record<WorthKey, [string, boolean]> = {
  f_miou: ["f-mIoU", true], miou: ["mIoU", true], f_macc: ["f-mAcc", true],
  agreement: ["agreement with the reference", true], query_hit1: ["query hit@1", true],
  ece: ["calibration error (lower is better)", false],
};
const HEAD = ["setting", "p50", "p95", "peak", "written", "f-mIoU", "95 % over scenes", "mIoU", "f-mAcc", "agreement", "hit@1", "ECE"];
const BOX = { left: 76, right: 1080, top: 18, bottom: 496 };
const SERIES = 6;

const data = dataOf<Data>("data");
const { summary } = data;
const tip = new Tip();
const code = (text: string) => element("code", { text });

function cells(p: Point): string[] {
  const between = p.f_miou_low === null || p.f_miou_high === null ? "–"
    : `${(100 * p.f_miou_low).toFixed(1)} – ${(100 * p.f_miou_high).toFixed(1)}`;
  return [
    p.setting, seconds(p.seconds_p50), seconds(p.seconds_p95), bytes(p.peak_bytes), bytes(p.bytes_written),
    percent(p.f_miou), between, percent(p.miou), percent(p.f_macc), percent(p.agreement), percent(p.query_hit1),
    p.ece === null ? "–" : p.ece.toFixed(4),
  ];
}

class Front {
  private cost: CostKey = "seconds_p50";
  private worth: WorthKey = "f_miou";
  private view = data.views[0];
  private points: Point[] = [];
  private front: Point[] = [];
  private knee: Point | null = null;
  private picked: Point | null = null;
  private asked = 0;

  start(): void {
    for (const [key, [name]] of Object.entries(COSTS)) byId<HTMLSelectElement>("cost").add(new Option(name, key));
    for (const [key, [name]] of Object.entries(WORTHS)) byId<HTMLSelectElement>("worth").add(new Option(name, key));
    data.views.forEach((v, i) => byId<HTMLSelectElement>("view").add(new Option(v.name, String(i))));
    for (const id of ["cost", "worth", "view", "log"]) byId(id).addEventListener("change", () => this.choose());
    byId("slider").addEventListener("input", () => this.budget());
    byId("plot").addEventListener("pointerleave", () => tip.hide());
    byId("copy").addEventListener("click", () => void this.copy());
    this.choose();
  }

  private value(p: Point): number | null {
    const v = p[this.worth];
    return v === null ? null : WORTHS[this.worth][1] ? v : -v;
  }

  private choose(): void {
    this.cost = byId<HTMLSelectElement>("cost").value as CostKey;
    this.worth = byId<HTMLSelectElement>("worth").value as WorthKey;
    this.view = data.views[Number(byId<HTMLSelectElement>("view").value)] ?? data.views[0];
    this.points = this.view.points.filter((p) => this.value(p) !== null && isFinite(p[this.cost]));
    const place = new Map(this.points.map((p, i) => [p, i]));
    const beats = (a: Point, b: Point) => {
      const [x, y] = [this.value(a) ?? 0, this.value(b) ?? 0];
      return a[this.cost] <= b[this.cost] && x >= y
        && (a[this.cost] < b[this.cost] || x > y || (place.get(a) ?? 0) < (place.get(b) ?? 0));
    };
    this.front = this.points.filter((p) => !this.points.some((q) => q !== p && beats(q, p)));
    this.front.sort((a, b) => a[this.cost] - b[this.cost]);
    this.findKnee();
    this.budget();
  }

  /** Where the front is highest over the line between its ends, the cost on a logarithmic scale. */
  private findKnee(): void {
    this.knee = null;
    const first = this.front[0], last = this.front[this.front.length - 1];
    if (this.front.length < 3 || first[this.cost] <= 0) return;
    const span = Math.log(last[this.cost] / first[this.cost]);
    const rise = (this.value(last) ?? 0) - (this.value(first) ?? 0);
    if (!(span > 0 && rise > 0)) return;
    let most = 1e-9;
    for (const p of this.front) {
      const height = ((this.value(p) ?? 0) - (this.value(first) ?? 0)) / rise - Math.log(p[this.cost] / first[this.cost]) / span;
      if (height > most) {
        most = height;
        this.knee = p;
      }
    }
  }

  private budget(): void {
    const all = this.points.map((p) => p[this.cost]).filter((v) => v > 0);
    const low = Math.min(...all) * 0.9, high = Math.max(...all) * 1.02;
    const t = Number(byId<HTMLInputElement>("slider").value) / 1000;
    this.asked = low * (high / low) ** t;
    const fits = this.front.filter((p) => p[this.cost] <= this.asked);
    this.picked = fits[fits.length - 1] ?? null;
    const [, text] = COSTS[this.cost];
    const number = this.points.filter((p) => p[this.cost] <= this.asked).length;
    byId("asked").textContent = all.length > 0 ? text(this.asked) : "–";
    byId("setting").textContent = this.picked === null ? "none fits" : given(this.picked.setting);
    byId<HTMLButtonElement>("copy").disabled = this.picked === null;
    const cheapest = this.front[0];
    byId("why").textContent = this.picked !== null
      ? `${text(this.picked[this.cost])}, ${WORTHS[this.worth][0]} ${percent(this.picked[this.worth])}: the best of ${number} that fit`
      : cheapest === undefined ? "" : `the cheapest, ${cheapest.setting}, takes ${text(cheapest[this.cost])}`;
    this.draw();
    this.table();
  }

  private draw(): void {
    const { cost, worth, points, front, view } = this;
    const spread = cost === "seconds_p50", bars = worth === "f_miou";
    const rims: [Point | null, string, string][] = [[view.oracle, "oracle", "good"], [view.random_labels, "random labels", "bad"]];
    const across = rangeOf(
      points.flatMap((p) => (spread ? [p.seconds_low, p.seconds_high, p[cost]] : [p[cost]])),
      byId<HTMLInputElement>("log").checked,
    );
    const up = rangeOf([
      ...points.flatMap((p) => (bars ? [p.f_miou_low, p.f_miou_high, p[worth]] : [p[worth]])),
      ...rims.map(([p]) => p?.[worth]),
    ], false);
    const x: Axis = { ...across, label: COSTS[cost][0], text: COSTS[cost][1] };
    const y: Axis = {
      ...up, flipped: !WORTHS[worth][1], label: WORTHS[worth][0],
      text: (v, most) => `${digits(100 * v, most)} %`,
    };
    const plot = new Plot(byId<SVGSVGElement>("plot"), BOX, x, y);
    for (const [p, name, color] of rims) {
      const v = p?.[worth];
      if (v === null || v === undefined) continue;
      plot.segment([x.low, v], [x.high, v], `rim ${color}`);
      plot.text(BOX.right - 4, plot.atY(v) - 5, name, color, "end");
    }
    const range = (p: Point, color: string) => {
      const at = p[worth] ?? 0;
      if (spread) plot.segment([p.seconds_low, at], [p.seconds_high, at], color);
      if (bars && p.f_miou_low !== null && p.f_miou_high !== null) {
        plot.segment([p[cost], p.f_miou_low], [p[cost], p.f_miou_high], `${color} range`);
      }
    };
    const mark = (p: Point, radius: number, color: string) => {
      const dot = plot.mark(p[cost], p[worth] ?? 0, radius, color);
      dot.addEventListener("pointermove", (e) => this.tell(e, p));
      dot.addEventListener("pointerleave", () => tip.hide());
    };
    for (const p of points) {
      if (front.includes(p)) continue;
      range(p, "beaten");
      mark(p, 5.5, "beaten");
    }
    front.slice(1).forEach((p, i) => {
      const before = front[i];
      plot.line([[before[cost], before[worth] ?? 0], [p[cost], before[worth] ?? 0], [p[cost], p[worth] ?? 0]], "front");
    });
    for (const p of front) {
      range(p, "front");
      mark(p, p === this.knee ? 9 : 7, p === this.knee ? "knee" : "front");
      if (p === this.knee) plot.text(plot.atX(p[cost]) - 12, plot.atY(p[worth] ?? 0) - 12, "knee", "knee", "end");
    }
    if (points.length === 0) return;
    const at = Math.max(BOX.left, Math.min(BOX.right, plot.atX(this.asked)));
    const asked = plot.valueAt(at);
    plot.segment([asked, y.low], [asked, y.high], "budget");
    plot.text(at + (at > 900 ? -6 : 6), 34, "budget", "front", at > 900 ? "end" : "start");
    if (this.picked !== null) plot.mark(this.picked[cost], this.picked[worth] ?? 0, 14, "ring");
  }

  private tell(event: PointerEvent, p: Point): void {
    const all = cells(p);
    const beaten = this.front.includes(p) ? "" : " (beaten)";
    const table = element("table", {}, rows(HEAD.slice(1, 1), HEAD.slice(1).map((h, i) => ({ cells: [h, all[i + 1]] }))));
    const stages = (p.stages ?? []).map((s) => `${s.name} ${seconds(s.seconds)}`).join(" · ");
    tip.show(event, [element("b", { text: all[0] }), element("span", { text: beaten }), table, element("span", { text: stages })]);
  }

  private table(): void {
    const order = [...this.points].sort((a, b) => a[this.cost] - b[this.cost]);
    const own = order.map((p) => ({
      cells: cells(p), className: `${this.front.includes(p) ? "" : "beaten "}${p === this.picked ? "picked" : ""}`,
    }));
    const rims = [this.view.oracle, this.view.random_labels].filter((p) => p !== null).map((p) => ({ cells: cells(p) }));
    byId("points").replaceChildren(...rows(HEAD, [...own, ...rims]));
  }

  private async copy(): Promise<void> {
    const text = byId("setting").textContent ?? "";
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // Pages from disk may not write there everywhere; then it stands selected, to be copied by hand.
      getSelection()?.selectAllChildren(byId("setting"));
      byId("copy").textContent = "selected";
      return;
    }
    byId("copy").textContent = "copied";
    setTimeout(() => (byId("copy").textContent = "copy"), 1200);
  }
}

/** A name of a network becomes its folder: what is copied is what --setting takes. */
function given(setting: string): string {
  const folder = (part: string) => {
    const name = part.startsWith("net=") ? part.slice(4) : "";
    return Object.hasOwn(summary.networks, name) ? `net=${summary.networks[name]}` : part;
  };
  return setting.split(",").map(folder).join(",");
}

function tables(): void {
  byId("classes").replaceChildren(...rows(["class", "setting", "p50", "f-mIoU"], summary.classes.map((c) => ({
    cells: [`≥ ${digits(100 * c.share)} %`, c.setting === null ? "none" : code(c.setting), seconds(c.seconds_p50), percent(c.quality)],
  }))));
  const verdict = (holds: boolean) => element("span", { text: holds ? "yes" : "NO", className: holds ? "yes" : "no" });
  byId("neutral").replaceChildren(summary.neutral.length === 0 ? "Nothing was tried." : element("table", {},
    rows(["tried", "scenes", "rule", "holds", "same labels", "p50", "peak"], summary.neutral.map((n) => ({
      cells: [
        n.neutral, n.scenes, n.rule, verdict(n.holds), n.equal ? "all" : percent(n.agreement),
        seconds(n.seconds_p50), bytes(n.peak_bytes),
      ],
    })))));
  const items = (id: string, lines: HTMLElement[], none: string) =>
    byId(id).replaceChildren(...(lines.length > 0 ? lines : [element("li", { text: none })]));
  items("findings", data.findings.map((f) => element("li", { text: f })), "Every dearer choice bought something.");
  const skipped = summary.skipped.map((s) => element("li", {}, [
    code(s.setting), element("span", { text: ": " }), code(s.by),
    element("span", { text: " is no dearer and no worse than it can be (worth at most that of " }), code(s.no_better_than),
    element("span", { text: ", cost at least that of " }), code(s.no_cheaper_than), element("span", { text: ")" }),
  ]));
  const late = summary.unmeasured.map((s) => element("li", {}, [code(s), element("span", { text: ": time was over" })]));
  items("skipped", [...skipped, ...late], "All settings were measured.");
}

function training(): void {
  const curves = summary.training;
  byId("training").hidden = curves.length === 0;
  if (curves.length === 0) return;
  const x = rangeOf(curves.flatMap((c) => c.points.map((p) => p[0])), true);
  const y = rangeOf(curves.flatMap((c) => c.points.map((p) => p[1])), false);
  const plot = new Plot(
    byId<SVGSVGElement>("curves"), { left: 76, right: 1080, top: 18, bottom: 450 },
    { ...x, label: "seconds of training", text: seconds },
    { ...y, label: curves[0].metric, text: (v, most) => `${digits(100 * v, most)} %` },
  );
  curves.forEach((curve, i) => {
    const color = `series c${i % SERIES}`;
    plot.line(curve.points, color);
    for (const [s, v] of curve.points) {
      const dot = plot.mark(s, v, 4, color);
      dot.addEventListener("pointermove", (e) => tip.show(e, [
        element("b", { text: curve.name }), element("div", { text: `${curve.metric} ${percent(v)} after ${seconds(s)}` }),
      ]));
      dot.addEventListener("pointerleave", () => tip.hide());
    }
  });
  byId("runs").append(legend(curves.map((c, i) => ({
    name: `${c.name}, ${c.metric}: best ${percent(c.best)}, 99 % of it after ${seconds(c.seconds_to_99)}`, color: `c${i % SERIES}`,
  }))));
}

const scenes = `${summary.num_scenes} ${summary.num_scenes === 1 ? "scene" : "scenes"}`;
const measured = data.views.some((v) => v.points.length > 0);
byId("about").textContent = measured
  ? `${scenes} (${summary.scenes.join(", ")}); reference ${summary.reference || "as the commands have it"}; ${data.machine}`
  : data.machine;
byId("measured").hidden = !measured;
if (measured) {
  new Front().start();
  tables();
}
training();
