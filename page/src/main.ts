// The page: what is on it and what happens when it is used.

import { isBuilding, legendOrder } from "./classes";
import { MODES, paint, viridis, type Mode } from "./colors";
import { startApp, type Saver } from "./app/app";
import { carried, readAbout, readScene, type About, type Parts, type SceneData } from "./data";
import { byId, css, element, short, thousands } from "./kit/dom";
import { grown, Past } from "./editing";
import { csv, ply, save } from "./exporting";
import { readHash, writeHash } from "./hash";
import { PhraseBook } from "./phrases";
import { answer, foundObjects, selection, type Found } from "./query";
import { Stage } from "./stage";

/** Names of the colorings, and what their colors are. */
const MODE_NAMES: Record<Mode, [string, string]> = {
  colors: ["Colors", "own colors, as in photos"], labels: ["Labels", "a color for each class"],
  objects: ["Objects", "a color for each object"], confidence: ["Confidence", "how sure labels are"],
  features: ["Features", "the first three code numbers"],
};
/** Longest lists that are shown at once. */
const MOST_ROWS = 400;
/** Changes that can be undone: each keeps some bytes for every Gaussian. */
const MOST_UNDONE = 16;

/** What undo brings back. */
interface State {
  found: Found | null;
  selected: Uint8Array | null;
  threshold: number;
  onlyWins: boolean;
  asked: string;
  hidden: Set<number>;
}

class Page {
  private mode: Mode = "colors";
  private hidden = new Set<number>();
  private found: Found | null = null;
  private threshold = 0;
  private onlyWins = true;
  private selected: Uint8Array | null = null;
  private stage: Stage | null = null;
  private book: PhraseBook;
  private past = new Past<State>(MOST_UNDONE);
  /** The text of the selection; the field may hold another one already. */
  private asked = "";
  /** The Gaussian that was clicked last, −1 = none. */
  private clicked = -1;
  readonly queryTimes: number[] = [];

  /** Ends what listens to the document. */
  private ending = new AbortController();

  /** `saver`: writes the scene as a file, where the page has it. */
  constructor(private data: SceneData, private saver: Saver | null) {
    this.book = new PhraseBook(data);
  }

  /** Another scene takes the place of this one. */
  close(): void {
    this.ending.abort();
    void this.stage?.close();
  }

  async start(): Promise<void> {
    const canvas = byId<HTMLCanvasElement>("canvas");
    this.stage = await Stage.open(this.data, canvas, (row) => this.describe(row));
    this.stage.onCut = () => this.repaint();
    this.modes();
    this.controls();
    this.restore();
    // An address that is put into the open page.
    const { signal } = this.ending;
    addEventListener("hashchange", () => this.restore(), { signal });
    const sharing = setInterval(() => this.share(), 500);
    signal.addEventListener("abort", () => clearInterval(sharing));
  }

  /** The view that the address says. */
  private restore(): void {
    const before = readHash(location.hash);
    this.past = new Past(MOST_UNDONE);
    byId<HTMLButtonElement>("undo").disabled = true;
    this.clearQuery();
    this.mode = before.mode !== null && this.available(before.mode) ? before.mode : "colors";
    this.hidden.clear();
    this.setCut(before.cut);
    before.hidden.forEach((h) => h <= this.data.about.classes.length && this.hidden.add(h));
    this.legend();
    this.objectList(null);
    this.refresh();
    if (before.query !== "") {
      byId<HTMLInputElement>("query").value = before.query;
      this.answer(before.query, before.threshold);
    }
    if (before.camera !== null) this.stage?.navigator.restore(before.camera);
  }

  /** For scripts and tests. */
  get hooks() {
    const stage = this.stage;
    return {
      ask: (text: string) => this.ask(text),
      frames: () => stage?.frames ?? 0,
      project: (row: number) => stage?.project(row) ?? null,
      pick: (x: number, y: number) => stage?.pick(x, y) ?? -1,
      selected: () => this.selected,
      /** Red, green, blue, opacity of each Gaussian as it is drawn. */
      drawn: () => stage?.paint ?? null,
      data: this.data,
      queryTimes: this.queryTimes,
    };
  }

