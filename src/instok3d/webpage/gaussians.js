// The scene's Gaussians, unpacked from what packing.py wrote.

/** Bytes of base64 text. */
function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  return bytes;
}

/** The float16 numbers of a Uint16Array as float32. */
function floatsOfHalves(halves) {
  const floats = new Float32Array(halves.length);
  for (let k = 0; k < halves.length; k++) {
    const sign = halves[k] >> 15 ? -1 : 1;
    const exponent = (halves[k] >> 10) & 31;
    const fraction = halves[k] & 1023;
    floats[k] = exponent
      ? sign * 2 ** (exponent - 15) * (1 + fraction / 1024)
      : sign * 2 ** -14 * (fraction / 1024);
  }
  return floats;
}

/**
 * Typed arrays by name, as `scene.layout` lists them: {name, type, length, scale}. Bytes and shorts
 * are multiples of `scale`.
 */
function unpack(layout, base64) {
  const { buffer } = bytesOf(base64);
  const arrays = {};
  let offset = 0;
  for (const { name, type, length, scale } of layout) {
    if (type === "float32") {
      arrays[name] = new Float32Array(buffer, offset, length);
    } else if (type === "float16") {
      arrays[name] = floatsOfHalves(new Uint16Array(buffer, offset, length));
    } else {
      const kind = { int16: Int16Array, int8: Int8Array }[type];
      arrays[name] = Float32Array.from(new kind(buffer, offset, length), (value) => value * scale);
    }
    const size = { float32: 4, float16: 2, int16: 2, int8: 1 }[type];
    offset += Math.ceil((length * size) / 4) * 4;
  }
  return arrays;
}

/** Covariances xx, xy, xz, yy, yz, zz of all Gaussians from scales and quaternions wxyz. */
function covariances(scales, quats) {
  const count = scales.length / 3;
  const result = new Float32Array(6 * count);
  for (let k = 0; k < count; k++) {
    let [w, x, y, z] = quats.subarray(4 * k, 4 * k + 4);
    const norm = Math.hypot(w, x, y, z) || 1;
    w /= norm; x /= norm; y /= norm; z /= norm;
    const rotation = [
      1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ];
    const axes = rotation.map((value, place) => value * scales[3 * k + (place % 3)]);
    const dot = (a, b) =>
      axes[3 * a] * axes[3 * b] + axes[3 * a + 1] * axes[3 * b + 1] + axes[3 * a + 2] * axes[3 * b + 2];
    result.set([dot(0, 0), dot(0, 1), dot(0, 2), dot(1, 1), dot(1, 2), dot(2, 2)], 6 * k);
  }
  return result;
}
