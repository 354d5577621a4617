// x · Φ(x), with the tail of the normal law as the CPU's kernel fits it.
fn gelu(v: f32) -> f32 {
  let m = min(abs(v), 14.5);
  let t = 1.0 / (1.0 + 0.33 * m);
  var q = -0.020442365;
  q = q * t + 0.121348195;
  q = q * t - 0.2637096;
  q = q * t + 0.22078338;
  q = q * t - 0.05396884;
  q = q * t + 0.12077658;
  q = q * t + 0.11131944;
  q = q * t + 0.13226923;
  q = q * t + 0.131624;
  q = q * t;
  let tail = q * exp(-0.5 * m * m);
  return v * select(tail, 1.0 - tail, v > 0.0);
}