  private available(mode: Mode): boolean {
    const { about } = this.data;
    if (mode === "labels") return about.classes.length > 0;
    if (mode === "objects") return about.objects.length > 0;
    if (mode === "confidence") return this.data.score.length > 0;
    if (mode === "features") return about.codes !== null;
    return true;
  }

  private modes(): void {
    const bar = byId("modes");
    MODES.filter((m) => this.available(m)).forEach((mode, i) => {
      const [text, what] = MODE_NAMES[mode];
      const button = element("button", { text, title: `Show ${what} (key ${i + 1})` });
      button.dataset.mode = mode;
      button.addEventListener("click", () => this.setMode(mode));
      bar.append(button);
    });
  }

  private setMode(mode: Mode): void {
    if (this.found !== null) this.note();
    this.mode = mode;
    this.clearQuery();
    this.refresh();
  }

  private controls(): void {
    const input = byId<HTMLInputElement>("query");
    byId("ask").addEventListener("submit", (e) => {
      e.preventDefault();
      this.ask(input.value);
    });
    input.addEventListener("input", () => {
      const names = this.book.suggest(input.value, 8);
      byId("suggestions").replaceChildren(...names.map((n) => {
        const option = element("option");
        option.value = n;
        return option;
      }));
    });
    const slider = byId<HTMLInputElement>("threshold");
    slider.addEventListener("input", () => {
      this.note("threshold");
      this.select(Number(slider.value));
    });
    const wins = byId<HTMLInputElement>("wins");
    wins.addEventListener("change", () => {
      this.note();
      this.onlyWins = wins.checked;
      this.select(this.threshold);
    });
    byId("clear").addEventListener("click", () => this.clear());
    byId("grow").addEventListener("click", () => this.grow(1));
    byId("shrink").addEventListener("click", () => this.grow(-1));
    byId("undo").addEventListener("click", () => this.undo());
    byId("invert").addEventListener("click", () => this.invert());
    byId("csv").addEventListener("click", () => this.selected !== null
      && save(`${this.name()}.csv`, csv(this.data, this.selected), "text/csv"));
    byId("ply").addEventListener("click", () => this.selected !== null
      && save(`${this.name()}.ply`, ply(this.data, this.selected) as BlobPart, "application/octet-stream"));
    byId("home").addEventListener("click", () => this.stage?.navigator.goHome());
    byId("all").addEventListener("click", () => this.showAll());
    // The panel of a scene before this one may have been folded.
    document.body.classList.remove("folded");
    byId("fold").addEventListener("click", () => this.fold());
    byId("shot").addEventListener("click", () => this.shoot());
    const cut = byId<HTMLInputElement>("cut");
    byId("cutting").hidden = this.stage?.room === null;
    cut.addEventListener("change", () => {
      this.setCut(cut.checked);
      this.repaint();
    });
    document.addEventListener("keydown", (e) => this.key(e), { signal: this.ending.signal });
    this.savers();
  }

  /** The title as the name of a file. */
  private name(): string {
    return short(this.data.about.title, 40).replace(/[^\p{L}\p{N}._-]+/gu, "_") || "scene";
  }

  private setCut(cuts: boolean): void {
    byId<HTMLInputElement>("cut").checked = cuts;
    if (this.stage !== null) this.stage.cuts = cuts;
  }

  private fold(): void {
    const folded = document.body.classList.toggle("folded"), button = byId("fold");
    button.textContent = folded ? "▴" : "▾";
    button.title = folded ? "Unfold the panel" : "Fold the panel";
    button.setAttribute("aria-label", button.title);
    button.setAttribute("aria-expanded", String(!folded));
  }

  /** Saves what is seen. */
  private shoot(): void {
    this.stage?.picture().then(
      (picture) => save(`${this.name().replace(/(.)\.[^.]*$/, "$1")}.png`, picture, "image/png"),
      (error: unknown) => tell(`The picture cannot be saved: ${short(String(error), 200)}`),
    );
  }

  /** Buttons that save what is selected or, without a selection, the classes that are shown. */
  private savers(): void {
    const { saver } = this;
    if (saver === null) return;
    const buttons = (["ply", "spz"] as const).map((format) => {
      const button = element("button", { text: `Save .${format}`, title: "the selection or, without one, the classes that are shown" });
      button.addEventListener("click", () => saver(format, this.kept()));
      return button;
    });
    byId("legend").after(element("section", { className: "buttons" }, buttons));
  }

