// The session: what the server knows, what is chosen here, and what a click means.

class Session {
  constructor(facts) {
    Object.assign(this, { facts, leg: 0, rows: [], legs: [], chosen: null, again: null, editing: false, suggested: null, cross: null, loop: null, drawing: null, linked: true, active: 0, said: "", panes: [], busy: Promise.resolve(), morphOf: null, playing: 0 });
    this.numbers = new Map();
  }

  get legFacts() {
    return this.legs[this.leg] ?? { pairs: 0 };
  }

  get residuals() {
    return this.legFacts.residuals ?? {};
  }

  get doubtful() {
    return new Set(this.legFacts.doubtful ?? []);
  }

  row(id) {
    return this.rows.find((row) => row.id === id);
  }

  placesOf(row) {
    return row ? row.places.slice(this.leg, this.leg + 2) : [null, null];
  }

  // The side on which the chosen pair waits for an accepted place; both for a mirrored one.
  waiting() {
    return this.placesOf(this.row(this.chosen)).map((place) => Boolean(place?.guess));
  }

  // A length in words: millimetres where the object has the size of things measured in metres.
  inWords(length) {
    const side = this.facts.sides[this.leg + 1];
    if (side.kind === "picture") return `${(length * Math.max(side.width, side.height) / 2).toFixed(1)} px`;
    return side.radius > 0.02 && side.radius < 20 ? `${(1000 * length).toFixed(1)} mm` : length.toPrecision(3);
  }

  // One request after the other, so that what is seen is what the server knows.
  queued(work) {
    this.busy = this.busy.then(work).catch((error) => this.say(error.message));
    return this.busy;
  }

  act(name, body = {}) {
    return this.queued(async () => {
      this.take(await ask(name, { leg: this.leg, ...body }));
      await this.settle();
    });
  }

  take(answer) {
    const { rows, legs, selected, said = "", again } = answer;
    if (rows) this.rows = rows;
    if (legs) this.legs = legs.map((leg, i) => (leg.fresh ? leg : { ...this.legs[i], ...leg }));
    Object.assign(this, { undoes: answer.undo ?? this.undoes, redoes: answer.redo ?? this.redoes, unsaved: answer.unsaved ?? this.unsaved, next: "next" in answer ? answer.next : this.next });
    if (selected !== undefined) this.chosen = selected;
    if (!this.row(this.chosen)) this.chosen = null;
    this.again = again ? this.again ?? this.active : null;
    this.editing = false;
    this.suggested = null;
    this.numbers = new Map(this.rows.filter((row) => !row.auto).map((row, i) => [row.id, i + 1]));
    this.say(said);
  }

  // Brings flows up to date, and the morph that is shown.
  async settle() {
    if (!this.legFacts.fresh) this.take({ ...await ask("settle"), said: this.said, again: this.again !== null });
    const key = JSON.stringify([this.leg, this.legFacts.ready && this.rows.filter((row) => row.on).map((row) => this.placesOf(row).map((place) => place && !place.guess && place.point))]);
    if (key === this.morphOf) return;
    this.morphOf = key;
    $("morph").classList.toggle("waiting", !this.legFacts.ready);
    this.stale = true;
    if (!this.legFacts.ready) this.setTime(1);
    if (this.panes[1].t < 1) await this.freshen();
  }

  async freshen() {
    if (!this.stale) return;
    this.stale = false;
    await this.panes[1].takeMorph(this.legFacts.ready ? this.leg : null);
  }

  say(text) {
    this.said = text;
    this.draw();
  }

  draw() {
    if (!this.panes.length) return;
    this.panes.forEach((pane) => drawMarks(pane, this));
    drawTable(this);
    $("undo").disabled = !this.undoes;
    $("redo").disabled = !this.redoes;
    $("mirror").disabled = this.chosen === null;
    $("link").setAttribute("aria-pressed", this.linked);
    $("box").setAttribute("aria-pressed", this.drawing === "box");
    $("lasso").setAttribute("aria-pressed", this.drawing === "lasso");
    const turn = this.turn();
    this.panes.forEach((pane) => pane.root.classList.toggle("next", turn.includes(pane.number)));
    $("hint").textContent = this.hint();
    $("said").textContent = this.said;
    document.title = `${this.unsaved ? "● " : ""}Pick · ${this.facts.sides.map((side) => side.name).join(" and ")}`;
  }

  // The sides whose turn it is.
  turn() {
    const waiting = this.waiting();
    if (waiting.some(Boolean)) return [0, 1].filter((i) => waiting[i]);
    if (this.again !== null) return [this.again];
    const places = this.placesOf(this.row(this.chosen));
    if (this.chosen !== null && places.some((place) => !place)) return [0, 1].filter((i) => !places[i]);
    return [0];
  }

  hint() {
    if (this.drawing) return `Draw a ${this.drawing === "box" ? "box" : "loop"} round what registration leaves out, on either side · Esc: don't`;
    const row = this.row(this.chosen);
    const waiting = this.waiting();
    if (this.editing) return `Click where ${row.name} is, on either side · Esc: leave it`;
    if (waiting[0] && waiting[1]) return `Enter accepts ${row.name} on both sides, a click on either corrects it`;
    if (waiting.some(Boolean)) return `Enter accepts the dashed ${row.name} on ${"AB"[waiting.indexOf(true)]}, a click there corrects it`;
    if (this.again !== null && row) return `Turn ${"AB"[this.again]} and click ${row.name} again, both sights are crossed · Esc: it is good`;
    if (this.suggested) return "Enter picks the ringed place on A, or click near it";
    if (row && this.placesOf(row).some((place) => !place)) return `Click ${row.name} on ${this.placesOf(row)[0] ? "B" : "A"}`;
    return this.next ? `Click ${this.next} on A` : "Click a feature on A, it is predicted on B · drag turns, wheel zooms, ? keys";
  }

