// The page: its controls, and what they tell the player.

const $ = (id) => document.getElementById(id);
const GROUNDS = ["#15161a", "#f2f1ee", "#b6b7bb", "#ffffff", "#000000"];
const SPEEDS = [0.25, 0.5, 1, 2, 4];
const TOAST = 2500; // ms a message stays

const toggled = (name) => document.body.classList.toggle(name);
const has = (name) => document.body.classList.contains(name);

function groundsOf(scene) {
  const usual = matchMedia("(prefers-color-scheme: light)").matches ? GROUNDS[1] : GROUNDS[0];
  return [...new Set([scene.background ?? usual, ...GROUNDS])];
}

function luminance(colour) {
  const [r, g, b] = [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16) / 255);
  return 0.3 * r + 0.6 * g + 0.1 * b;
}

function describe(scene) {
  scene.splats.forEach(({ name }, i) => {
    const label = Object.assign(document.createElement("span"), { textContent: name });
    label.className = i === 0 ? "source" : i === scene.last ? "target" : "";
    if (i) $("names").append(Object.assign(document.createElement("span"), { className: "arrow", textContent: " → " }));
    $("names").append(label);
  });
  $("facts").textContent = scene.facts;
  $("about").textContent = scene.about;
  $("time").max = scene.last;
  $("time").step = 0.001;
  scene.rampNames.forEach((name) => $("ramp").add(new Option(name, name)));
  SPEEDS.forEach((speed) => $("speed").add(new Option(`${speed}×`, speed)));
  document.body.classList.toggle("alone", !scene.last);
  $("marks").hidden = !scene.legs.some((leg) => leg.landmarks.names.length);
  $("record").hidden = !Recorder.format;
  $("fullscreen").hidden = !document.fullscreenEnabled;
  $("splats").setAttribute("aria-label", `${document.title}. Drag or use the arrow keys to turn, scroll or + and − to zoom.`);
}

// Brings every control in line with the state.
function showState(scene, state) {
  const press = (id, on) => $(id).setAttribute("aria-pressed", on);
  document.body.classList.toggle("playing", state.playing);
  $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  $("ramp").value = scene.rampNames[state.ramp];
  const speed = SPEEDS.includes(state.speed) ? state.speed : 1;
  $("speed").value = speed;
  press("marks", state.marks);
  press("loop", state.loop);
  press("spin", state.spin);
  document.querySelector(`input[name=part][value=${state.part}]`).checked = true;
  document.documentElement.style.setProperty("--ground", state.ground);
  document.body.classList.toggle("light", luminance(state.ground) > 0.4);
}

function showTime(scene, t) {
  const { leg, t: local } = legAt(scene, t);
  const [from, to] = [scene.splats[leg.index], scene.splats[leg.index + 1]];
  $("time").value = t;
  $("reading").textContent = t.toFixed(2);
  if (to) $("time").setAttribute("aria-valuetext", `t = ${t.toFixed(2)}, ${Math.round(100 * local)} % of the way from ${from.name} to ${to.name}`);
}

let toast = 0;
function say(text) {
  clearTimeout(toast);
  $("toast").textContent = text;
  toast = setTimeout(() => $("toast").replaceChildren(), TOAST);
}

// CSS pixels that the controls take from the bottom of the picture.
function covered() {
  return has("bare") ? 0 : innerHeight - $("controls").getBoundingClientRect().top;
}

function start(scene) {
  const camera = new OrbitCamera(scene.camera);
  const painter = new SplatPainter($("splats"), scene);
  const overlay = new LandmarkOverlay($("overlay"), $("tip"), scene);
  const grounds = groundsOf(scene);
  const player = new Player(scene, painter, overlay, camera, {
    ground: grounds[0],
    covered,
    shown: (state) => showState(scene, state),
    drawn: (still) => {
      showTime(scene, player.state.t);
      keeping.recorder?.draw();
      if (still) keeping.remember();
    },
  });
  const keeping = keeper(player);
  describe(scene);
  const actions = actionsOf(player, keeping, grounds);
  connect(player, actions);
  followHands($("splats"), camera, { changed: () => player.changed(), hovered: (pointer) => overlay.point(pointer) });
  followKeys(keysOf(player, actions));
  readAddress(player, location.hash);
  // For scripts and tests.
  window.splatmorph = { state: player.state, set: (values) => player.set(values), view: () => player.view() };
}

