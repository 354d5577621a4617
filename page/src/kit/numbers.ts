// Numbers as people read them.

/** Three digits at most, or so many. */
export function digits(v: number, most = 3): string {
  return Number(v.toPrecision(most)).toString();
}

export function seconds(s: number | null, most = 3): string {
  if (s === null || !isFinite(s)) return "–";
  if (s < 1e-3) return `${digits(s * 1e6, most)} µs`;
  if (s < 0.0995) return `${digits(s * 1e3, most)} ms`;
  if (s < 120) return `${digits(s, most)} s`;
  return s < 7200 ? `${digits(s / 60, most)} min` : `${digits(s / 3600, most)} h`;
}

export function bytes(b: number | null, most = 3): string {
  if (b === null) return "–";
  const [unit, of] = b >= 1e9 ? ["GB", 1e9] : b >= 1e6 ? ["MB", 1e6] : b >= 1e3 ? ["kB", 1e3] : ["B", 1];
  return `${digits(b / (of as number), most)} ${unit}`;
}

export function percent(v: number | null): string {
  return v === null ? "–" : `${(100 * v).toFixed(2)} %`;
}

/** Round numbers inside a range: one, two or five times a power of ten. */
export function ticks(low: number, high: number, logarithmic: boolean, most = 8): number[] {
  const inside = (v: number) => v >= low && v <= high;
  if (logarithmic && low > 0) {
    const all: number[] = [];
    for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e++) {
      for (const f of [1, 2, 5]) if (inside(f * 10 ** e)) all.push(f * 10 ** e);
    }
    const decades = all.filter((v) => Math.abs(Math.log10(v) % 1) < 1e-9);
    if (all.length >= 3) return all.length <= most + 2 ? all : decades.filter((_, i) => i % Math.ceil(decades.length / most) === 0);
  }
  const rough = (high - low) / most;
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = ([1, 2, 5, 10].find((f) => f * power >= rough) ?? 10) * power;
  const out: number[] = [];
  for (let i = Math.ceil(low / step); i * step <= high && out.length < 2 * most; i++) out.push(i * step);
  return out;
}

/** Texts of ticks with the digits that their distance asks for: no two are the same. */
export function labels(values: number[], text: (v: number, most: number) => string): string[] {
  const gap = Math.min(...values.slice(1).map((v, i) => v - values[i]));
  const size = Math.max(...values.map(Math.abs));
  // One more, for units of which the values are no round numbers.
  const most = isFinite(gap) ? Math.floor(Math.log10(size)) - Math.floor(Math.log10(gap) + 1e-6) + 2 : 3;
  return values.map((v) => text(v, Math.max(3, Math.min(15, most))));
}
