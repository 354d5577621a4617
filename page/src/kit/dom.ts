// Elements without markup in text: everything that comes from a file is text.

const SVG = "http://www.w3.org/2000/svg";

export function element<K extends keyof HTMLElementTagNameMap>(
  tag: K, options: { text?: string; className?: string; title?: string } = {}, children: Node[] = [],
): HTMLElementTagNameMap[K] {
  const out = document.createElement(tag);
  if (options.text !== undefined) out.textContent = options.text;
  if (options.className !== undefined) out.className = options.className;
  if (options.title !== undefined) out.title = options.title;
  out.append(...children);
  return out;
}

/** An element of a drawing. */
export function shape<K extends keyof SVGElementTagNameMap>(
  tag: K, attributes: Record<string, string | number>, text?: string,
): SVGElementTagNameMap[K] {
  const out = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) out.setAttribute(name, String(value));
  if (text !== undefined) out.textContent = text;
  return out;
}

export function byId<T extends Element = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (found === null) throw new Error(`the page lacks #${id}`);
  return found as unknown as T;
}

/** The data that a report carries. */
export function dataOf<T>(id: string): T {
  return JSON.parse(byId(id).textContent ?? "") as T;
}

/** A name that fits a line: the first 60 letters. */
export function short(text: string, most = 60): string {
  const letters = Array.from(text.slice(0, 4 * most));
  return letters.length > most ? letters.slice(0, most).join("") + "…" : letters.join("");
}

export function thousands(n: number): string {
  return n.toString().replace(/\B(?=(\d{3})+$)/g, "\u2009");
}

export function css([r, g, b]: number[]): string {
  return `rgb(${Math.round(r)}, ${Math.round(g)}, ${Math.round(b)})`;
}

/** Rows of a table; a cell is a text, or a node. */
export function rows(head: string[], body: { cells: (string | Node)[]; className?: string }[]): HTMLElement[] {
  const line = (tag: "th" | "td", cells: (string | Node)[], className?: string) => element("tr", { className },
    cells.map((c) => (typeof c === "string" ? element(tag, { text: c }) : element(tag, {}, [c]))));
  return [line("th", head), ...body.map((r) => line("td", r.cells, r.className))];
}
