// The page: a function of the cell's state, the address after "#", and who is logged in.

import { cell, isStale, who } from "./cell.js";
import { Frame } from "./frame.js";
import { html, render } from "./vendor/htm-preact.js";
import { CellScreen } from "./screens/cell_screen.js";
import { Compare } from "./screens/compare.js";
import { Login } from "./screens/login.js";
import { Now } from "./screens/now.js";
import { Plc } from "./screens/plc.js";
import { Result } from "./screens/result.js";
import { Results } from "./screens/results.js";
import { RunScreen } from "./screens/run.js";
import { Runs } from "./screens/runs.js";
import { Start } from "./screens/start.js";
import { Teach } from "./screens/teach.js";
import { Trends } from "./screens/trends.js";
import { loadTexts, t } from "./texts.js";

const SCREENS = {
  now: Now,
  start: Start,
  run: RunScreen,
  results: Results,
  runs: Runs,
  trends: Trends,
  cell: CellScreen,
  plc: Plc,
  teach: Teach,
  result: Result,
  compare: Compare,
};
const PART_OF = { result: "results", compare: "runs" }; // screens that are reached from another one
const LOOK_MS = 500; // how often the age of the last word is looked at

export const route = () => {
  const [name, ...rest] = location.hash.slice(1).split("/");
  return { name: name in SCREENS || name === "login" ? name : "now", rest };
};

function Page() {
  const { name, rest } = route();
  if (cell.me === null) return html`<p class="alone">${t("page.loading")}</p>`;
  if (name === "login" || !cell.me.look) return html`<${Frame} screen="login"><${Login} /></${Frame}>`;
  if (cell.state === null) return html`<${Frame} screen=${name}><p class="alone">${t("page.loading")}</p></${Frame}>`;
  const Screen = SCREENS[name];
  return html`<${Frame} screen=${PART_OF[name] || name} screens=${Object.keys(SCREENS).filter((each) => !(each in PART_OF))}>
    <${Screen} key=${rest.join("/")} state=${cell.state} rest=${rest} stale=${isStale()} />
  </${Frame}>`;
}

function draw() {
  document.title = cell.state ? `${cell.state.status.cell} · Cellward` : "Cellward";
  document.documentElement.classList.toggle("stale", cell.state !== null && isStale());
  render(html`<${Page} />`, document.getElementById("page"));
}

cell.changed = draw;
window.addEventListener("hashchange", () => {
  draw();
  document.getElementById("main")?.focus(); // who uses keys or a screen reader begins at the new screen
});
setInterval(draw, LOOK_MS);
await loadTexts();
draw();
const begin = () => who().catch(() => setTimeout(begin, 1500));
begin();
