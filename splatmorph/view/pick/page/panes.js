// The two panes: a splat by WebGL, a splat by the server's pictures, or a picture.

const FOV = Math.PI / 6;
const MARGIN = 1.05;
const SETTLE = 180; // ms after the last move until a picture is drawn in full
const SLOW_FRAME = 60, FAST_FRAME = 30; // ms between two pictures in motion
const LONGEST_FRAME = 500;
const FEWEST_DRAWN = 6000;

// Where a splat is looked at from: its bounds, upright by ``up``.
function firstCamera(side, up) {
  return { ...side.ups[up], center: side.center, azimuth: 0, elevation: 0, fov: FOV, distance: MARGIN * side.radius / Math.sin(FOV / 2), near: 0.002 * side.radius };
}

// The camera of a picture: pixels a unit of the plane, and what is in the middle.
class PlaneCamera {
  constructor(side) {
    this.side = side;
    this.reset();
  }

  reset() {
    Object.assign(this, { scale: 1, center: [0, 0] });
  }

  turn(right, up) {
    this.shift(right / TURN, up / TURN, this.height);
  }

  zoom(factor) {
    this.scale = Math.max(0.2, Math.min(60, this.scale / factor));
  }

  shift(dx, dy) {
    this.center = [this.center[0] - dx / this.focal, this.center[1] + dy / this.focal];
  }

  view(width, height) {
    const [halfWidth, halfHeight] = this.side.half;
    this.height = height;
    this.focal = 0.94 * Math.min(width / halfWidth, height / halfHeight) / 2 * this.scale;
    const middle = [width / 2 - this.focal * this.center[0], height / 2 + this.focal * this.center[1]];
    return { rows: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], shift: [0, 0, 1], focal: this.focal, middle, width, height };
  }
}

// What every pane does; ``paint(ratio, moving)`` is its own.
class Pane {
  constructor(root, number) {
    Object.assign(this, { root, number, stage: root.querySelector(".stage"), svg: root.querySelector(".marks"), moved: 0, coarse: 1, took: 0, last: 0, seen: 0, pending: false, drawn: () => {}, rested: () => {} });
  }

  get size() {
    return [Math.max(1, this.stage.clientWidth), Math.max(1, this.stage.clientHeight)];
  }

  // In CSS pixels, as marks and clicks are.
  view() {
    return this.camera.view(...this.size);
  }

  project(point) {
    return project(this.view(), point);
  }

  changed() {
    this.moved = performance.now();
    this.root.dataset.drawn = "moving";
    this.queue();
  }

  queue() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => this.frame(performance.now()));
  }

  async frame(now) {
    // However late this picture comes, it is one of a motion that went on since the one before.
    const moving = this.moved > this.seen || now - this.moved < Math.max(SETTLE, 2.5 * this.took);
    // From picture to picture: what this process waits for is not what it draws.
    if (moving && this.last) this.took = Math.min(now - this.last, LONGEST_FRAME);
    await this.paint(moving, this.last ? this.took : 0);
    this.last = moving ? now : 0;
    this.seen = now;
    this.pending = false;
    this.drawn();
    if (moving || this.moved > now) return this.queue();
    this.root.dataset.drawn = "still";
    this.rested();
  }

  canvas() {
    return this.stage.appendChild(document.createElement("canvas"));
  }
}

// A splat alone with those of its splats first that cover most: the first few are a picture of it.
function ranked(scene) {
  const grain = (scene.sizeRange[1] - scene.sizeRange[0]) / 2047;
  const covers = Float32Array.from({ length: scene.count }, (_, i) => {
    // The two larger of the three sizes, by their logarithms; the third counts in wider steps.
    const sizes = [scene.sizes[3 * i], scene.sizes[3 * i + 1], scene.sizes[3 * i + 2] * 2047 / 1023];
    return scene.colours[4 * i + 3] ** 2 * Math.exp(grain * (sizes[0] + sizes[1] + sizes[2] - Math.min(...sizes)));
  });
  const order = Uint32Array.from(covers.keys()).sort((a, b) => covers[b] - covers[a]);
  for (const name of ["centers", "colours", "rotations", "sizes", "shades"]) {
    const old = scene[name], columns = old.length / scene.count;
    if (columns) scene[name] = old.map((_, at) => old[columns * order[Math.floor(at / columns)] + at % columns]);
  }
  return scene;
}

class SplatPane extends Pane {
  constructor(root, number, side, scene) {
    super(root, number);
    this.side = side;
    this.most = scene.count;
    this.up = side.up;
    this.camera = new OrbitCamera(firstCamera(side, side.up));
    this.painter = new SplatPainter(this.canvas(), ranked(scene));
    this.few = scene.count;
    this.between = null; // the painter of a morph, and its canvas over the other
    this.t = 1;
  }

  // The morph of a leg, to be shown while t < 1; null for none.
  async takeMorph(leg) {
    const scene = leg === null ? null : await fetchScene("/morph", { leg });
    if (scene) this.over ??= this.canvas();
    this.between = scene && new SplatPainter(this.over, scene);
    this.changed();
  }

