// Builds what pages carry: dist/program.js.gz (the page of `view`) with its hash and licences, and the programs of
// the reports, dist/pareto.js and dist/curves.js.
// `node build.mjs --check` compares with what is there instead.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { readFileSync, writeFileSync, mkdirSync } from "node:fs";
import { gunzipSync, gzipSync } from "node:zlib";
import { webAssembly } from "./wat.mjs";
import { workers } from "./workers.mjs";

const here = new URL(".", import.meta.url).pathname;
const bundle = async (entry, format) => {
  const out = await build({
    absWorkingDir: here,
    entryPoints: [entry],
    bundle: true,
    minify: true,
    format,
    target: "es2022",
    write: false,
    legalComments: "none",
    charset: "ascii",
    logLevel: "warning",
    plugins: [webAssembly, workers],
  });
  return out.outputFiles[0].contents;
};
const program = await bundle("src/main.ts", "esm");
const reports = await Promise.all(["pareto", "curves"].map(async (name) => [`${name}.js`, await bundle(`src/reports/${name}.ts`, "iife")]));
const sha256 = createHash("sha256").update(program).digest("hex");
const version = (name) => JSON.parse(readFileSync(`${here}node_modules/${name}/package.json`)).version;
const license = (name) => `${name} ${version(name)}\n\n${readFileSync(`${here}node_modules/${name}/LICENSE`, "utf8").trim()}\n`;
const licenses = ["three", "@sparkjsdev/spark"].map(license).join("\n----\n\n");

if (process.argv.includes("--check")) {
  const stored = gunzipSync(readFileSync(`${here}dist/program.js.gz`));
  const noted = readFileSync(`${here}dist/program.sha256`, "utf8").trim();
  const found = createHash("sha256").update(stored).digest("hex");
  if (found !== noted || found !== sha256) {
    console.error(`dist/program.js.gz is ${found}, noted ${noted}, its sources give ${sha256}: run npm run build`);
    process.exit(1);
  }
  const others = [...reports, ["LICENSES.txt", Buffer.from(licenses)]];
  const stale = others.filter(([name, bytes]) => !readFileSync(`${here}dist/${name}`).equals(Buffer.from(bytes)));
  if (stale.length > 0) {
    console.error(`dist/${stale.map(([name]) => name).join(", ")}: not what the sources give: run npm run build`);
    process.exit(1);
  }
  console.log(`the programs of the pages are those of their sources: ${sha256}`);
} else {
  mkdirSync(`${here}dist`, { recursive: true });
  writeFileSync(`${here}dist/program.js.gz`, gzipSync(program, { level: 9 }));
  writeFileSync(`${here}dist/program.sha256`, `${sha256}\n`);
  writeFileSync(`${here}dist/LICENSES.txt`, licenses);
  for (const [name, bytes] of reports) writeFileSync(`${here}dist/${name}`, bytes);
  console.log(`${program.length} bytes, sha256 ${sha256}; ${reports.map(([name, b]) => `${name} ${b.length}`).join(", ")}`);
}
