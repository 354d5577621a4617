// Labels a scene beside the page: posts { stage, share }, and at the end positions, labels and classes.
import { Scenesplat } from "../index.js";

const loaded = Scenesplat.load();

addEventListener("message", async ({ data: { name, bytes } }) => {
  try {
    const splat = await loaded;
    splat.onProgress = (stage, share) => postMessage({ stage, share });
    splat.parse(bytes, name);
    const { classes } = splat.segment();
    postMessage({ classes, labels: splat.values("labels"), positions: splat.values("positions") });
  } catch (error) {
    postMessage({ error: error.message });
  }
});
