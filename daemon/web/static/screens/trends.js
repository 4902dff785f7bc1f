// Trends: when checks are due, and every health number over its runs with its limit, in the unit of people.

import { moment, span } from "../format.js";
import { calibrationName, Card, Grid, Loading, useGot } from "../parts.js";
import { Plot } from "../plot.js";
import { html } from "../vendor/htm-preact.js";
import { t, textOr } from "../texts.js";
import { jobName } from "./now.js";

const LOOK_MS = 30000; // a check becomes due while nothing runs

export function Trends({ state }) {
  const got = useGot("/api/trends", `${state.status.run_id} ${state.status.due.length}`, LOOK_MS);
  if (!got.content) return html`<${Loading} got=${got} />`;
  const { trends, checks } = got.content;
  const names = Object.keys(trends);
  return html`<h1>${t("screen.trends")}</h1>
    ${checks.length > 0 && html`<${Checks} checks=${checks} />`}
    ${names.length === 0 && html`<${Card} wide><p>${t("trends.none")}</p></${Card}>`}
    ${names.map((name) => html`<${Trend} key=${name} name=${name} trend=${trends[name]} />`)}`;
}

// Each calibration that has a rule in [check_due]: when it was checked, and when it is due again.
function Checks({ checks }) {
  const rows = checks.map((check) => ({
    key: check.name,
    cells: [
      calibrationName(check.name),
      check.checked === null ? t("trends.never") : moment(check.checked),
      check.due ? html`<b class="refused">${t("trends.due_now")}</b>` : dueWhen(check),
      check.job ? html`<a href=${`#start/${check.job}`}>${jobName(check.job)}</a>` : "–",
    ],
  }));
  return html`<${Card} wide title=${t("trends.checks")}>
    <${Grid} columns=${["calibration", "checked", "due", "job"].map((key) => t(`column.${key}`))} rows=${rows} /></${Card}>`;
}

function dueWhen({ due_at, runs_left }) {
  const parts = [];
  if (due_at !== null) parts.push(t("trends.due_in", { span: span(due_at - Date.now() / 1e3), at: moment(due_at) }));
  if (runs_left !== null) parts.push(t("trends.due_after", { runs: runs_left }));
  return parts.join(t("trends.or"));
}

function Trend({ name, trend }) {
  const owner = name.split(".").pop();
  const kind = name.slice(0, -owner.length - 1);
  const { points, limit, key } = trend;
  const [unit, scale] = unitOf(kind);
  const title = `${textOr(`trend.${kind.replace(/\W/g, "_")}`, kind)}: ${owner}`;
  const signed = points.some((point) => point[1] < 0); // what has a sign is bounded on both sides
  const limits = limit === null ? [] : signed ? [limit, -limit] : [limit];
  const beyond = limit !== null && Math.abs(points[points.length - 1][1]) > limit;
  return html`<${Card} title=${title} kind=${beyond ? "state fault" : ""}>
    ${beyond && html`<p><b>${t("trends.beyond")}</b></p>`}
    <${Plot} title=${t("trends.points", { count: points.length })} points=${points} limits=${limits} unit=${unit} scale=${scale} label=${moment} />
    ${key && html`<p class="dim">${t("plot.limit")}: <code>${key}</code></p>`}
  </${Card}>`;
}

function unitOf(kind) {
  if (kind.endsWith("_per_count")) return ["µm", 1e6];
  if (kind.endsWith("_px")) return ["px", 1];
  if (kind.endsWith("_s")) return ["ms", 1e3];
  if (/_m(\.|$)/.test(kind)) return ["mm", 1e3];
  if (kind.endsWith("_rad")) return ["°", 180 / Math.PI];
  return ["", 1];
}