  /** For each Gaussian of the scene whether it is selected or shown. */
  private kept(): Uint8Array {
    const { about: { count, total }, rows, label } = this.data;
    const keep = new Uint8Array(total);
    for (let i = 0; i < count; i++) {
      const is = this.selected !== null ? this.selected[i] === 1 : !this.hidden.has(label[i]);
      if (is) keep[rows.length > 0 ? rows[i] : i] = 1;
    }
    return keep;
  }

  private key(e: KeyboardEvent): void {
    const target = e.target as HTMLElement;
    const types = target instanceof HTMLInputElement && target.type !== "checkbox" && target.type !== "range";
    if ((e.ctrlKey || e.metaKey) && !e.altKey && !e.shiftKey && e.key === "z" && !types) {
      e.preventDefault();
      this.undo();
      return;
    }
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    if (e.key === "Escape") {
      this.clear();
      byId("canvas").focus();
      return;
    }
    if (types) return;
    const modes = MODES.filter((m) => this.available(m));
    if (e.key === "/") {
      e.preventDefault();
      byId("query").focus();
    } else if (e.key === "?") {
      const help = byId<HTMLDetailsElement>("help");
      help.open = !help.open;
    } else if (e.key >= "1" && e.key <= String(modes.length)) {
      this.setMode(modes[Number(e.key) - 1]);
    } else if (e.key === "h") {
      this.stage?.navigator.goHome();
    } else if (e.key === "i") {
      this.invert();
    } else if (e.key === "g" || e.key === "G") {
      this.grow(e.key === "g" ? 1 : -1);
    } else if (e.key === "u") {
      this.undo();
    } else if (e.key === "c") {
      this.shoot();
    } else if (e.key === "p" && this.stage !== null) {
      this.describe(this.stage.pickCenter());
    } else if (e.key === "+" || e.key === "-") {
      this.stage?.navigator.zoom(e.key === "+" ? 0.85 : 1 / 0.85);
    }
  }

  private ask(text: string): void {
    if (text.trim() === "") {
      this.clear();
      return;
    }
    this.note();
    this.answer(text, null);
  }

  private answer(text: string, threshold: number | null): void {
    this.asked = text;
    const began = performance.now();
    this.found = answer(this.data, this.book, text.slice(0, 500));
    byId<HTMLInputElement>("threshold").value = String(threshold ?? this.found.threshold);
    this.select(threshold ?? this.found.threshold);
    this.queryTimes.push(performance.now() - began);
  }

  private select(threshold: number): void {
    if (this.found === null) return;
    this.threshold = threshold;
    this.selected = this.found.isUnknown && this.found.objects === null
      ? new Uint8Array(this.data.about.count)
      : selection(this.found, threshold, this.onlyWins);
    this.refresh();
  }

  private invert(): void {
    if (this.selected === null || this.found === null) return;
    this.note();
    const invisible = this.hidden;
    this.selected = this.selected.map((s, i) => (s === 1 || invisible.has(this.data.label[i]) ? 0 : 1));
    this.found = { ...this.found, text: `all but ${this.found.text}` };
    this.refresh();
  }

  /** Makes the selection larger or smaller. */
  private grow(by: 1 | -1): void {
    if (this.selected === null) return;
    this.note();
    this.selected = grown(this.data, this.selected, this.hidden, by);
    this.refresh();
  }

  /** Keeps for undo what is selected and shown now. */
  private note(kind: string | null = null): void {
    const { found, selected, threshold, onlyWins, asked, hidden } = this;
    this.past.note({ found, selected, threshold, onlyWins, asked, hidden: new Set(hidden) }, kind);
    byId<HTMLButtonElement>("undo").disabled = false;
  }

  private undo(): void {
    const before = this.past.back();
    if (before === null) return;
    byId<HTMLButtonElement>("undo").disabled = this.past.isEmpty;
    this.clearQuery();
    ({ found: this.found, selected: this.selected, threshold: this.threshold, onlyWins: this.onlyWins, asked: this.asked, hidden: this.hidden } = before);
    byId<HTMLInputElement>("query").value = before.asked;
    byId<HTMLInputElement>("threshold").value = String(before.threshold);
    byId<HTMLInputElement>("wins").checked = before.onlyWins;
    this.legend();
    this.refresh();
  }

