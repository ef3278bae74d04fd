// The picker's page begins.

async function openLeg(session, leg) {
  const { sides } = session.facts;
  Object.assign(session, { leg, chosen: null, again: null, suggested: null, cross: null, morphOf: null });
  session.panes = await Promise.all([0, 1].map((number) => makePane(number, leg + number, sides[leg + number])));
  session.panes.forEach((pane) => {
    pane.drawn = () => drawMarks(pane, session);
    pane.rested = () => session.hide(pane);
    pane.changed();
  });
  document.querySelectorAll("#tabs button").forEach((tab, i) => tab.setAttribute("aria-selected", i === leg));
  session.setTime(1);
  session.draw();
}

function makeTabs(session) {
  const { sides } = session.facts;
  sides.slice(1).forEach((side, leg) => {
    const tab = Object.assign(document.createElement("button"), { textContent: `${sides[leg].name} → ${side.name}` });
    tab.setAttribute("role", "tab");
    tab.addEventListener("click", () => session.queued(async () => {
      await openLeg(session, leg);
      await session.settle();
    }));
    $("tabs").append(tab);
  });
}

async function begin() {
  const session = new Session(JSON.parse($("facts").textContent));
  makeTabs(session);
  await openLeg(session, 0);
  [0, 1].forEach((number) => followPane(session, number));
  const actions = actionsOf(session);
  for (const id of ["box", "lasso", "unmask"]) $(id).hidden = session.facts.sides[0].kind === "picture";
  for (const [id, action] of Object.entries(actions)) $(id)?.addEventListener("click", action);
  followTable(session);
  followPickerKeys(session, actions);
  $("time").addEventListener("input", () => session.setTime(Number($("time").value)));
  addEventListener("resize", () => session.panes.forEach((pane) => pane.changed()));
  session.take(await (await fetched("/state")).json());
  await session.settle();
  session.draw();
  // For scripts and tests.
  window.picker = session;
  document.documentElement.dataset.ready = "yes";
}

begin().catch((error) => {
  $("hint").textContent = error.message;
  document.documentElement.dataset.ready = "failed";
  console.error(error);
});
