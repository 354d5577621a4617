// Elements without markup in text: everything that comes from a file is text.

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

export function byId<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (found === null) throw new Error(`the page lacks #${id}`);
  return found as T;
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