  /** Selects and measures nothing. */
  private clear(): void {
    if (this.found !== null) this.note();
    this.clearQuery();
    this.clicked = -1;
    this.stage?.measure([]);
    this.refresh();
  }

  private clearQuery(): void {
    this.found = null;
    this.asked = "";
    this.selected = null;
    byId<HTMLInputElement>("query").value = "";
    this.stage?.outline([], 0);
  }

  /** All Gaussians of a class or an object as the selection. */
  private take(text: string, is: (i: number) => boolean, objects: number[] | null): void {
    this.note();
    const n = this.data.about.count;
    const wins = new Uint8Array(n), heat = new Uint8Array(n);
    for (let i = 0; i < n; i++) {
      if (is(i)) {
        wins[i] = 1;
        heat[i] = this.data.score.length > 0 ? this.data.score[i] : 255;
      }
    }
    this.found = { text, how: "", isUnknown: false, heat, wins, range: [0, 1], threshold: 0, objects };
    byId<HTMLInputElement>("threshold").value = "0";
    this.select(0);
  }

  private showAll(): void {
    if (this.hidden.size > 0) this.note();
    this.hidden.clear();
    this.legend();
    this.refresh();
  }

  private repaint(): void {
    const { stage, mode, hidden, found, selected } = this;
    if (stage === null) return;
    const cut = stage.room === null ? null : { sides: stage.room.sides, away: stage.cutAway() };
    paint(this.data, { mode, hidden, found, selected, cut }, stage.paint);
    stage.repaint();
  }

  private refresh(): void {
    this.repaint();
    document.querySelectorAll<HTMLButtonElement>("#modes button").forEach((b) => {
      b.setAttribute("aria-pressed", String(this.found === null && b.dataset.mode === this.mode));
    });
    this.results();
  }

  private results(): void {
    const panel = byId("results");
    panel.hidden = this.found === null;
    if (this.found === null || this.selected === null) {
      this.objectList(null);
      return;
    }
    const { found } = this;
    const { count, objects } = foundObjects(this.data, this.selected);
    const what = objects.length === 1 ? "1 object" : `${objects.length} objects`;
    byId("summary").textContent = found.isUnknown && count === 0
      ? `“${short(found.text)}”: nothing found`
      : `“${short(found.text)}”: ${thousands(count)} Gaussians, ${what}`;
    byId("how").textContent = found.how;
    const [low, high] = found.range;
    const at = low + ((high - low) * this.threshold) / 255;
    byId("value").textContent = at.toFixed(2);
    byId("ramp").style.background = `linear-gradient(90deg, ${[0, 0.25, 0.5, 0.75, 1].map((t) => css(viridis(t))).join(", ")})`;
    byId("low").textContent = low.toFixed(2);
    byId("high").textContent = high.toFixed(2);
    this.stage?.outline(objects.slice(0, 200).map((o) => this.data.about.objects[o.object].corners), 0xffb454);
    this.objectList(objects.map((o) => o.object));
  }

