// An orbit camera: OpenCV axes (right, down, forward), pixels with centres at +0.5.

const LIMIT = Math.PI / 2 - 0.01;
const mix = (vectors, weights) => [0, 1, 2].map((i) => vectors.reduce((sum, v, k) => sum + v[i] * weights[k], 0));
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((v) => v / Math.hypot(...a));

class OrbitCamera {
  constructor(first) {
    this.first = first;
    this.reset();
  }

  reset() {
    Object.assign(this, { center: [...this.first.center], azimuth: this.first.azimuth, elevation: this.first.elevation, distance: this.first.distance });
  }

  turn(right, up) {
    this.azimuth -= right;
    this.elevation = Math.max(-LIMIT, Math.min(LIMIT, this.elevation + up));
  }

  zoom(factor) {
    const { distance } = this.first;
    this.distance = Math.max(distance * 0.05, Math.min(distance * 20, this.distance * factor));
  }

  // A shift by pixels at the depth of the center.
  shift(dx, dy, height) {
    const { rows, focal } = this.view(height, height);
    const scale = this.distance / focal;
    this.center = mix([this.center, rows[0], rows[1]], [1, -dx * scale, -dy * scale]);
  }

  // The picture at ``width`` × ``height``, with the object in what ``below`` pixels leave free.
  view(width, height, below = 0) {
    const { right, up, back, fov } = this.first;
    const level = Math.cos(this.elevation);
    const out = mix([back, right, up], [level * Math.cos(this.azimuth), level * Math.sin(this.azimuth), Math.sin(this.elevation)]);
    const forward = out.map((v) => -v);
    const x = unit(cross(forward, up));
    const rows = [x, cross(forward, x), forward];
    const eye = mix([this.center, out], [1, this.distance]);
    return { rows, eye, near: this.first.near, shift: rows.map((row) => -dot(row, eye)), focal: Math.min(width, height - below) / 2 / Math.tan(fov / 2), middle: [width / 2, (height - below) / 2], width, height };
  }
}

// The view of what stands at s R x + t, as one of what stands at x: a similarity of the world is a
// move of the camera. Its matrix (3 × 4) is a polynomial in time.
function movedView(view, frame, t) {
  if (!frame) return view;
  const weights = knotWeights(frame.knots, t);
  // Its columns: where the axes go, and the shift.
  const [x, y, z, shift] = [0, 1, 2, 3].map((i) => [0, 1, 2].map((line) => weights.reduce((sum, w, k) => sum + w * frame.rows[k][line][i], 0)));
  const axes = [x, y, z];
  const scale = Math.cbrt(dot(x, cross(y, z)));
  const rows = view.rows.map((row) => axes.map((axis) => dot(row, axis) / scale));
  return {
    ...view, rows, near: view.near / scale,
    shift: view.rows.map((row, i) => (dot(row, shift) + view.shift[i]) / scale),
    eye: axes.map((axis) => dot(axis, mix([view.eye, shift], [1, -1])) / (scale * scale)),
  };
}

function project(view, point) {
  const [x, y, z] = view.rows.map((row, i) => dot(row, point) + view.shift[i]);
  return [view.focal * x / z + view.middle[0], view.focal * y / z + view.middle[1], z];
}
