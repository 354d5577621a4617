// What the library needs in a browser, out of the page that `scenesplat app` wrote.
import { readFileSync } from "node:fs";
import { gunzipSync, inflateSync } from "node:zlib";

/** Program, weights, phrases and the list of whose work the weights were made from. */
export function assets(page) {
  const html = readFileSync(page, "latin1");
  const block = (name) => {
    const found = new RegExp(`<script type="text/plain" id="block-${name}">([^<]*)</script>`).exec(html);
    if (found === null) throw new Error(`${page}: carries no ${name}; is it what scenesplat app wrote?`);
    return Buffer.from(found[1], "base64");
  };
  return {
    program: gunzipSync(block("engine")),
    weights: inflateSync(block("weights")),
    phrases: inflateSync(block("phrases")),
    attribution: inflateSync(block("attribution")),
  };
}
