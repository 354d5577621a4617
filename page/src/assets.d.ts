// What the build turns into bytes.
declare module "*.wat" {
  const bytes: Uint8Array;
  export default bytes;
}
