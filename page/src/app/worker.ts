// Runs the library beside the page, so that the page never waits for it.

import { Engine, Stopped, type StageName } from "./engine";
import type { FromWorker, ToWorker } from "./messages";

let engine: Engine | null = null;
/** Seconds of each stage of the scene. */
let seconds: Record<string, number> = {};
let stage: [StageName, number] | null = null;

const say = (message: FromWorker, transfer: Transferable[] = []) => postMessage(message, { transfer });

function note(next: StageName | null): void {
  const now = performance.now();
  if (stage !== null) seconds[stage[0]] = (seconds[stage[0]] ?? 0) + (now - stage[1]) / 1000;
  stage = next === null ? null : [next, now];
}

function tell(name: StageName, share: number): void {
  if (stage?.[0] !== name) note(name);
  say({ kind: "progress", stage: name, share });
}

function open(running: Engine, name: string, bytes: ArrayBuffer): void {
  seconds = {};
  const parsed = running.parse(new Uint8Array(bytes), name);
  say({ kind: "read", parsed });
  running.segment();
  const parts = running.page(name);
  note(null);
  const buffers = [...parts.values()].map((part) => part.buffer);
  say({ kind: "opened", parts, memory: running.memory, seconds }, buffers);
}

async function handle(message: ToWorker): Promise<void> {
  if (message.kind === "start") {
    engine = await Engine.start(message.program, message.assets);
    engine.tell = tell;
    say({ kind: "ready" });
    return;
  }
  if (engine === null) throw new Error("the worker was not started");
  if (message.kind === "open") {
    open(engine, message.name, message.bytes);
    return;
  }
  const bytes = engine.write(message.format, message.keep);
  note(null);
  say({ kind: "saved", format: message.format, bytes }, [bytes.buffer]);
}

/** One message after the other: a file may come while the library is still being compiled. */
let turn = Promise.resolve();

addEventListener("message", (event: MessageEvent<ToWorker>) => {
  turn = turn.then(() => handle(event.data)).catch((error: unknown) => {
    note(null);
    const message = error instanceof Error ? error.message : String(error);
    say({ kind: "failed", message, stopped: error instanceof Stopped });
  });
});
