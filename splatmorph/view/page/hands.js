// Mouse, touch and keys, turned into turns, shifts and zooms of the camera.

const TURN = 0.007;

function followHands(canvas, camera, { changed, hovered }) {
  const fingers = new Map();
  // A finger hides what it points at: it reaches farther.
  const pointer = (event) => ({ x: event.clientX, y: event.clientY, reach: event.pointerType === "touch" ? 22 : 8 });
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, width: Math.hypot(a.x - b.x, a.y - b.y) };
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    hovered(pointer(event));
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    const now = { x: event.clientX, y: event.clientY };
    if (!last) return hovered(pointer(event));
    if (fingers.size === 2) {
      const before = spread();
      fingers.set(event.pointerId, now);
      const after = spread();
      camera.zoom(before.width / Math.max(after.width, 1));
      camera.shift(after.x - before.x, after.y - before.y, canvas.clientHeight);
    } else if (fingers.size === 1) {
      const [dx, dy] = [now.x - last.x, now.y - last.y];
      if (event.buttons & 6 || event.shiftKey) camera.shift(dx, dy, Math.min(canvas.clientWidth, canvas.clientHeight));
      else camera.turn(TURN * dx, TURN * dy);
      fingers.set(event.pointerId, now);
    }
    changed();
  });
  canvas.addEventListener("pointerleave", () => hovered(null));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    // Inside another page the wheel scrolls that page, unless asked not to.
    if (document.body.classList.contains("embed") && !event.ctrlKey && document.activeElement !== canvas) return;
    event.preventDefault();
    camera.zoom(Math.exp(Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 60) * 0.002));
    changed();
  }, { passive: false });
  canvas.addEventListener("dblclick", () => {
    camera.reset();
    changed();
  });
}

function followKeys(actions) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const inControl = event.target.matches("select, input[type=range], input[type=radio]") && event.key.startsWith("Arrow");
    const onButton = event.target.matches("button") && (event.key === " " || event.key === "Enter");
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action || inControl || onButton) return;
    event.preventDefault();
    action();
  });
}
