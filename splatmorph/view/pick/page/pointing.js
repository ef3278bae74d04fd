// Hands on the panes: clicks, dragged marks, loops, and cameras that move together.

const CLICK = 4; // pixels within which a press is a click
const ON_MARK = 5; // pixels from a mark within which a click means the mark
const GAP = 5; // pixels between the corners of a lasso

// What turns one camera, or both where they are linked.
function together(session, number, held) {
  const moved = () => (session.linked && !held.alt ? session.panes : [session.panes[number]]);
  const every = (act) => moved().forEach((one) => {
    act(one.camera, one);
    one.changed();
  });
  return {
    turn: (right, up) => every((camera) => camera.turn(right, up)),
    shift: (dx, dy, height) => every((camera) => camera.shift(dx, dy, height)),
    // What is under the pointer stays there.
    zoom: (factor) => every((camera, one) => {
      const [width, height] = one.size;
      const off = held.at ? [held.at[0] - width / 2, held.at[1] - height / 2] : [0, 0];
      camera.view(width, height);
      camera.zoom(factor);
      camera.view(width, height);
      camera.shift(off[0] * (1 - 1 / factor), off[1] * (1 - 1 / factor), Math.min(width, height));
    }),
    reset: () => every((camera) => camera.reset()),
  };
}

function followPane(session, number) {
  const root = $(`pane${number}`);
  const pane = () => session.panes[number];
  const held = { alt: false, at: null };
  const at = (event) => {
    const box = root.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  let press = null;

  // Before the camera's own hands: what is for a mark or a loop doesn't turn.
  root.addEventListener("pointerdown", (event) => {
    if (event.target.closest("#morph")) return;
    session.active = number;
    held.alt = event.altKey;
    const mark = event.target.closest(".mark");
    press = { from: at(event), far: 0, plain: event.button === 0 && !event.shiftKey, row: mark ? Number(mark.dataset.row) : null, finger: event.pointerId };
    if (session.drawing && event.button === 0) {
      session.loop = { pane: number, polygon: [at(event)] };
      root.setPointerCapture(event.pointerId);
      event.stopPropagation();
    } else if (mark) {
      root.setPointerCapture(event.pointerId);
      event.stopPropagation();
    }
  }, true);
  root.addEventListener("pointermove", (event) => {
    held.alt = event.altKey;
    held.at = at(event);
    if (!press) return;
    press.far = Math.max(press.far, Math.hypot(held.at[0] - press.from[0], held.at[1] - press.from[1]));
    if (session.loop) {
      session.loop.polygon = grown(session, press.from, held.at);
      drawMarks(pane(), session);
      event.stopPropagation();
    } else if (press.row !== null) {
      event.stopPropagation();
      if (press.far > CLICK) pane().svg.querySelector(`[data-row="${press.row}"]`)?.setAttribute("transform", `translate(${held.at.join(" ")})`);
    } else if (press.far <= CLICK) event.stopPropagation();
  }, true);
  root.addEventListener("pointerup", (event) => {
    const done = press;
    press = null;
    if (!done || done.finger !== event.pointerId) return;
    if (session.loop) return finishLoop(session, pane());
    const [x, y] = at(event);
    if (done.far <= CLICK) {
      if (!done.plain) return;
      if (done.row !== null && !session.expects(number) && isOn(pane(), done.row, x, y)) session.choose(done.row);
      else session.click(number, x, y);
    } else if (done.row !== null) {
      if (number === 1 && pane().t < 1) session.say("put the morph to B before you move its marks");
      else {
        session.choose(done.row, false, true);
        session.pick(number, { x, y }, done.row);
      }
    }
  }, true);
  root.addEventListener("pointercancel", () => {
    press = session.loop = null;
    session.draw();
  });
  root.addEventListener("dblclick", (event) => event.stopPropagation(), true);
  root.addEventListener("wheel", (event) => {
    held.alt = event.altKey;
    held.at = at(event);
  }, { capture: true, passive: true });
  followHands(root.querySelector(".stage"), together(session, number, held), { changed: () => {}, hovered: () => {} });
}

function isOn(pane, row, x, y) {
  const box = pane.svg.querySelector(`[data-row="${row}"]`).transform.baseVal[0].matrix;
  return Math.hypot(x - box.e, y - box.f) <= ON_MARK;
}

function grown({ drawing, loop }, from, now) {
  if (drawing === "box") return [from, [now[0], from[1]], now, [from[0], now[1]]];
  const last = loop.polygon.at(-1);
  return Math.hypot(now[0] - last[0], now[1] - last[1]) < GAP ? loop.polygon : [...loop.polygon, now];
}

function finishLoop(session, pane) {
  const { polygon } = session.loop;
  Object.assign(session, { loop: null, drawing: null });
  if (polygon.length < 3) return session.say("");
  return session.act("mask", { side: pane.number, polygon, camera: pane.view(), selected: session.chosen });
}
