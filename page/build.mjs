// Builds the program of the page: dist/program.js.gz, with its hash and licences beside it.
// `node build.mjs --check` compares with what is there instead.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { readFileSync, writeFileSync, mkdirSync } from "node:fs";
import { gunzipSync, gzipSync } from "node:zlib";

const here = new URL(".", import.meta.url).pathname;
const out = await build({
  absWorkingDir: here,
  entryPoints: ["src/main.ts"],
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  write: false,
  legalComments: "none",
  charset: "ascii",
  logLevel: "warning",
});
const program = out.outputFiles[0].contents;
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
  if (readFileSync(`${here}dist/LICENSES.txt`, "utf8") !== licenses) {
    console.error("dist/LICENSES.txt is not that of the packages: run npm run build");
    process.exit(1);
  }
  console.log(`the program of the page is that of its sources: ${sha256}`);
} else {
  mkdirSync(`${here}dist`, { recursive: true });
  writeFileSync(`${here}dist/program.js.gz`, gzipSync(program, { level: 9 }));
  writeFileSync(`${here}dist/program.sha256`, `${sha256}\n`);
  writeFileSync(`${here}dist/LICENSES.txt`, licenses);
  console.log(`${program.length} bytes, sha256 ${sha256}`);
}
