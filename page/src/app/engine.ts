// The library as WebAssembly: what it exports, with bytes and texts instead of addresses. Runs in workers, pages and node.

/** Parts of the work by their numbers in `Stage` of the library. */
export const STAGES = ["read", "alignment", "network", "surfaces", "labels", "recognition", "objects", "page", "write"] as const;
export type StageName = (typeof STAGES)[number];
/** Is told how far a stage has come, 0..=1. */
export type Tell = (stage: StageName, share: number) => void;

/** What the library needs besides its program. */
export interface Assets {
  weights: Uint8Array;
  phrases: Uint8Array;
}

/** What is known of a scene that was read. */
export interface Parsed {
  name: string;
  format: string;
  gaussians: number;
  rowsOfFile: number;
  shDegree: number;
  /** What of its values had to be repaired; null if nothing. */
  repairs: string | null;
}

export interface FoundObject {
  id: number;
  class: string;
  label: number;
  score: number | null;
  count: number;
  position: number[];
  corners: number[][];
  volume: number;
  above_floor: number;
  wall_distance: number | null;
}

/** What was found in a scene. */
export interface Segmented {
  classes: string[];
  objects: FoundObject[];
  up: string;
  metresPerUnit: number;
  voxels: number;
  /** What makes labels doubtful. */
  warnings: string[];
  remarks: string[];
}

export type ListName = "positions" | "labels" | "instances" | "scores" | "features";
export type FileFormat = "ply" | "spz";

interface Exports {
  memory: WebAssembly.Memory;
  start(): void;
  allocate(length: number): number;
  answer_address(): number;
  answer_length(): number;
  give(name: number, nameLength: number, bytes: number, length: number): number;
  parse(name: number, nameLength: number, bytes: number, length: number): number;
  segment(): number;
  page(title: number, length: number): number;
  part(name: number, length: number): number;
  values(name: number, length: number): number;
  write(format: number, formatLength: number, keep: number, length: number): number;
}

/** The library stopped: a bug, or memory ran out. Only a new engine can go on. */
export class Stopped extends Error {}

const encoder = new TextEncoder();
const decoder = new TextDecoder();

export class Engine {
  private complaint = "";
  private library!: Exports;
  private isStopped = false;
  tell: Tell = () => undefined;

  /** `program`: the bytes of `scenesplat_browser.wasm`. */
  static async start(program: BufferSource, assets: Assets): Promise<Engine> {
    const engine = new Engine();
    const module = await WebAssembly.compile(program);
    const instance = await WebAssembly.instantiate(module, engine.imports(module));
    engine.library = instance.exports as unknown as Exports;
    engine.library.start();
    for (const [name, bytes] of Object.entries(assets)) engine.ask("give", name, bytes);
    return engine;
  }

  private imports(module: WebAssembly.Module): WebAssembly.Imports {
    const imports: Record<string, Record<string, unknown>> = {};
    for (const { module: from, name } of WebAssembly.Module.imports(module)) {
      // Libraries below ask browsers for random numbers; nothing here does.
      (imports[from] ??= {})[name] = () => {
        throw new Error(`the program asks for ${name}`);
      };
    }
    imports.page = {
      progress: (stage: number, share: number) => this.tell(STAGES[stage], share),
      complain: (address: number, length: number) => {
        this.complaint = decoder.decode(new Uint8Array(this.library.memory.buffer, address, length));
      },
    };
    return imports as WebAssembly.Imports;
  }

  /** Reads a scene; the last one is forgotten. */
  parse(bytes: Uint8Array, name: string): Parsed {
    return json(this.ask("parse", name, bytes));
  }

  /** Labels the scene that was read, and finds its objects. */
  segment(): Segmented {
    return json(this.ask("segment"));
  }

  /** What a page shows of the labeled scene: blocks by name. */
  page(title: string): Map<string, Uint8Array> {
    const names = decoder.decode(this.ask("page", title)).split("\n");
    return new Map(names.map((name) => [name, this.ask("part", name)]));
  }

  /** One value or row a Gaussian. */
  values(name: ListName): Float32Array | Int32Array {
    const { buffer } = this.ask("values", name);
    return name === "labels" || name === "instances" ? new Int32Array(buffer) : new Float32Array(buffer);
  }

  /** The scene as a file, without the Gaussians whose `keep` is 0. */
  write(format: FileFormat, keep: Uint8Array = new Uint8Array(0)): Uint8Array<ArrayBuffer> {
    return this.ask("write", format, keep);
  }

  /** Bytes of memory that the library holds. */
  get memory(): number {
    return this.library.memory.buffer.byteLength;
  }

  private ask(what: Exclude<keyof Exports, "memory">, ...given: (string | Uint8Array)[]): Uint8Array<ArrayBuffer> {
    if (this.isStopped) throw new Stopped("the program has stopped before");
    try {
      const numbers = given.flatMap((block) => this.put(block));
      const call = this.library[what] as (...numbers: number[]) => number;
      const failed = call(...numbers) !== 0;
      const length = this.library.answer_length();
      const answer = new Uint8Array(this.library.memory.buffer, this.library.answer_address(), length).slice();
      if (failed) throw new Error(decoder.decode(answer));
      return answer;
    } catch (error) {
      if (!(error instanceof WebAssembly.RuntimeError) && !(error instanceof RangeError)) throw error;
      this.isStopped = true;
      const why = this.complaint !== "" ? `an error in the program: ${this.complaint}`
        : `memory ran out or the program is damaged (${error.message}; ${Math.round(this.memory / 2 ** 20)} MiB were in use)`;
      throw new Stopped(`the program had to stop: ${why}`);
    }
  }

  /** Address and length of a copy in the memory of the library. */
  private put(block: string | Uint8Array): [number, number] {
    const bytes = typeof block === "string" ? encoder.encode(block) : block;
    const address = this.library.allocate(bytes.length) >>> 0;
    if (address === 0) throw new Error(`there is no memory for ${bytes.length} bytes`);
    new Uint8Array(this.library.memory.buffer, address, bytes.length).set(bytes);
    return [address, bytes.length];
  }
}

function json<T>(bytes: Uint8Array): T {
  return JSON.parse(decoder.decode(bytes)) as T;
}
