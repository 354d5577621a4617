// The npm package: a scene's bytes in, labels, objects, answers and files out. Runs in node, in workers and in pages, where it
// holds up everything else while it works: a worker is the place for it.

import { readAbout, readScene, type SceneData } from "../data";
import { PhraseBook } from "../phrases";
import { answer, foundObjects, selection } from "../query";
import { Engine, type Assets, type FileFormat, type ListName, type Parsed, type Segmented, type Tell } from "./engine";

export { Stopped } from "./engine";
export type { Assets, FileFormat, FoundObject, ListName, Parsed, Segmented, StageName, Tell } from "./engine";

/** The files of the package; `program` is the WebAssembly itself. */
export type Files = Assets & { program: BufferSource };

/** What a phrase means in a scene. */
export interface Answer {
  /** How the phrase was understood. */
  how: string;
  /** 1 for each Gaussian that is meant. [N] */
  selected: Uint8Array;
  /** How many they are. */
  count: number;
  /** Numbers (`id`) of the objects that are meant, the most of them first. */
  objects: number[];
}

const NAMES = { program: "engine.wasm", weights: "weights.safetensors", phrases: "near.bin" };

/** Reads the files of the package from beside it. */
async function files(): Promise<Files> {
  const read = async (name: string): Promise<Uint8Array<ArrayBuffer>> => {
    const url = new URL(name, import.meta.url);
    if (url.protocol === "file:") {
      // Not to be bundled for browsers, which have no such module.
      const module = "node:fs/promises";
      const { readFile } = await import(/* @vite-ignore */ module) as { readFile: (url: URL) => Promise<Uint8Array<ArrayBuffer>> };
      return readFile(url);
    }
    const response = await fetch(url);
    if (!response.ok) throw new Error(`${url.href}: ${response.status} ${response.statusText}`);
    return new Uint8Array(await response.arrayBuffer());
  };
  const [program, weights, phrases] = await Promise.all(Object.values(NAMES).map(read));
  return { program, weights, phrases };
}

export class Scenesplat {
  private data: Promise<SceneData> | null = null;

  private constructor(private engine: Engine) {}

  /** Loads the network; `given`: the files of the package, where they are not beside it. */
  static async load(given?: Files): Promise<Scenesplat> {
    const { program, weights, phrases } = given ?? await files();
    return new Scenesplat(await Engine.start(program, { weights, phrases }));
  }

  /** Is told how far the work has come. */
  set onProgress(tell: Tell) {
    this.engine.tell = tell;
  }

  /** Reads a scene from the bytes of a file of any format; the last one is forgotten. `name` is for messages. */
  parse(bytes: Uint8Array, name: string): Parsed {
    this.data = null;
    return this.engine.parse(bytes, name);
  }

  /** Labels the scene and finds its objects. */
  segment(): Segmented {
    this.data = null;
    return this.engine.segment();
  }

  /** One value or row a Gaussian of the labeled scene. */
  values(name: ListName): Float32Array | Int32Array {
    return this.engine.values(name);
  }

  /** What a phrase ("red chair", "lamp on the desk") means in the labeled scene. */
  async query(phrase: string): Promise<Answer> {
    this.data ??= this.open();
    const data = await this.data;
    const found = answer(data, new PhraseBook(data), phrase.slice(0, 500));
    const { count: shown, total } = data.about;
    const there = found.isUnknown && found.objects === null ? new Uint8Array(shown) : selection(found, found.threshold, true);
    const { count, objects } = foundObjects(data, there);
    const selected = new Uint8Array(total);
    for (let i = 0; i < shown; i++) selected[data.rows.length > 0 ? data.rows[i] : i] = there[i];
    return { how: found.how, selected, count, objects: objects.map((o) => data.about.objects[o.object].id) };
  }

  /** The scene as a file of another format, with labels if it was labeled; without the Gaussians whose `keep` is 0. */
  convert(format: FileFormat, keep?: Uint8Array): Uint8Array {
    return this.engine.write(format, keep);
  }

  private async open(): Promise<SceneData> {
    const parts = this.engine.page("scene");
    return readScene(await readAbout(parts), () => undefined, parts);
  }
}
