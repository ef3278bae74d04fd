// The table of pairs, and the line under it.

function cell(row, content) {
  const made = row.insertCell();
  made.append(content);
  return made;
}

// What a row is for this leg: its class, and what its third column says.
function standingOf(row, session) {
  const [a, b] = row.places.slice(session.leg, session.leg + 2);
  if (!a && !b) return ["half", "elsewhere"];
  if (!a || !b) return ["half", "half"];
  if (a.guess || b.guess) return ["guess", "guess"];
  if (!row.on) return ["off", "off"];
  const apart = session.residuals[row.id];
  return [session.doubtful.has(row.id) ? "bad" : "", apart === undefined ? "✓" : session.inWords(apart)];
}

function drawTable(session) {
  const body = $("rows");
  // A name that is being typed stays as it is.
  const typing = body.contains(document.activeElement) && document.activeElement.type === "text" ? document.activeElement.dataset.row : null;
  if (typing && body.querySelector(`tr[data-row="${typing}"]`) && session.rows.some((row) => String(row.id) === typing)) return;
  const made = document.createDocumentFragment();
  for (const row of session.rows.filter((one) => !one.auto)) {
    const line = document.createElement("tr");
    const [kind, said] = standingOf(row, session);
    line.dataset.row = row.id;
    line.className = [kind, row.id === session.chosen ? "chosen" : "", row.on ? "" : "off"].join(" ");
    line.setAttribute("aria-selected", row.id === session.chosen);
    cell(line, String(session.numbers.get(row.id)));
    const name = Object.assign(document.createElement("input"), { type: "text", value: row.name, spellcheck: false, maxLength: 120 });
    name.dataset.row = row.id;
    name.setAttribute("aria-label", `Name of feature ${session.numbers.get(row.id)}`);
    cell(line, name);
    cell(line, said);
    const use = Object.assign(document.createElement("input"), { type: "checkbox", checked: row.on });
    use.setAttribute("aria-label", `Use ${row.name}`);
    cell(line, use);
    made.append(line);
  }
  const autos = session.rows.filter((row) => row.auto);
  if (autos.length) {
    const line = document.createElement("tr");
    line.className = "autos";
    cell(line, "");
    cell(line, `${autos.length} found by a search`);
    cell(line, "");
    const use = Object.assign(document.createElement("input"), { type: "checkbox", checked: autos.some((row) => row.on) });
    use.setAttribute("aria-label", "Use what was found by a search");
    cell(line, use);
    made.append(line);
  }
  body.replaceChildren(made);
  $("empty").hidden = session.rows.length > 0;
  drawSummary(session);
}

function drawSummary(session) {
  const facts = session.legFacts;
  const parts = [`${facts.pairs} pair${facts.pairs === 1 ? "" : "s"}`];
  if (facts.rms) parts.push(`apart ${session.inWords(facts.rms)} (root mean square)`);
  $("summary").replaceChildren(parts.join(" · "));
  const worst = Object.entries(session.residuals).filter(([id]) => !session.row(Number(id))?.auto).sort((a, b) => b[1] - a[1])[0];
  if (worst) {
    const row = session.row(Number(worst[0]));
    if (row) {
      const go = Object.assign(document.createElement("button"), { textContent: row.name });
      go.addEventListener("click", () => session.choose(row.id, true));
      $("summary").append(" · worst: ", go);
    }
  }
  if (facts.trouble) $("summary").append(document.createElement("br"), facts.trouble);
}

function followTable(session) {
  const idOf = (event) => Number(event.target.closest("tr")?.dataset.row);
  $("rows").addEventListener("click", (event) => {
    if (event.target.type === "checkbox") {
      if (event.target.closest(".autos")) session.act("autos", { on: event.target.checked });
      else session.act("toggle", { row: idOf(event) });
    } else if (idOf(event) && event.target.type !== "text") session.choose(idOf(event), true);
  });
  $("rows").addEventListener("focusin", (event) => {
    if (event.target.type === "text" && idOf(event) !== session.chosen) session.choose(idOf(event), false, true);
  });
  $("rows").addEventListener("change", (event) => {
    if (event.target.type === "text") {
      event.target.blur();
      session.act("rename", { row: Number(event.target.dataset.row), name: event.target.value });
    }
  });
  $("rows").addEventListener("keydown", (event) => {
    if (event.target.type !== "text") return;
    if (event.key === "Enter" || event.key === "Escape") {
      if (event.key === "Escape") event.target.value = session.row(idOf(event))?.name ?? "";
      event.target.blur();
      $("pane0").focus();
      event.preventDefault();
    }
    event.stopPropagation();
  });
}
