// What a reader takes along: a link to this very view, a picture, a short video, a print.

const fixed = (value, digits) => String(Number(value.toFixed(digits)));
const degrees = (angle) => angle * 180 / Math.PI;

// The part of an address after # that brings this view back.
function addressOf({ state, camera, scene, ground }, bare, embedded) {
  const given = new URLSearchParams();
  const { first } = camera;
  const put = (key, value, usual) => value !== usual && given.set(key, value);
  put("t", fixed(state.t, 4), "0");
  put("part", state.part, "morph");
  put("ramp", scene.rampNames[state.ramp], scene.ramp);
  put("azimuth", fixed(degrees(camera.azimuth) % 360, 2), fixed(degrees(first.azimuth), 2));
  put("elevation", fixed(degrees(camera.elevation), 2), fixed(degrees(first.elevation), 2));
  put("zoom", fixed(first.distance / camera.distance, 4), "1");
  // The middle of the view, in units of the first distance.
  put("shift", camera.center.map((v, i) => fixed((v - first.center[i]) / first.distance, 4)).join(","), "0,0,0");
  put("speed", fixed(state.speed, 2), "1");
  put("ground", state.ground.slice(1), ground.slice(1));
  for (const [key, on, usual] of [["landmarks", state.marks, false], ["play", state.playing, false], ["turn", state.spin, false], ["loop", state.loop, true], ["embed", embedded, false]]) {
    put(key, Number(on), Number(usual));
  }
  put("controls", Number(!bare), 1);
  return given.toString().replaceAll("%2C", ",");
}

function readAddress(player, hash) {
  const { camera, scene, state } = player;
  const given = new URLSearchParams(hash.slice(1));
  const number = (key, otherwise) => (Number.isFinite(parseFloat(given.get(key))) ? parseFloat(given.get(key)) : otherwise);
  const on = (key, usual) => (given.has(key) ? given.get(key) === "1" : usual);
  camera.reset();
  camera.azimuth = number("azimuth", degrees(camera.azimuth)) * Math.PI / 180;
  camera.turn(0, number("elevation", degrees(camera.elevation)) * Math.PI / 180 - camera.elevation);
  camera.zoom(1 / Math.max(1e-3, number("zoom", 1)));
  const shift = (given.get("shift") ?? "").split(",").map(Number);
  if (shift.length === 3 && shift.every(Number.isFinite)) camera.center = camera.center.map((v, i) => v + shift[i] * camera.first.distance);
  const ramp = scene.rampNames.indexOf(given.get("ramp"));
  document.body.classList.toggle("bare", given.get("controls") === "0");
  document.body.classList.toggle("embed", on("embed", false));
  player.set({
    t: number("t", 0),
    part: ["source", "morph", "target"].find((name) => name === given.get("part")) ?? "morph",
    ramp: ramp < 0 ? state.ramp : ramp,
    speed: Math.max(0.05, Math.min(8, number("speed", 1))),
    ground: /^[0-9a-f]{6}$/.test(given.get("ground")) ? `#${given.get("ground")}` : player.ground,
    marks: on("landmarks", false),
    spin: on("turn", false),
    loop: on("loop", true),
    playing: on("play", false),
  });
}

async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    // Where the page may not write the clipboard by itself, the old command still may.
    const field = Object.assign(document.createElement("textarea"), { value: text, readOnly: true });
    document.body.append(field);
    field.select();
    const done = document.execCommand("copy");
    field.remove();
    return done;
  }
  return true;
}

function download(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name.replace(/[^\p{L}\p{N}._-]+/gu, "-") });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

// The picture as it is seen, ground, splats and landmarks, stretched over ``target``. Call it right
// after drawing.
function composite(player, target, ground) {
  const { painter: { canvas }, overlay, state } = player;
  const pen = target.getContext("2d");
  if (ground) {
    pen.fillStyle = ground;
    pen.fillRect(0, 0, target.width, target.height);
  }
  pen.drawImage(canvas, 0, 0, target.width, target.height);
  if (state.marks) pen.drawImage(overlay.canvas, 0, 0, target.width, target.height);
  return target;
}

function picture(player, ground) {
  player.draw(Math.min(devicePixelRatio, 2));
  return composite(player, sameSize(player), ground);
}

function sameSize({ painter: { canvas } }) {
  return Object.assign(document.createElement("canvas"), { width: canvas.width, height: canvas.height });
}

// Records the canvas while the morph goes there and back once, or a splat turns once.
class Recorder {
  static FORMATS = ["video/mp4;codecs=avc1.42E01E", "video/webm;codecs=vp9", "video/webm"];

  static get format() {
    if (!window.MediaRecorder || !HTMLCanvasElement.prototype.captureStream) return null;
    return Recorder.FORMATS.find((format) => MediaRecorder.isTypeSupported(format)) ?? null;
  }

  constructor(player, ground, finished) {
    // Of one size from first to last, also where slow pictures are drawn coarser; even, for codecs.
    Object.assign(this, { player, ground, finished, canvas: sameSize(player) });
    this.canvas.width &= ~1;
    this.canvas.height &= ~1;
    this.draw();
    const { scene, state } = player;
    const stream = this.canvas.captureStream(30);
    this.media = new MediaRecorder(stream, { mimeType: Recorder.format, videoBitsPerSecond: 8e6 });
    const parts = [];
    this.media.addEventListener("dataavailable", (event) => parts.push(event.data));
    this.media.addEventListener("stop", () => {
      stream.getTracks().forEach((track) => track.stop());
      clearTimeout(this.timer);
      const type = Recorder.format.split(";")[0];
      this.finished(new Blob(parts, { type }), type.split("/")[1]);
    });
    this.media.start();
    this.timer = setTimeout(() => this.stop(), (scene.last ? ROUND_TRIP * scene.last : FULL_TURN) / state.speed);
  }

  draw() {
    composite(this.player, this.canvas, this.ground);
  }

  stop() {
    if (this.media.state !== "inactive") this.media.stop();
  }
}

// The picture and its landmarks as a page on paper.
function printOut(player, title, facts) {
  const { scene, state, overlay } = player;
  const { leg } = legAt(scene, state.t);
  const shown = document.createElement("img");
  shown.alt = title;
  overlay.numbered = true;
  shown.src = picture(player, "#ffffff").toDataURL("image/png");
  overlay.numbered = false;
  const table = document.createElement("table");
  const row = (cells, kind) => cells.reduce((made, text) => {
    made.append(Object.assign(document.createElement(kind), { textContent: text }));
    return made;
  }, table.insertRow());
  const place = (point) => point.map((v) => v.toPrecision(4)).join("  ");
  row(["", "landmark", "on the source", "on the target"], "th");
  const { names, source, target } = leg.landmarks;
  names.forEach((name, i) => row([i + 1, name, place(source[i][0]), place(target[i].at(-1))], "td"));
  const heading = Object.assign(document.createElement("h2"), { textContent: title });
  const line = Object.assign(document.createElement("p"), { textContent: `${facts} · t = ${state.t.toFixed(2)}` });
  return [heading, line, shown, ...(names.length ? [table] : [])];
}
