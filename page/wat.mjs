// WebAssembly text becomes its bytes in a bundle.
import { readFile } from "node:fs/promises";
import wabt from "wabt";

export const webAssembly = {
  name: "wat",
  setup(build) {
    build.onLoad({ filter: /\.wat$/ }, async ({ path }) => {
      const module = (await wabt()).parseWat(path, await readFile(path, "utf8"), { simd: true });
      return { contents: module.toBinary({}).buffer, loader: "binary" };
    });
  },
};
