// How much of the work is done and how long the rest takes.

import { STAGES, type StageName } from "./engine";

/** Part of the whole time that each stage takes, of rooms of 87 and 200 thousand Gaussians. */
const PARTS: Record<StageName, number> = {
  read: 0.02, alignment: 0.05, network: 0.62, surfaces: 0.1, labels: 0.08, recognition: 0.03, objects: 0.05, page: 0.05, write: 0,
};

export class Clock {
  private began = performance.now();

  begin(): void {
    this.began = performance.now();
  }

  /** Seconds. */
  elapsed(): number {
    return (performance.now() - this.began) / 1000;
  }

  /** The part done, 0..=1, and seconds left; null as long as nobody can know. */
  at(stage: StageName, share: number): { done: number; left: number | null } {
    if (stage === "write") return { done: share, left: null };
    const before = STAGES.slice(0, STAGES.indexOf(stage)).reduce((sum, name) => sum + PARTS[name], 0);
    const done = Math.min(1, before + PARTS[stage] * Math.min(1, Math.max(0, share)));
    const elapsed = this.elapsed();
    return { done, left: elapsed < 2 || done < 0.1 ? null : (elapsed * (1 - done)) / done };
  }
}
