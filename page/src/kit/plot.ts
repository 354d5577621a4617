// A plot: axes with round numbers, lines, marks, and a note that follows the pointer.

import { element, shape } from "./dom";
import { labels, ticks } from "./numbers";

export interface Axis {
  low: number;
  high: number;
  log: boolean;
  /** Larger values stand lower or further left. */
  flipped?: boolean;
  label: string;
  /** The text of a value, in so many digits. */
  text: (v: number, most: number) => string;
}

/** A range around values, with a little room; equal values get one too. */
export function rangeOf(values: (number | null | undefined)[], log: boolean): { low: number; high: number; log: boolean } {
  let low = Infinity, high = -Infinity;
  for (const v of values) {
    if (typeof v !== "number" || !isFinite(v)) continue;
    if (v < low) low = v;
    if (v > high) high = v;
  }
  if (!(low <= high)) return { low: 0, high: 1, log: false };
  if (log && low > 0) {
    const room = Math.exp(Math.max(Math.log(high / low) * 0.08, 0.2));
    return { low: low / room, high: high * room, log: true };
  }
  const size = Math.max(Math.abs(low), Math.abs(high));
  // Ticks stay apart in 64 bits.
  const room = Math.max((high - low) * 0.08 || Math.abs(high) * 0.05 || 1e-6, size * 1e-12);
  return { low: low - room, high: high + room, log: false };
}

export interface Box { left: number; right: number; top: number; bottom: number }

/** What is drawn into an SVG element, in the units of its view box. */
export class Plot {
  constructor(readonly svg: SVGSVGElement, readonly box: Box, readonly x: Axis, readonly y: Axis) {
    svg.replaceChildren();
    this.axes();
  }

  atX(v: number): number {
    const share = shareOf(this.x, v);
    return this.box.left + share * (this.box.right - this.box.left);
  }

  atY(v: number): number {
    const share = shareOf(this.y, v);
    return this.box.bottom - share * (this.box.bottom - this.box.top);
  }

  /** The value of the x axis at a place of the view box. */
  valueAt(place: number): number {
    const { low, high, log } = this.x;
    const share = (place - this.box.left) / (this.box.right - this.box.left);
    return log ? low * (high / low) ** share : low + share * (high - low);
  }

  segment(from: [number, number], to: [number, number], className: string): void {
    const [x1, y1] = [this.atX(from[0]), this.atY(from[1])];
    this.add(shape("line", { x1, y1, x2: this.atX(to[0]), y2: this.atY(to[1]), class: className }));
  }

  /** A line through points. */
  line(points: [number, number][], className: string): void {
    const at = points.map(([x, y]) => `${this.atX(x).toFixed(2)},${this.atY(y).toFixed(2)}`);
    if (at.length > 0) this.add(shape("polyline", { points: at.join(" "), class: className, fill: "none" }));
  }

  mark(x: number, y: number, radius: number, className: string): SVGCircleElement {
    const dot = shape("circle", { cx: this.atX(x), cy: this.atY(y), r: radius, class: className });
    this.add(dot);
    return dot;
  }

  text(x: number, y: number, words: string, className: string, anchor = "start"): void {
    this.add(shape("text", { x, y, class: className, "text-anchor": anchor }, words));
  }

  add(node: SVGElement): void {
    this.svg.append(node);
  }

  private axes(): void {
    const { left, right, top, bottom } = this.box;
    const across = ticks(this.x.low, this.x.high, this.x.log, Math.max(3, Math.round((right - left) / 120)));
    const below = labels(across, this.x.text);
    across.forEach((v, i) => {
      const x = this.atX(v);
      this.add(shape("line", { x1: x, y1: top, x2: x, y2: bottom, class: "grid" }));
      this.text(x, bottom + 20, below[i], "tick", "middle");
    });
    const up = ticks(this.y.low, this.y.high, this.y.log, Math.max(3, Math.round((bottom - top) / 70)));
    const beside = labels(up, this.y.text);
    up.forEach((v, i) => {
      const y = this.atY(v);
      this.add(shape("line", { x1: left, y1: y, x2: right, y2: y, class: "grid" }));
      this.text(left - 8, y + 4, beside[i], "tick", "end");
    });
    if (this.x.label !== "") this.text((left + right) / 2, bottom + 46, this.x.label, "tick", "middle");
    if (this.y.label !== "") this.text(left + 6, top + 12, this.y.label, "tick");
  }
}

function shareOf({ low, high, log, flipped }: Axis, v: number): number {
  const share = log ? Math.log(v / low) / Math.log(high / low) : (v - low) / (high - low);
  return flipped === true ? 1 - share : share;
}

/** A note beside the pointer. */
export class Tip {
  private box = element("div", { className: "tip" });

  constructor() {
    this.box.hidden = true;
    document.body.append(this.box);
  }

  show(event: PointerEvent, content: Node[]): void {
    this.box.replaceChildren(...content);
    this.box.hidden = false;
    const { offsetWidth: w, offsetHeight: h } = this.box;
    this.box.style.left = `${Math.max(4, Math.min(event.clientX + 16, innerWidth - w - 8))}px`;
    this.box.style.top = `${Math.max(4, Math.min(event.clientY + 16, innerHeight - h - 8))}px`;
  }

  hide(): void {
    this.box.hidden = true;
  }
}

/** Names with their colors; `color` is a class of the style sheet. */
export function legend(entries: { name: string; color: string }[]): HTMLElement {
  return element("div", { className: "legend" }, entries.map(({ name, color }) =>
    element("span", {}, [element("i", { className: `swatch ${color}` }), element("span", { text: name, className: "named" })])));
}
