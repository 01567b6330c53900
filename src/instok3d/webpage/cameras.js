// Cameras: OpenCV axes (x right, y down, z forward); `rotation` has the camera's axes in the world
// as rows, so that a world point p is at rotation * (p - center) in the camera.

const add = (a, b, factor = 1) => a.map((value, k) => value + factor * b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const scaled = (a, factor) => a.map((value) => value * factor);
const unit = (a) => scaled(a, 1 / (Math.hypot(...a) || 1));
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];

/** A vector turned about a unit axis. */
function turned(vector, axis, angle) {
  const along = scaled(axis, dot(axis, vector) * (1 - Math.cos(angle)));
  const across = scaled(cross(axis, vector), Math.sin(angle));
  return add(add(scaled(vector, Math.cos(angle)), along), across);
}

/** A camera that a person moves about: it turns around a target at some distance ahead. */
class Viewpoint {
  constructor(up) {
    this.up = up;
    this.distance = 1;
  }

  /** Stand where an input view was taken. */
  stand(view, distance) {
    this.rotation = [view.rotation.slice(0, 3), view.rotation.slice(3, 6), view.rotation.slice(6, 9)];
    this.center = view.center.slice();
    this.lens = view.lens; // fx, fy, cx, cy over the height of the picture; cx from its middle
    this.distance = distance;
  }

  get target() {
    return add(this.center, this.rotation[2], this.distance);
  }

  /** Turn about the target: about the vertical, then about the camera's x axis. */
  orbit(yaw, pitch) {
    const target = this.target;
    let axes = this.rotation.map((axis) => turned(axis, this.up, yaw));
    const pitched = axes.map((axis) => turned(axis, axes[0], pitch));
    // Straight up and straight down are the ends of the way.
    if (Math.abs(dot(pitched[2], this.up)) < 0.995) axes = pitched;
    this.rotation = axes.map(unit);
    this.center = add(target, this.rotation[2], -this.distance);
  }

  /** Move the camera in its own plane; 1 is the height of the picture at the target. */
  pan(right, down) {
    const size = this.distance / this.lens[1];
    this.center = add(this.center, this.rotation[0], -right * size);
    this.center = add(this.center, this.rotation[1], -down * size);
  }

  /** Come nearer to the target by a factor. */
  approach(factor) {
    const target = this.target;
    this.distance *= factor;
    this.center = add(target, this.rotation[2], -this.distance);
  }

  /** Direction in the world of the ray through a pixel, and of one pixel to the right and down. */
  ray(x, y, width, height) {
    const [fx, fy, cx, cy] = this.pixels(width, height);
    const local = [(x - cx) / fx, (y - cy) / fy, 1];
    return [0, 1, 2].map((k) => dot(local, this.rotation.map((axis) => axis[k])));
  }

  /** Focal lengths and principal point for a picture of this size, pixels. */
  pixels(width, height) {
    const [fx, fy, cx, cy] = this.lens;
    return [fx * height, fy * height, width / 2 + cx * height, cy * height];
  }
}