  choose(id, fly = false, quietly = false) {
    Object.assign(this, { chosen: id, again: null, editing: false, suggested: null });
    if (fly) this.fly();
    if (quietly) this.panes.forEach((pane) => drawMarks(pane, this));
    else this.say("");
  }

  // Both cameras to the chosen pair.
  fly() {
    this.placesOf(this.row(this.chosen)).forEach((place, i) => {
      if (!place) return;
      const { camera } = this.panes[i];
      camera.center = [...place.point];
      this.panes[i].changed();
    });
  }

  cameras() {
    return this.panes.map((pane) => pane.view());
  }

  // A click on pane ``number`` at CSS pixels x, y.
  click(number, x, y) {
    if (number === 1 && this.panes[1].t < 1) {
      this.setTime(1);
      return this.say("this is B itself again: now click");
    }
    this.pick(number, { x, y }, this.expects(number) ? this.chosen : null);
  }

  // Whether the next click on pane ``number`` is for the chosen pair, not for a new one.
  expects(number) {
    if (this.chosen === null) return false;
    return this.editing || this.again === number || this.waiting().some(Boolean) || !this.placesOf(this.row(this.chosen))[number];
  }

  pick(number, where, row) {
    this.active = number;
    this.cross = null;
    return this.queued(async () => {
      const begun = performance.now();
      this.again = null;
      const answer = await ask("pick", { leg: this.leg, side: number, row, cameras: this.cameras(), ...where });
      this.lastPick = performance.now() - begun;
      if (!answer.selected) return this.say(answer.said);
      this.again = answer.again ? number : null;
      this.take(answer);
      this.follow(1 - number);
      await this.settle();
    });
  }

  // The other camera so that a prediction is in the middle half of its pane.
  follow(number) {
    const pane = this.panes[number];
    const place = this.placesOf(this.row(this.chosen))[number];
    if (!place?.guess) return;
    const [x, y] = pane.project(place.point);
    const [width, height] = pane.size;
    const off = [x - width / 2, y - height / 2];
    if (Math.abs(off[0]) < width / 4 && Math.abs(off[1]) < height / 4) return;
    pane.camera.shift(-off[0], -off[1], Math.min(width, height));
    pane.changed();
  }

  accept() {
    if (this.cross) return this.click(this.cross.pane, this.cross.x, this.cross.y);
    if (this.waiting().some(Boolean)) return this.act("accept", { row: this.chosen });
    if (this.suggested) return this.pick(0, { point: this.suggested }, null);
    return null;
  }

  suggest() {
    return this.queued(async () => {
      const { point } = await ask("suggest", { leg: this.leg, camera: this.panes[0].view() });
      if (!point) return this.say("nothing to suggest in this view");
      this.choose(null);
      this.suggested = point;
      this.draw();
    });
  }

  undo() {
    return this.act("undo");
  }

  redo() {
    return this.act("redo");
  }

  remove() {
    return this.chosen === null ? null : this.act("remove", { row: this.chosen });
  }

  save() {
    return this.queued(async () => {
      const answer = await ask("save", { leg: this.leg });
      this.take({ ...answer, selected: this.chosen });
      if (!answer.said.startsWith("wrote")) return;
      $("written").textContent = `${answer.said}.`;
      $("command").textContent = this.facts.command;
      if (!$("done").open) $("done").showModal();
    });
  }

  step(by) {
    const rows = this.rows.filter((row) => !row.auto);
    if (!rows.length) return;
    const at = rows.findIndex((row) => row.id === this.chosen);
    this.choose(rows[(at < 0 ? (by > 0 ? 0 : rows.length - 1) : at + by + rows.length) % rows.length].id, true);
    document.querySelector("tr.chosen")?.scrollIntoView({ block: "nearest" });
  }

  async setTime(t) {
    const pane = this.panes[1];
    pane.t = t;
    $("time").value = t;
    $("reading").textContent = t < 1 ? `t ${t.toFixed(2)}` : "";
    if (t < 1 && !this.legFacts.ready) {
      pane.t = 1;
      $("time").value = 1;
      $("reading").textContent = "";
      return this.say(this.legFacts.trouble ?? `a morph takes ${this.facts.sides[0].kind === "picture" ? 3 : 4} pairs`);
    }
    if (t < 1) await this.freshen().catch((error) => this.say(error.message));
    pane.changed();
    return null;
  }

  play() {
    const stop = this.playing;
    cancelAnimationFrame(this.playing);
    this.playing = 0;
    $("play").setAttribute("aria-pressed", !stop);
    if (stop) return;
    const begun = performance.now();
    const step = async (now) => {
      const phase = ((now - begun) / 4000) % 1;
      await this.setTime((1 + Math.cos(2 * Math.PI * phase)) / 2);
      if (this.playing && this.legFacts.ready) this.playing = requestAnimationFrame(step);
      else $("play").setAttribute("aria-pressed", this.playing = 0);
    };
    this.playing = requestAnimationFrame(step);
  }

  hide(pane) {
    if (pane.side.kind === "picture" || !this.rows.some((row) => row.places[this.leg + pane.number])) return;
    ask("hidden", { leg: this.leg, side: pane.number, camera: pane.view() }).then(({ hidden }) => {
      pane.hidden = new Set(hidden);
      drawMarks(pane, this);
    }).catch(() => {});
  }
}