  async paint(moving, took) {
    const { painter, between } = this;
    const plays = between && this.t < 1;
    if (moving && took) this.adapt(took);
    const ratio = Math.min(devicePixelRatio, 2) * (moving ? this.coarse : 1);
    const used = plays ? between : painter;
    painter.canvas.hidden = Boolean(plays);
    if (this.over) this.over.hidden = !plays;
    const [width, height] = this.size.map((side) => Math.max(1, Math.round(side * ratio)));
    if (used.canvas.width !== width || used.canvas.height !== height) Object.assign(used.canvas, { width, height });
    used.draw(this.camera.view(width, height), { t: plays ? this.t : 0, ramp: 0, part: "morph", few: plays || !moving ? undefined : this.few });
  }

  // Pictures in motion give up splats, then pixels, where the device is slow.
  adapt(took) {
    if (took > SLOW_FRAME) {
      this.few = Math.max(FEWEST_DRAWN, this.few * Math.max(0.35, SLOW_FRAME / took));
      this.coarse = Math.max(0.35, this.coarse * Math.max(0.6, Math.sqrt(SLOW_FRAME / took)));
    } else if (took < FAST_FRAME) {
      this.few = Math.min(this.most, this.few * 1.1);
      this.coarse = Math.min(1, this.coarse * 1.05);
    }
  }
}

// Without WebGL: what the rasterizer draws, one picture at a time.
class PhotoPane extends Pane {
  constructor(root, number, side) {
    super(root, number);
    Object.assign(this, { side, up: side.up, t: 1, between: null });
    this.camera = new OrbitCamera(firstCamera(side, side.up));
    this.pen = this.canvas().getContext("2d");
  }

  async takeMorph(leg) {
    this.between = leg;
    this.changed();
  }

  async paint(moving) {
    const [width, height] = this.size;
    const view = this.camera.view(width, height);
    const shrink = moving ? 0.5 : 1;
    const small = { ...view, width: Math.round(width * shrink), height: Math.round(height * shrink), focal: view.focal * shrink, middle: view.middle.map((v) => v * shrink) };
    const plays = this.between !== null && this.t < 1;
    const query = { c: JSON.stringify(small) };
    try {
      const image = await (plays ? fetchImage("/morph", { ...query, leg: this.between, t: this.t }) : fetchImage("/view", { ...query, s: this.index }));
      Object.assign(this.pen.canvas, { width: image.width, height: image.height });
      this.pen.drawImage(image, 0, 0);
    } catch (error) {
      console.warn(error.message);
    }
  }
}

class PicturePane extends Pane {
  constructor(root, number, side, image) {
    super(root, number);
    Object.assign(this, { side, image, t: 1, between: null, shown: null });
    this.camera = new PlaneCamera(side);
    this.pen = this.canvas().getContext("2d");
  }

  project([x, y]) {
    const { focal, middle } = this.view();
    return [middle[0] + focal * x, middle[1] - focal * y, 1];
  }

  async takeMorph(leg) {
    this.between = leg;
    this.shown = null;
    this.changed();
  }

  async paint() {
    const ratio = Math.min(devicePixelRatio, 2);
    const [width, height] = this.size.map((side) => Math.round(side * ratio));
    const plays = this.between !== null && this.t < 1;
    if (plays && this.shown?.t !== this.t) {
      const t = this.t;
      try {
        this.shown = { t, image: await fetchImage("/morph", { leg: this.between, t }) };
      } catch (error) {
        console.warn(error.message);
      }
    }
    const image = plays && this.shown ? this.shown.image : this.image;
    Object.assign(this.pen.canvas, { width, height });
    const { focal, middle } = this.camera.view(width, height);
    const [halfWidth, halfHeight] = this.side.half;
    this.pen.imageSmoothingEnabled = focal * 2 * halfWidth < 6 * this.side.width;
    this.pen.drawImage(image, middle[0] - focal * halfWidth, middle[1] - focal * halfHeight, 2 * focal * halfWidth, 2 * focal * halfHeight);
  }
}

// Whether this browser draws splats itself.
function hasWebGL() {
  if (new URLSearchParams(location.search).has("pictures")) return false;
  return Boolean(document.createElement("canvas").getContext("webgl2"));
}

async function makePane(number, index, side) {
  const root = $(`pane${number}`);
  root.querySelector(".stage").replaceChildren();
  const pane = await (async () => {
    if (side.kind === "picture") return new PicturePane(root, number, side, await fetchImage("/side", { s: index }));
    if (hasWebGL()) return new SplatPane(root, number, side, await fetchScene("/side", { s: index }));
    return new PhotoPane(root, number, side);
  })();
  pane.index = index;
  const title = root.querySelector("h2");
  title.replaceChildren(`${"AB"[number]}  `, side.name);
  if (side.shown < side.count) title.append(Object.assign(document.createElement("small"), { textContent: `  ${side.shown.toLocaleString()} of ${side.count.toLocaleString()} splats shown` }));
  return pane;
}
