// The page: what is shown, the controls that change it, and the loop that draws it.

const $ = (id) => document.getElementById(id);
const ROUND_TRIP = 6000; // ms from source to target and back
const REST = 700; // ms a playing morph dwells at either end
const SLOW = 45; // ms a frame, above which moving pictures are drawn coarser
const GROUNDS = ["#15161a", "#7b7c80", "#f2f1ee"];

function timeAt(phase) {
  // 0 → 1 → 0 over one round trip, slow at the ends, resting there.
  const folded = phase < 0.5 ? 2 * phase : 2 - 2 * phase;
  const pause = REST / ROUND_TRIP;
  const s = Math.max(0, Math.min(1, (folded - pause) / (1 - 2 * pause)));
  return s * s * (3 - 2 * s);
}

function phaseAt(t) {
  let [low, high] = [0, 0.5];
  for (let i = 0; i < 30; i++) {
    const middle = (low + high) / 2;
    if (timeAt(middle) < t) low = middle;
    else high = middle;
  }
  return high;
}

function describe(scene) {
  $("source-name").textContent = scene.source.name;
  $("target-name").textContent = scene.target.name;
  $("facts").textContent = scene.facts;
  $("about").textContent = scene.about;
  scene.rampNames.forEach((name) => $("ramp").add(new Option(name, name)));
  $("marks").hidden = !scene.landmarks.names.length;
  $("loop").disabled = $("play").disabled = false;
}

