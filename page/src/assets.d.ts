// What the build turns into bytes and texts.
declare module "*.wat" {
  const bytes: Uint8Array;
  export default bytes;
}
/** A program of its own, bundled, for a worker. */
declare module "worker:*" {
  const text: string;
  export default text;
}
