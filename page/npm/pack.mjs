// Makes the npm package: node npm/pack.mjs APP.html FOLDER, where APP.html is what `scenesplat app` wrote. FOLDER can be given to
// `npm pack` then.
import { build } from "esbuild";
import { execFileSync } from "node:child_process";
import { cpSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { resolve } from "node:path";
import { assets } from "../assets.mjs";
import { webAssembly } from "../wat.mjs";

const here = new URL(".", import.meta.url).pathname;
const page = new URL("..", import.meta.url).pathname;
const [app, out] = process.argv.slice(2).map((path) => resolve(path));
mkdirSync(out, { recursive: true });
const { program, weights, phrases, attribution } = assets(app);
for (const [name, bytes] of [["engine.wasm", program], ["weights.safetensors", weights], ["near.bin", phrases], ["ATTRIBUTION.md", attribution]]) {
  writeFileSync(`${out}/${name}`, bytes);
}
await build({
  absWorkingDir: page, entryPoints: ["src/app/package.ts"], outfile: `${out}/index.js`, bundle: true, format: "esm",
  target: "es2022", charset: "ascii", legalComments: "none", logLevel: "warning", plugins: [webAssembly],
});
// Types of the sources themselves, so that they cannot differ.
execFileSync("npx", ["--no-install", "tsc", "--declaration", "--emitDeclarationOnly", "--outDir", `${out}/types`], { cwd: page, stdio: "inherit" });
const version = /\nversion = "([^"]+)"/.exec(readFileSync(`${page}../Cargo.toml`, "utf8"))[1];
const about = JSON.parse(readFileSync(`${here}package.json`, "utf8"));
writeFileSync(`${out}/package.json`, `${JSON.stringify({ ...about, version }, null, 2)}\n`);
for (const name of ["README.md", "examples"]) cpSync(`${here}${name}`, `${out}/${name}`, { recursive: true });
for (const name of ["LICENSE-MIT", "LICENSE-APACHE"]) cpSync(`${page}../${name}`, `${out}/${name}`);
console.log(`${out}: ${about.name} ${version}`);
