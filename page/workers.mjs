// `worker:FILE` becomes the text of a program of its own, bundled.
import { build } from "esbuild";
import { resolve } from "node:path";

export const workers = {
  name: "worker",
  setup(own) {
    own.onResolve({ filter: /^worker:/ }, ({ path, resolveDir }) => ({
      path: resolve(resolveDir, path.slice("worker:".length)), namespace: "worker",
    }));
    own.onLoad({ filter: /.*/, namespace: "worker" }, async ({ path }) => {
      const out = await build({
        entryPoints: [path], bundle: true, minify: true, format: "iife", target: "es2022", write: false,
        legalComments: "none", charset: "ascii", logLevel: "warning",
      });
      return { contents: out.outputFiles[0].text, loader: "text" };
    });
  },
};