  private legend(): void {
    const list = byId("classes");
    const { classes } = this.data.about;
    const order = legendOrder(classes);
    const rows = order.slice(0, MOST_ROWS).map((i) => {
      const { name, color, count } = classes[i];
      const box = element("input");
      box.type = "checkbox";
      box.checked = !this.hidden.has(i + 1);
      box.title = `show ${short(name)}`;
      box.setAttribute("aria-label", box.title);
      box.addEventListener("change", () => {
        this.note();
        if (box.checked) this.hidden.delete(i + 1);
        else this.hidden.add(i + 1);
        this.refresh();
      });
      const swatch = element("span", { className: "swatch" });
      swatch.style.background = css(color);
      const label = element("button", { text: short(name), className: "name", title: "select this class" });
      label.addEventListener("click", () => this.take(name, (row) => this.data.label[row] === i + 1, null));
      const only = element("button", { text: "only", className: "only", title: "hide all other classes" });
      only.setAttribute("aria-label", `only ${short(name)}`);
      only.addEventListener("click", () => {
        this.note();
        this.hidden = new Set([0, ...classes.map((_, c) => c + 1)]);
        this.hidden.delete(i + 1);
        this.legend();
        this.refresh();
      });
      return element("li", {}, [box, swatch, label, element("span", { text: thousands(count), className: "count" }), only]);
    });
    if (order.length > rows.length) rows.push(element("li", { text: `and ${thousands(order.length - rows.length)} more`, className: "more" }));
    const none = this.data.about.count - classes.reduce((sum, c) => sum + c.count, 0);
    if (none > 0 && classes.length > 0) {
      const swatch = element("span", { className: "swatch" });
      rows.push(element("li", { className: "none" }, [
        element("span"), swatch, element("span", { text: "without a class", className: "name" }),
        element("span", { text: thousands(none), className: "count" }), element("span"),
      ]));
    }
    list.replaceChildren(...rows);
    byId("legend").hidden = rows.length === 0;
  }

  private objectList(chosen: number[] | null): void {
    const { objects, classes } = this.data.about;
    // Of all objects the building's parts come last.
    const building = objects.map((o) => Number(isBuilding(classes[o.label].name)));
    const places = chosen ?? objects.map((_, i) => i).sort((a, b) => building[a] - building[b] || a - b);
    byId("objects").hidden = objects.length === 0;
    byId("objects-title").textContent = chosen === null ? `Objects (${objects.length})` : `Found objects (${places.length})`;
    const rows = places.slice(0, MOST_ROWS).map((i) => {
      const o = objects[i];
      const size = o.size.map((v) => v.toFixed(2)).join(" × ");
      const go = element("button", { className: "name", title: "go there" }, [
        element("span", { text: `${o.id} ${short(classes[o.label].name, 28)}` }),
        element("small", { text: `${size} m` }),
      ]);
      go.addEventListener("click", () => {
        this.stage?.lookAt(o.corners);
        if (chosen === null) this.take(`${short(classes[o.label].name)} ${o.id}`, (row) => this.data.object[row] === i + 1, [i]);
      });
      return element("li", {}, [go]);
    });
    if (places.length > rows.length) rows.push(element("li", { text: `and ${thousands(places.length - rows.length)} more`, className: "more" }));
    byId("object-list").replaceChildren(...rows);
  }

  private describe(row: number): void {
    const card = byId("card");
    card.hidden = row < 0;
    if (row < 0) return;
    const { data } = this;
    const { classes, objects, metresPerUnit } = data.about;
    const lines: [string, string][] = [];
    if (data.label[row] > 0) lines.push(["class", short(classes[data.label[row] - 1].name)]);
    else if (classes.length > 0) lines.push(["class", "none"]);
    if (data.score.length > 0) lines.push(["score", (data.score[row] / 255).toFixed(2)]);
    const second = this.runnerUp(row);
    if (second !== null) lines.push(["second", `${short(classes[second[0]].name)} (${second[1].toFixed(2)})`]);
    if (data.object[row] > 0) {
      const o = objects[data.object[row] - 1];
      lines.push(["object", `${o.id}: ${thousands(o.count)} Gaussians`]);
      lines.push(["size", `${o.size.map((v) => v.toFixed(2)).join(" × ")} m`]);
    }
    const at = (of: number) => Array.from(data.position.subarray(3 * of, 3 * of + 3));
    lines.push(["place", `${at(row).map((v) => (v * metresPerUnit).toFixed(3)).join(", ")} m`]);
    if (this.clicked >= 0 && this.clicked !== row) {
      const [from, to] = [at(this.clicked), at(row)];
      lines.push(["from before", `${(Math.hypot(...to.map((v, a) => v - from[a])) * metresPerUnit).toFixed(3)} m`]);
      this.stage?.measure([from, to]);
    }
    this.clicked = row;
    lines.push(["Gaussian", thousands(data.rows.length > 0 ? data.rows[row] : row)]);
    byId("facts").replaceChildren(...lines.flatMap(([k, v]) => [element("dt", { text: k }), element("dd", { text: v })]));
  }

