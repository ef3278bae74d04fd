// The player: what is shown, how it goes on in time, and the loop that draws it.

const ROUND_TRIP = 6000; // ms from a splat to the next and back, at speed 1
const REST = 700; // ms a playing morph dwells at a splat
const FULL_TURN = 12000; // ms a round, at speed 1
const SLOW = 45; // ms a frame, above which moving pictures are drawn coarser

// t at a phase in [0, 1) of the way from 0 to ``last`` and back, slow at every splat, resting there.
function timeAt(phase, last) {
  const way = (phase < 0.5 ? 2 * phase : 2 - 2 * phase) * last;
  const leg = Math.min(Math.floor(way), last - 1);
  const pause = REST / ROUND_TRIP;
  const s = Math.max(0, Math.min(1, (way - leg - pause) / (1 - 2 * pause)));
  return leg + s * s * (3 - 2 * s);
}

function phaseAt(t, last) {
  let [low, high] = [0, 0.5];
  for (let i = 0; i < 30; i++) {
    const middle = (low + high) / 2;
    if (timeAt(middle, last) < t) low = middle;
    else high = middle;
  }
  return high;
}

class Player {
  // ``shown`` is told of every change, ``drawn`` of every picture: whether it is at rest.
  constructor(scene, painter, overlay, camera, { ground, shown, drawn, covered }) {
    Object.assign(this, { scene, painter, overlay, camera, shown, drawn, covered, ground });
    this.state = { t: 0, ramp: Math.max(0, scene.rampNames.indexOf(scene.ramp)), part: "morph", marks: false, loop: true, playing: false, spin: false, speed: 1, ground };
    this.pace = { phase: 0, last: 0, coarse: 1, took: 0, moved: 0, queued: false };
  }

  set(values) {
    const { state, pace, scene } = this;
    Object.assign(state, values);
    state.t = Math.max(0, Math.min(scene.last, state.t));
    if (!scene.last) state.playing = false;
    else if ("t" in values) pace.phase = phaseAt(state.t, scene.last);
    if (values.playing) pace.phase = state.t >= scene.last - 0.001 && !state.loop ? 0 : phaseAt(state.t, scene.last);
    this.shown(state);
    this.changed();
  }

  changed() {
    this.pace.moved = performance.now();
    document.documentElement.dataset.drawn = "moving";
    this.queue();
  }

  queue() {
    if (this.pace.queued) return;
    this.pace.queued = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  advance(now) {
    const { state, pace, scene } = this;
    const passed = Math.min(now - (pace.last || now), 200) * state.speed;
    if (state.spin) this.camera.turn(-2 * Math.PI * passed / FULL_TURN, 0);
    if (!state.playing) return;
    pace.phase += passed / (ROUND_TRIP * scene.last);
    if (!state.loop && pace.phase >= 0.5) {
      pace.phase = 0.5;
      this.set({ t: scene.last, playing: false });
    }
    pace.phase %= 1;
    state.t = timeAt(pace.phase, scene.last);
  }

  // A picture in motion gives up pixels where the device is slow; at rest it is drawn in full.
  ratio(now, moving) {
    const { pace } = this;
    if (moving && pace.last) {
      pace.took = Math.min(now - pace.last, 500);
      if (pace.took > SLOW) pace.coarse = Math.max(0.35, pace.coarse * Math.max(0.6, Math.sqrt(SLOW / pace.took)));
      else if (pace.took < SLOW / 2) pace.coarse = Math.min(1, pace.coarse * 1.05);
    }
    return Math.min(devicePixelRatio, 2) * (moving ? pace.coarse : 1);
  }

  frame(now) {
    const { pace, state } = this;
    pace.queued = false;
    // A slow device gets a few coarse pictures before it is taken to be at rest.
    const moving = state.playing || state.spin || now - pace.moved < Math.max(160, 2.5 * pace.took);
    this.advance(now);
    this.draw(this.ratio(now, moving));
    pace.last = moving ? now : 0;
    document.documentElement.dataset.drawn = moving ? "moving" : "still";
    this.drawn(!moving);
    if (moving) this.queue();
  }

  // One picture at ``ratio`` device pixels a CSS pixel.
  draw(ratio) {
    const { painter: { canvas }, camera, state } = this;
    const below = this.covered();
    const full = Math.min(devicePixelRatio, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.painter.draw(camera.view(width, height, below * ratio), state);
    this.overlay.draw(camera.view(canvas.clientWidth * full, canvas.clientHeight * full, below * full), full, state);
  }

  // What a rasterizer needs to draw the same picture.
  view() {
    const { canvas } = this.painter;
    return this.camera.view(canvas.width, canvas.height, this.covered() * canvas.width / canvas.clientWidth);
  }
}
