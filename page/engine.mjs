// Builds what `scenesplat app` carries: dist/engine.wasm.gz, the library for browsers (crates/browser), with its hash. Takes
// minutes, rustup's target wasm32-unknown-unknown, and clang for the zstd library.
// `node engine.mjs --check` only says whether the two are of each other.
import { execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { readFileSync, writeFileSync } from "node:fs";
import { homedir } from "node:os";
import { gunzipSync, gzipSync } from "node:zlib";

const here = new URL(".", import.meta.url).pathname;
const root = new URL("..", import.meta.url).pathname;
const sha256 = (bytes) => createHash("sha256").update(bytes).digest("hex");

if (process.argv.includes("--check")) {
  const found = sha256(gunzipSync(readFileSync(`${here}dist/engine.wasm.gz`)));
  const noted = readFileSync(`${here}dist/engine.sha256`, "utf8").trim();
  if (found !== noted) {
    console.error(`dist/engine.wasm.gz is ${found}, noted ${noted}: run npm run engine`);
    process.exit(1);
  }
  console.log(`the library of the page is the noted one: ${noted}`);
} else {
  // Messages of panics name files: not those of this computer. The flags come after those in .cargo/config.toml.
  const cargo = process.env.CARGO_HOME ?? `${homedir()}/.cargo`;
  const renamed = [`--remap-path-prefix=${cargo}/registry/src=crates`, `--remap-path-prefix=${root}=`].join(" ");
  const env = { CARGO_INCREMENTAL: "0", ...process.env, CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS: renamed };
  const target = ["wasm32-unknown-unknown", "browser"];
  execFileSync("cargo", ["build", "--locked", "--profile", target[1], "--target", target[0], "-p", "scenesplat-browser"],
    { cwd: root, env, stdio: "inherit" });
  const folder = process.env.CARGO_TARGET_DIR ?? `${root}target`;
  const wasm = readFileSync(`${folder}/${target.join("/")}/scenesplat_browser.wasm`);
  const packed = gzipSync(wasm, { level: 9 });
  writeFileSync(`${here}dist/engine.wasm.gz`, packed);
  writeFileSync(`${here}dist/engine.sha256`, `${sha256(wasm)}\n`);
  console.log(`${wasm.length} bytes, gzipped ${packed.length}, sha256 ${sha256(wasm)}`);
}