  /** The class after the best one, by the codes. */
  private runnerUp(row: number): [number, number] | null {
    const { codes, slot, about, label } = this.data;
    if (codes === null || !(slot[row] < codes.rows)) return null;
    const others = about.classes.map((_, c): [number, number] => [c, codes.score(slot[row], c)]);
    others.sort((a, b) => b[1] - a[1]);
    return others.find(([c]) => c !== label[row] - 1) ?? null;
  }

  private share(): void {
    if (this.stage === null) return;
    writeHash({
      mode: this.mode,
      query: this.found !== null ? byId<HTMLInputElement>("query").value : "",
      threshold: this.threshold,
      hidden: [...this.hidden],
      camera: this.stage.navigator.state(),
      cut: this.stage.cuts,
    });
  }
}

function counts(about: About): void {
  document.title = `${short(about.title)} · scenesplat`;
  byId("title").textContent = short(about.title);
  const all = about.count < about.total ? ` of ${thousands(about.total)}` : "";
  byId("count").textContent = `${thousands(about.count)}${all} Gaussians`;
  const warnings = byId("warnings");
  warnings.replaceChildren(...about.warnings.map((text) => element("li", { text: short(text, 400) })));
  warnings.hidden = about.warnings.length === 0;
  byId("remarks").replaceChildren(...about.remarks.map((r) => element("li", { text: short(r, 300) })));
}

function tell(text: string): void {
  const box = byId("message");
  box.textContent = text;
  box.hidden = false;
}

/** The scene that is shown. */
let shown: Page | null = null;

/** Shows a scene: that of `parts` or the one that the page carries. */
async function show(parts: Parts | null, saver: Saver | null): Promise<void> {
  const began = performance.now();
  const about = await readAbout(parts);
  counts(about);
  const canvas = document.createElement("canvas");
  if (canvas.getContext("webgl2") === null) {
    document.body.classList.add("blind");
    tell("This browser shows no WebGL 2, which the scene is drawn with. Try another browser, or switch on hardware acceleration. What is in the scene is listed here.");
    const rows = legendOrder(about.classes).slice(0, MOST_ROWS).map((i) => element("li", {}, [
      element("span"), element("span"), element("span", { text: short(about.classes[i].name), className: "name" }),
      element("span", { text: thousands(about.classes[i].count), className: "count" }), element("span"),
    ]));
    byId("classes").replaceChildren(...rows);
    byId("legend").hidden = rows.length === 0;
    byId("loading").hidden = true;
    Object.assign(window, { scenesplat: { ready: false, webgl: false } });
    return;
  }
  const data = await readScene(about, (share) => {
    byId<HTMLProgressElement>("arrived").value = share;
    byId("loading-text").textContent = `opening the scene … ${Math.floor(100 * share)} %`;
  }, parts);
  const page = new Page(data, saver);
  shown = page;
  await page.start();
  byId("loading").hidden = true;
  const hooks = page.hooks;
  const wait = () => {
    if (hooks.frames() < 2) return void requestAnimationFrame(wait);
    Object.assign(window, { scenesplat: { ...hooks, ready: true, webgl: true, loadMs: performance.now() - began } });
  };
  wait();
}

/** A page that carries the library instead of a scene takes files. */
async function start(): Promise<void> {
  if (document.getElementById("block-engine") === null) return show(null, null);
  const attribution = (await carried("attribution", "deflate")).bytes;
  byId("licenses").append(`\n----\n\n${new TextDecoder().decode(attribution)}`);
  const viewer = [...document.body.children].filter((e) => e.id !== "message" && e.id !== "loading" && !(e instanceof HTMLScriptElement));
  const fresh = viewer.map((e) => e.cloneNode(true) as Element);
  let there = viewer;
  return startApp(async (parts, saver) => {
    // Markup as it was: nothing of the last scene is left, nor what listened to it.
    shown?.close();
    const next = fresh.map((e) => e.cloneNode(true) as Element);
    there.forEach((e, i) => e.replaceWith(next[i]));
    there = next;
    history.replaceState(null, "", location.pathname);
    document.body.classList.remove("empty");
    await show(parts, saver);
  });
}

start().catch((error: unknown) => {
  byId("loading").hidden = true;
  tell(`The page could not be opened: ${short(String(error), 300)}`);
  throw error;
});
