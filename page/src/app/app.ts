// The page of `scenesplat app`: takes a file, has a worker label it, and shows the result.

import WORKER from "worker:./worker.ts";
import { carried, type Parts } from "../data";
import { save } from "../exporting";
import { byId, element, short, thousands } from "../kit/dom";
import type { FileFormat, StageName } from "./engine";
import type { FromWorker, ToWorker } from "./messages";
import { Clock } from "./clock";

/** Saves Gaussians of the shown scene; `keep`: 0 for what is left out. */
export type Saver = (format: FileFormat, keep: Uint8Array) => void;
/** Shows a labeled scene in place of the last one. */
export type Show = (parts: Parts, saver: Saver) => Promise<void>;

/** Bytes of the largest file that is taken: it has to fit beside its Gaussians into the 4 GiB that the library can address. */
const MOST_BYTES = 1.4e9;

const STAGE_NAMES: Record<StageName, string> = {
  read: "reading the file", alignment: "finding out how the scene lies", network: "running the network",
  surfaces: "finding surfaces", labels: "labeling", recognition: "judging what is known",
  objects: "finding objects", page: "packing", write: "writing the file",
};

class App {
  private worker: Worker | null = null;
  private busy = false;
  private clock = new Clock();
  private name = "scene";
  /** Gaussians of the scene, once they are known. */
  private count = 0;

  constructor(private program: Uint8Array<ArrayBuffer>, private weights: Uint8Array, private phrases: Uint8Array, private show: Show) {}

  /** Takes files at any time, wherever they are dropped. */
  listen(): void {
    addEventListener("dragover", (e) => {
      e.preventDefault();
      document.body.classList.add("over");
    });
    addEventListener("dragleave", () => document.body.classList.remove("over"));
    addEventListener("drop", (e) => {
      e.preventDefault();
      document.body.classList.remove("over");
      const files = [...e.dataTransfer?.files ?? []];
      if (files.length > 1) tell("Drop one file: a .ply, .spz, .sog, .splat, .ksplat, .glb, .gltf, .usda or .usdz. A folder can be zipped to a .sog.");
      else if (files.length === 1) void this.open(files[0]);
    });
    document.addEventListener("change", (e) => {
      const input = e.target;
      if (input instanceof HTMLInputElement && input.id === "file" && input.files?.length === 1) void this.open(input.files[0]);
    });
    document.addEventListener("click", (e) => {
      if (e.target instanceof HTMLElement && e.target.id === "stop") this.stop("It was stopped; drop another file.");
    });
  }

  async open(file: File): Promise<void> {
    if (this.busy) {
      tell("One scene at a time: wait, or stop the one that is being labeled.");
      return;
    }
    if (file.size > MOST_BYTES) {
      tell(`${short(file.name)} has ${(file.size / 1e9).toFixed(1)} GB, a browser labels files up to ${MOST_BYTES / 1e9} GB: `
        + "crop or compress it (.spz, .sog), or use the program (scenesplat view FILE), which has no such limit.");
      return;
    }
    this.busy = true;
    this.name = file.name;
    this.count = 0;
    this.clock.begin();
    byId("message").hidden = true;
    document.body.classList.add("working");
    this.progress("read", 0);
    try {
      const bytes = await file.arrayBuffer();
      this.started().postMessage({ kind: "open", name: file.name, bytes } satisfies ToWorker, [bytes]);
    } catch (error) {
      this.end(`${short(file.name)} cannot be read: ${short(String(error), 200)}`);
    }
  }

  private started(): Worker {
    if (this.worker !== null) return this.worker;
    const url = URL.createObjectURL(new Blob([WORKER], { type: "text/javascript" }));
    const worker = new Worker(url);
    worker.addEventListener("message", (e: MessageEvent<FromWorker>) => void this.hear(e.data));
    worker.addEventListener("error", (e) => this.stop(`The worker stopped: ${short(e.message, 300)}`));
    // Copies: a worker that stops takes its own with it.
    const program = this.program.slice().buffer;
    const assets = { weights: this.weights, phrases: this.phrases };
    worker.postMessage({ kind: "start", program, assets } satisfies ToWorker, [program]);
    this.worker = worker;
    return worker;
  }

  private async hear(message: FromWorker): Promise<void> {
    if (message.kind === "progress") this.progress(message.stage, message.share);
    else if (message.kind === "read") this.count = message.parsed.gaussians;
    else if (message.kind === "failed") {
      if (message.stopped) this.stop(message.message);
      else this.end(message.message);
    } else if (message.kind === "saved") {
      const name = this.name.replace(/\.[^.]*$/, "");
      save(`${name}-labeled.${message.format}`, message.bytes, "application/octet-stream");
      this.end(null);
    } else if (message.kind === "opened") {
      const { seconds, memory } = message;
      try {
        await this.show(message.parts, (format, keep) => this.save(format, keep));
        Object.assign(globalThis, { scenesplatApp: { seconds, memory, total: this.clock.elapsed() } });
        this.end(null);
      } catch (error) {
        this.end(`The scene cannot be shown: ${short(String(error), 300)}`);
      }
    }
  }

  private save(format: FileFormat, keep: Uint8Array): void {
    if (this.busy) return;
    this.busy = true;
    this.clock.begin();
    this.started().postMessage({ kind: "save", format, keep } satisfies ToWorker);
  }

  private progress(stage: StageName, share: number): void {
    const { done, left } = this.clock.at(stage, share);
    byId<HTMLProgressElement>("arrived").value = done;
    const of = this.count > 0 ? ` (${thousands(this.count)} Gaussians)` : "";
    const time = left === null ? "" : `, about ${left < 1 ? 1 : Math.round(left)} s left`;
    byId("loading-text").textContent = `${STAGE_NAMES[stage]}${of} … ${Math.floor(100 * done)} %${time}`;
  }

  /** Ends the worker, and what it was doing. */
  private stop(message: string): void {
    this.worker?.terminate();
    this.worker = null;
    this.end(message);
  }

  private end(message: string | null): void {
    this.busy = false;
    document.body.classList.remove("working");
    byId("loading").hidden = true;
    if (message !== null) tell(message);
  }
}

function tell(text: string): void {
  const box = byId("message");
  box.textContent = short(text, 1000);
  box.hidden = false;
}

/** What the body holds besides the viewer. */
export function takeFiles(): HTMLElement {
  const input = element("input", { className: "file" });
  input.type = "file";
  input.id = "file";
  input.accept = ".ply,.spz,.sog,.splat,.ksplat,.glb,.gltf,.usda,.usdz";
  const stop = element("button", { text: "Stop" });
  stop.id = "stop";
  stop.type = "button";
  const box = element("section", {}, [
    element("h1", { text: "Drop a scan here" }),
    element("p", { text: "A room of 3D Gaussians: .ply, .spz, .sog, .splat, .ksplat, .glb, .usda or .usdz, up to 2 million Gaussians. It is labeled on this computer, and nothing leaves this page." }),
    element("label", {}, [element("span", { text: "or choose a file " }), input]),
    stop,
  ]);
  box.id = "drop";
  box.setAttribute("aria-label", "The file of the scene");
  return box;
}

export async function startApp(show: Show): Promise<void> {
  const [program, weights, phrases] = await Promise.all([
    carried("engine", "gzip"), carried("weights", "deflate"), carried("phrases", "deflate"),
  ]);
  const app = new App(program.bytes, weights.bytes, phrases.bytes, show);
  document.body.classList.add("app", "empty");
  document.body.append(takeFiles());
  byId("loading").hidden = true;
  app.listen();
}
