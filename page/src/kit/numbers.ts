// Numbers as people read them.

/** Three digits at most. */
export function digits(v: number): string {
  return Number(v.toPrecision(3)).toString();
}

export function seconds(s: number | null): string {
  if (s === null || !isFinite(s)) return "–";
  if (s < 1e-3) return `${digits(s * 1e6)} µs`;
  if (s < 0.0995) return `${digits(s * 1e3)} ms`;
  if (s < 120) return `${digits(s)} s`;
  return s < 7200 ? `${digits(s / 60)} min` : `${digits(s / 3600)} h`;
}

export function bytes(b: number | null): string {
  if (b === null) return "–";
  const [unit, of] = b >= 1e9 ? ["GB", 1e9] : b >= 1e6 ? ["MB", 1e6] : b >= 1e3 ? ["kB", 1e3] : ["B", 1];
  return `${digits(b / (of as number))} ${unit}`;
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
