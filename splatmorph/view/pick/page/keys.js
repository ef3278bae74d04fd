// The keys: everything can be done without a mouse.

const TURN_STEP = 0.1;
const CROSS_STEP = 4;
const VIEWS = { Digit1: [0, 0], Digit3: [Math.PI / 2, 0], Digit7: [0, Math.PI / 2] };

function linkedPanes(session) {
  return session.linked ? session.panes : [session.panes[session.active]];
}

function moveCameras(session, act) {
  linkedPanes(session).forEach((pane) => {
    act(pane.camera, pane);
    pane.changed();
  });
}

// Front, side and top; the opposite of each.
function lookFrom(session, [azimuth, elevation], opposite) {
  moveCameras(session, (camera) => {
    if (!(camera instanceof OrbitCamera)) return camera.reset();
    camera.azimuth = elevation ? 0 : azimuth + (opposite ? Math.PI : 0);
    camera.elevation = 0;
    camera.turn(0, opposite ? -elevation : elevation);
  });
}

function nextUp(session) {
  moveCameras(session, (camera, pane) => {
    if (!(camera instanceof OrbitCamera)) return;
    const names = Object.keys(pane.side.ups);
    pane.up = names[(names.indexOf(pane.up) + 1) % names.length];
    Object.assign(camera.first, pane.side.ups[pane.up]);
  });
}

// The other side as this one looks, by how the flow says that it stands.
function alignOther(session) {
  const here = session.panes[session.active], there = session.panes[1 - session.active];
  if (!(here.camera instanceof OrbitCamera)) {
    Object.assign(there.camera, { scale: here.camera.scale, center: [...here.camera.center] });
    return there.changed();
  }
  const rows = session.legFacts.turn ?? [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const columns = [0, 1, 2].map((i) => rows.map((row) => row[i]));
  const turned = (vector) => (session.active === 0 ? rows : columns).map((row) => dot(row, vector));
  const { first } = here.camera;
  const grown = there.side.radius / here.side.radius;
  for (const axis of ["right", "up", "back"]) there.camera.first[axis] = turned(first[axis]);
  const off = turned(here.camera.center.map((v, i) => v - here.side.center[i]));
  Object.assign(there.camera, { azimuth: here.camera.azimuth, elevation: here.camera.elevation, distance: here.camera.distance * grown, center: there.side.center.map((v, i) => v + grown * off[i]) });
  return there.changed();
}

function moveCross(session, dx, dy) {
  const turn = session.turn();
  const number = session.cross?.pane ?? (turn.includes(session.active) ? session.active : turn[0]);
  const pane = session.panes[number];
  const place = session.placesOf(session.row(session.chosen))[number];
  const [width, height] = pane.size;
  const [x, y] = session.cross ? [session.cross.x, session.cross.y] : place?.guess ? pane.project(place.point) : [width / 2, height / 2];
  session.cross = { pane: number, x: Math.max(0, Math.min(width - 1, x + dx)), y: Math.max(0, Math.min(height - 1, y + dy)) };
  drawMarks(pane, session);
}

function leaveOff(session) {
  Object.assign(session, { cross: null, suggested: null, drawing: null, loop: null, editing: false, again: null, chosen: null });
  session.say("");
}

function draws(session, what) {
  if (session.facts.sides[0].kind === "picture") return;
  session.drawing = session.drawing === what ? null : what;
  session.draw();
}

function actionsOf(session) {
  return {
    undo: () => session.undo(),
    redo: () => session.redo(),
    save: () => session.save(),
    suggest: () => session.suggest(),
    mirror: () => session.chosen !== null && session.act("mirror", { row: session.chosen }),
    box: () => draws(session, "box"),
    lasso: () => draws(session, "lasso"),
    unmask: () => session.act("mask", { side: session.active }),
    link: () => {
      session.linked = !session.linked;
      session.draw();
    },
    help: () => $("keys").showModal(),
    play: () => session.play(),
  };
}

function keysOf(session, actions) {
  const turn = (right, up) => () => moveCameras(session, (camera) => camera.turn(right, up));
  const zoom = (factor) => () => moveCameras(session, (camera) => camera.zoom(factor));
  return {
    Enter: () => session.accept(), " ": () => session.accept(), Escape: () => leaveOff(session),
    Delete: () => session.remove(), Backspace: () => session.remove(),
    x: () => session.chosen !== null && session.act("toggle", { row: session.chosen }),
    e: () => {
      session.editing = session.chosen !== null && !session.editing;
      session.draw();
    },
    r: () => document.querySelector("tr.chosen input[type=text]")?.select(),
    s: actions.suggest, m: actions.mirror, l: actions.link, b: actions.box, k: actions.lasso, p: actions.play, "?": actions.help,
    q: () => alignOther(session), f: () => session.fly(), 5: () => nextUp(session),
    t: () => session.setTime(session.panes[1].t < 0.5 ? 1 : 0),
    Home: () => moveCameras(session, (camera) => camera.reset()),
    ArrowLeft: turn(TURN_STEP, 0), ArrowRight: turn(-TURN_STEP, 0), ArrowUp: turn(0, TURN_STEP), ArrowDown: turn(0, -TURN_STEP),
    "+": zoom(0.85), "=": zoom(0.85), "-": zoom(1 / 0.85),
  };
}

function followPickerKeys(session, actions) {
  const plain = keysOf(session, actions);
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  document.addEventListener("keydown", (event) => {
    const { key, target } = event;
    const steered = event.ctrlKey || event.metaKey;
    if (document.querySelector("dialog[open]")) return;
    if (target.matches("input[type=text]") && !(steered && key === "s")) return;
    const onControl = target.matches("button, input") && (key === " " || key === "Enter" || key === "Tab");
    const onSlider = target.matches("input[type=range]") && key.startsWith("Arrow");
    if (onControl || onSlider) return;
    const letter = key.length === 1 ? key.toLowerCase() : key;
    const action = (() => {
      if (steered) return { z: event.shiftKey ? actions.redo : actions.undo, y: actions.redo, s: actions.save }[letter];
      if (event.altKey) return null;
      if (VIEWS[event.code]) return () => lookFrom(session, VIEWS[event.code], event.shiftKey);
      if (key === "Tab") return () => session.step(event.shiftKey ? -1 : 1);
      if (event.shiftKey && arrows[key]) return () => moveCross(session, ...arrows[key].map((v) => CROSS_STEP * v));
      return plain[letter];
    })();
    if (!action) return;
    event.preventDefault();
    action();
  });
}