function start(scene) {
  const camera = new OrbitCamera(scene.camera);
  const painter = new SplatPainter($("splats"), scene);
  const overlay = new LandmarkOverlay($("overlay"), $("tip"), scene);
  const grounds = scene.background ? [scene.background, ...GROUNDS] : GROUNDS;
  const state = { t: 0, ramp: Math.max(0, scene.rampNames.indexOf(scene.ramp)), part: "morph", marks: false, loop: true, playing: false, ground: 0 };
  const pace = { phase: 0, last: 0, coarse: 1, took: 0, moved: 0, queued: false };

  const changed = () => {
    pace.moved = performance.now();
    document.documentElement.dataset.drawn = "moving";
    queue();
  };
  const queue = () => {
    if (pace.queued) return;
    pace.queued = true;
    requestAnimationFrame(frame);
  };

  function set(values) {
    Object.assign(state, values);
    state.t = Math.max(0, Math.min(1, state.t));
    if ("t" in values) pace.phase = phaseAt(state.t);
    if (values.playing) pace.phase = state.t >= 0.999 && !state.loop ? 0 : phaseAt(state.t);
    document.body.classList.toggle("playing", state.playing);
    $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
    $("ramp").value = scene.rampNames[state.ramp];
    $("marks").setAttribute("aria-pressed", state.marks);
    $("loop").setAttribute("aria-pressed", state.loop);
    document.querySelector(`input[name=part][value=${state.part}]`).checked = true;
    const ground = grounds[state.ground % grounds.length];
    document.documentElement.style.setProperty("--ground", ground);
    document.body.classList.toggle("light-ground", luminance(ground) > 0.4);
    changed();
  }

  function advance(now) {
    if (!state.playing) return;
    pace.phase += Math.min(now - pace.last, 200) / ROUND_TRIP;
    if (!state.loop && pace.phase >= 0.5) {
      pace.phase = 0.5;
      set({ playing: false });
    }
    pace.phase %= 1;
    state.t = timeAt(pace.phase);
  }

  // A picture in motion gives up pixels where the device is slow; at rest it is drawn in full.
  function ratio(now, moving) {
    if (moving && pace.last) {
      pace.took = Math.min(now - pace.last, 500);
      if (pace.took > SLOW) pace.coarse = Math.max(0.35, pace.coarse * Math.max(0.6, Math.sqrt(SLOW / pace.took)));
      else if (pace.took < SLOW / 2) pace.coarse = Math.min(1, pace.coarse * 1.05);
    }
    return Math.min(devicePixelRatio, 2) * (moving ? pace.coarse : 1);
  }

  function frame(now) {
    pace.queued = false;
    // A slow device gets a few coarse pictures before it is taken to be at rest.
    const moving = state.playing || now - pace.moved < Math.max(160, 2.5 * pace.took);
    advance(now);
    const scale = ratio(now, moving);
    pace.last = moving ? now : 0;
    const { canvas } = painter;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * scale)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const below = covered();
    painter.draw(camera.view(width, height, below * scale), state);
    const full = Math.min(devicePixelRatio, 2);
    overlay.draw(camera.view(canvas.clientWidth * full, canvas.clientHeight * full, below * full), full, state);
    $("time").value = state.t;
    $("reading").textContent = state.t.toFixed(2);
    document.documentElement.dataset.drawn = moving ? "moving" : "still";
    if (moving) queue();
  }

  // CSS pixels that the controls take from the bottom of the picture.
  function covered() {
    return document.body.classList.contains("bare") ? 0 : innerHeight - $("controls").getBoundingClientRect().top;
  }

  function readAddress() {
    const given = new URLSearchParams(location.hash.slice(1));
    const radians = (key) => Number(given.get(key)) * Math.PI / 180;
    camera.reset();
    if (given.has("azimuth")) camera.azimuth = radians("azimuth");
    if (given.has("elevation")) camera.elevation = radians("elevation");
    if (given.has("zoom")) camera.distance /= Math.max(0.05, Number(given.get("zoom")) || 1);
    document.body.classList.toggle("bare", given.get("controls") === "0");
    const ramp = scene.rampNames.indexOf(given.get("ramp"));
    const part = ["source", "morph", "target"].find((name) => name === given.get("part"));
    set({
      t: Number(given.get("t")) || 0,
      ramp: ramp < 0 ? state.ramp : ramp,
      part: part ?? "morph",
      marks: given.get("landmarks") === "1",
      playing: given.get("play") === "1",
    });
  }

  describe(scene);
  followHands($("splats"), camera, { changed, hovered: (pointer) => overlay.point(pointer) });
  const turn = (right, up) => () => {
    camera.turn(right, up);
    changed();
  };
  const zoom = (factor) => () => {
    camera.zoom(factor);
    changed();
  };
  const actions = {
    play: () => set({ playing: !state.playing }),
    loop: () => set({ loop: !state.loop }),
    marks: () => set({ marks: !state.marks && scene.landmarks.names.length > 0 }),
    ground: () => set({ ground: state.ground + 1 }),
    ramp: () => set({ ramp: (state.ramp + 1) % scene.rampNames.length }),
    home: () => {
      camera.reset();
      changed();
    },
    help: () => $("keys").showModal(),
  };
  followKeys({
    " ": actions.play, o: actions.loop, l: actions.marks, b: actions.ground, r: actions.ramp, 0: actions.home, "?": actions.help,
    1: () => set({ part: "source" }), 2: () => set({ part: "morph" }), 3: () => set({ part: "target" }),
    ",": () => set({ t: state.t - 0.01, playing: false }), ".": () => set({ t: state.t + 0.01, playing: false }),
    ArrowLeft: turn(0.08, 0), ArrowRight: turn(-0.08, 0), ArrowUp: turn(0, 0.08), ArrowDown: turn(0, -0.08),
    "+": zoom(0.9), "=": zoom(0.9), "-": zoom(1 / 0.9),
    h: () => {
      document.body.classList.toggle("bare");
      changed();
    },
  });
  for (const id of ["play", "loop", "marks", "ground", "home", "help"]) $(id).addEventListener("click", actions[id]);
  $("time").addEventListener("input", () => set({ t: Number($("time").value), playing: false }));
  $("ramp").addEventListener("change", () => set({ ramp: $("ramp").selectedIndex }));
  document.querySelectorAll("input[name=part]").forEach((radio) => radio.addEventListener("change", () => set({ part: radio.value })));
  $("splats").addEventListener("webglcontextlost", (event) => event.preventDefault());
  $("splats").addEventListener("webglcontextrestored", () => {
    painter.prepare();
    changed();
  });
  addEventListener("resize", changed);
  addEventListener("hashchange", readAddress);
  readAddress();
  // For scripts: what a rasterizer needs to draw the same picture.
  window.splatmorph = { set, state, view: () => camera.view(painter.canvas.width, painter.canvas.height, covered()) };
}

function luminance(colour) {
  const [r, g, b] = [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16) / 255);
  return 0.3 * r + 0.6 * g + 0.1 * b;
}

try {
  start(await readScene());
  $("message").replaceChildren();
} catch (error) {
  $("message").textContent = error.message;
  console.error(error);
}
