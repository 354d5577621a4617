// What the page and its worker say to each other.

import type { Assets, FileFormat, Parsed, StageName } from "./engine";

export type ToWorker =
  | { kind: "start"; program: ArrayBuffer; assets: Assets }
  | { kind: "open"; name: string; bytes: ArrayBuffer }
  | { kind: "save"; format: FileFormat; keep: Uint8Array };

export type FromWorker =
  | { kind: "ready" }
  | { kind: "progress"; stage: StageName; share: number }
  | { kind: "read"; parsed: Parsed }
  | { kind: "opened"; parts: Map<string, Uint8Array>; memory: number; seconds: Record<string, number> }
  | { kind: "saved"; format: FileFormat; bytes: Uint8Array<ArrayBuffer> }
  /** `stopped`: the worker is of no more use. */
  | { kind: "failed"; message: string; stopped: boolean };
