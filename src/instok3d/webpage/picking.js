// Which object a pixel shows: the Gaussians composited along its ray, as the picture is.

const ALPHA_MIN = 1 / 255, ALPHA_MAX = 0.99, EPS2D = 0.3, TRANSMITTANCE_MIN = 1e-4;

/** Index of the object (0: none) with the largest share of pixel x, y. */
function pick(scene, state, viewpoint, x, y, width, height) {
  const { means, covariances, opacities, objects } = scene;
  const [fx, fy, cx, cy] = viewpoint.pixels(width, height);
  const [right, down, forward] = viewpoint.rotation;
  const near = (slope, middle, focal, size) =>
    Math.max(-middle / focal - (0.15 * size) / focal, Math.min((size - middle + 0.15 * size) / focal, slope));
  const hits = [];
  for (let k = 0; k < objects.length; k++) {
    const object = objects[k];
    if (state.hidden[object]) continue;
    const offset = state.offsets[object];
    const p = [0, 1, 2].map((a) => means[3 * k + a] + offset[a] - viewpoint.center[a]);
    const z = dot(forward, p);
    if (z < scene.near || z > scene.far) continue;
    const u = dot(right, p) / z, v = dot(down, p) / z;
    const dx = u * fx + cx - x, dy = v * fy + cy - y;
    const c = covariances.subarray(6 * k, 6 * k + 6);
    // As in drawing.js: the slope at which the covariance is projected stays near the picture.
    const a = add(scaled(right, fx / z), forward, (-fx / z) * near(u, cx, fx, width));
    const b = add(scaled(down, fy / z), forward, (-fy / z) * near(v, cy, fy, height));
    const times = (r) => [
      c[0] * r[0] + c[1] * r[1] + c[2] * r[2],
      c[1] * r[0] + c[3] * r[1] + c[4] * r[2],
      c[2] * r[0] + c[4] * r[1] + c[5] * r[2],
    ];
    const xx = dot(a, times(a)) + EPS2D, xy = dot(a, times(b)), yy = dot(b, times(b)) + EPS2D;
    const determinant = xx * yy - xy * xy;
    const sigma = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (2 * determinant);
    const alpha = Math.min(ALPHA_MAX, opacities[k] * Math.exp(-sigma));
    if (alpha >= ALPHA_MIN && sigma >= 0) hits.push({ z, alpha, object });
  }
  hits.sort((first, second) => first.z - second.z);
  const shares = new Float64Array(state.hidden.length);
  let transmittance = 1;
  for (const { alpha, object } of hits) {
    shares[object] += alpha * transmittance;
    transmittance *= 1 - alpha;
    if (transmittance <= TRANSMITTANCE_MIN) break;
  }
  let best = 0;
  for (let k = 1; k < shares.length; k++) if (shares[k] > shares[best]) best = k;
  return best;
}
