// The marks over a pane: discs with numbers, what is suggested, the keys' cross, loops.

const SVG = "http://www.w3.org/2000/svg";

function shape(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}

// ``session`` knows the rows and which of them is what.
function drawMarks(pane, session) {
  const { svg, number } = pane;
  const side = session.leg + number;
  const made = document.createDocumentFragment();
  const group = (row) => {
    const place = row.places[side];
    const [x, y, depth] = pane.project(place.point);
    if (depth <= 0) return;
    const classes = { guess: place.guess, chosen: row.id === session.chosen, bad: session.doubtful.has(row.id), off: !row.on, auto: row.auto, hidden: pane.hidden?.has(row.id) && row.id !== session.chosen };
    const mark = shape("g", { class: ["mark", ...Object.keys(classes).filter((name) => classes[name])].join(" "), "data-row": row.id, transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})` }, made);
    shape("circle", { class: "ring", r: 10 }, mark);
    shape("circle", { class: "dot", r: place.guess ? 7 : row.auto ? 2.2 : 4.2 }, mark);
    if (!row.auto) {
      shape("circle", { class: "grip", r: 10 }, mark);
      shape("text", { x: 8, y: -7 }, mark).textContent = session.numbers.get(row.id);
    }
  };
  const rows = session.rows.filter((row) => row.places[side]);
  // The chosen one on top.
  [...rows.filter((row) => row.auto), ...rows.filter((row) => !row.auto && row.id !== session.chosen), ...rows.filter((row) => row.id === session.chosen)].forEach(group);
  if (session.suggested && number === 0) {
    const [x, y] = pane.project(session.suggested);
    shape("circle", { class: "hint-ring", cx: x, cy: y, r: 14 }, made);
  }
  if (session.cross?.pane === number) {
    const { x, y } = session.cross;
    shape("path", { class: "cross", d: `M${x - 16} ${y}H${x - 4}M${x + 4} ${y}H${x + 16}M${x} ${y - 16}V${y - 4}M${x} ${y + 4}V${y + 16}` }, made);
  }
  if (session.loop?.pane === number) shape("polygon", { class: "loop", points: session.loop.polygon.map((corner) => corner.join()).join(" ") }, made);
  svg.replaceChildren(made);
}