// Links, pictures, videos and prints of what ``player`` shows.
function keeper(player) {
  const { scene, state } = player;
  const nameOf = (ending) => `${scene.splats.map((side) => side.name).join("-")}${scene.last ? `-t${state.t.toFixed(2)}` : ""}.${ending}`;
  const keeping = {
    recorder: null,
    remember: () => {
      const hash = addressOf(player, has("bare"), has("embed"));
      if (hash === location.hash.slice(1)) return;
      try {
        history.replaceState(null, "", `#${hash}`);
      } catch {
        // A page inside a page may have no address of its own.
      }
    },
    copy: async () => {
      keeping.remember();
      say(await copyText(location.href) ? "Link copied" : "The link is in the address bar");
    },
    save: () => picture(player, state.ground).toBlob((blob) => {
      download(blob, nameOf("png"));
      say("Picture saved");
    }),
    record: () => {
      if (keeping.recorder) return keeping.recorder.stop();
      player.set(scene.last ? { t: 0, playing: true, loop: true } : { spin: true });
      player.draw(1);
      keeping.recorder = new Recorder(player, state.ground, (video, ending) => {
        keeping.recorder = null;
        $("record").setAttribute("aria-pressed", false);
        player.set({ playing: false, spin: false });
        download(video, nameOf(ending));
        say("Video saved");
      });
      $("record").setAttribute("aria-pressed", true);
      say("Recording: once there and back");
    },
    print: () => $("paper").replaceChildren(...printOut(player, document.title, scene.facts)),
  };
  return keeping;
}

function actionsOf(player, keeping, grounds) {
  const { scene, state, camera } = player;
  return {
    play: () => player.set({ playing: !state.playing }),
    loop: () => player.set({ loop: !state.loop }),
    spin: () => player.set({ spin: !state.spin }),
    marks: () => player.set({ marks: !state.marks && !$("marks").hidden }),
    ground: () => player.set({ ground: grounds[(grounds.indexOf(state.ground) + 1) % grounds.length] }),
    home: () => {
      camera.reset();
      player.changed();
    },
    help: () => $("keys").showModal(),
    fullscreen: () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()),
    copy: keeping.copy,
    save: keeping.save,
    record: keeping.record,
    print: keeping.print,
    ramp: () => player.set({ ramp: (state.ramp + 1) % scene.rampNames.length }),
  };
}

function connect(player, actions) {
  for (const [id, action] of Object.entries(actions)) {
    if ($(id)?.matches("button")) $(id).addEventListener("click", action);
  }
  $("time").addEventListener("input", () => player.set({ t: Number($("time").value), playing: false }));
  $("ramp").addEventListener("change", () => player.set({ ramp: $("ramp").selectedIndex }));
  $("speed").addEventListener("change", () => player.set({ speed: Number($("speed").value) }));
  document.querySelectorAll("input[name=part]").forEach((radio) => radio.addEventListener("change", () => player.set({ part: radio.value })));
  $("splats").addEventListener("webglcontextlost", (event) => event.preventDefault());
  $("splats").addEventListener("webglcontextrestored", () => {
    player.painter.prepare();
    player.changed();
  });
  addEventListener("resize", () => player.changed());
  addEventListener("beforeprint", actions.print);
  addEventListener("hashchange", () => readAddress(player, location.hash));
}

function keysOf(player, actions) {
  const { camera, state } = player;
  const turn = (right, up) => () => {
    camera.turn(right, up);
    player.changed();
  };
  const zoom = (factor) => () => {
    camera.zoom(factor);
    player.changed();
  };
  const faster = (step) => () => {
    const place = SPEEDS.indexOf(state.speed) + step;
    if (place in SPEEDS) player.set({ speed: SPEEDS[place] });
  };
  return {
    " ": actions.play, o: actions.loop, l: actions.marks, b: actions.ground, r: actions.ramp, 0: actions.home, "?": actions.help,
    a: actions.spin, f: actions.fullscreen, c: actions.copy, s: actions.save, v: actions.record,
    1: () => player.set({ part: "source" }), 2: () => player.set({ part: "morph" }), 3: () => player.set({ part: "target" }),
    ",": () => player.set({ t: state.t - 0.01, playing: false }), ".": () => player.set({ t: state.t + 0.01, playing: false }),
    ArrowLeft: turn(0.08, 0), ArrowRight: turn(-0.08, 0), ArrowUp: turn(0, 0.08), ArrowDown: turn(0, -0.08),
    "+": zoom(0.9), "=": zoom(0.9), "-": zoom(1 / 0.9), "[": faster(-1), "]": faster(1),
    h: () => {
      toggled("bare");
      player.changed();
    },
  };
}

// The poster is painted before the splats are unpacked, which takes the browser whole.
const painted = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));

try {
  await painted();
  start(await readScene((share) => { $("progress").value = share; }));
  $("waiting").remove();
} catch (error) {
  $("waiting").classList.add("failed");
  $("message").textContent = error.message;
  console.error(error);
}
