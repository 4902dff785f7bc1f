// Run: the job as it goes, what the camera saw, and the numbers that it leaves to be drawn.

import { get } from "../cell.js";
import { mm, number } from "../format.js";
import { Card, Facts, useGot } from "../parts.js";
import { Plot } from "../plot.js";
import { html, useEffect, useState } from "../vendor/htm-preact.js";
import { t, textOr } from "../texts.js";
import { Lately, Now, Running } from "./now.js";

const LOOK_MS = 400;
const SHOWN_S = 30; // of a trace
const MOST_ROWS = 3000;

export function RunScreen({ state }) {
  const { status } = state;
  if (status.job === null || status.prompt) return html`<${Now} state=${state} />`;
  const live = Object.entries(status.live);
  return html`<h1 class="hidden">${t("screen.run")}</h1>
    <${Running} state=${state} watched />
    <${Seen} run=${status.run_id} step=${status.step} />
    <${Card} title=${t("run.now")}>
      <${Facts} rows=${[
        [t("run.state"), status.state],
        status.steps_taken_again > 0 && [t("run.again"), status.steps_taken_again],
        ...live.map(([name, value]) => [textOr(`live.${name}`, name), number(value, 3)]),
      ]} />
    </${Card}>
    <${Traces} run=${status.run_id} />
    <${Lately} writes=${state.writes} />`;
}

// The newest picture of a capture, with the corners that were found in it.
function Seen({ run, step }) {
  const got = useGot(`/api/runs/${run}/seen`, step);
  const seen = got.content;
  if (!seen || !seen.size[0]) return null;
  const [width, height] = seen.size;
  const radius = width / 160;
  return html`<${Card} title=${t("run.seen")}>
    <svg class="picture" viewBox=${`0 0 ${width} ${height}`} role="img" aria-label=${t("run.seen_about", { corners: seen.corners.length })}>
      <image href=${`/api/runs/${run}/picture/${seen.picture}`} width=${width} height=${height} />
      ${seen.corners.map(([u, v]) => html`<circle class="corner" cx=${u} cy=${v} r=${radius} />`)}
    </svg>
    <p class="dim">${t("run.seen_about", { corners: seen.corners.length })}</p>
  </${Card}>`;
}

// The traces of a running job; each column against the first one, which is the time.
function Traces({ run }) {
  const traces = useTraces(run);
  return Object.entries(traces).map(([name, { columns, rows }]) => {
    if (name === "known") return html`<${Known} key=${name} rows=${rows} />`;
    if (rows.length < 2) return null;
    return html`<${Card} key=${name} title=${textOr(`trace.${name}`, name)}>
      ${columns.slice(1).map((column, index) => {
        const points = rows.map((row) => [row[0], row[index + 1]]).filter((point) => Number.isFinite(point[1]));
        if (points.length < 2) return null;
        return html`<${Plot} key=${column} title=${textOr(`trace.${column}`, column)} points=${points} line />`;
      })}
    </${Card}>`;
  });
}

// The 95 % error that the data so far promise, beside the limit that it has to come under.
function Known({ rows }) {
  if (rows.length === 0) return null;
  const [placements, error, limit] = rows[rows.length - 1];
  const points = rows.map((row) => [row[0], row[1]]);
  return html`<${Card} title=${t("known.title")}>
    <p class="num"><b>${mm(error, 3)}</b> · ${t("plot.limit")} ${mm(limit, 3)}</p>
    <meter min="0" max=${Math.max(2 * limit, error)} high=${limit} value=${error} aria-label=${t("known.title")}></meter>
    <p>${t(error > limit ? "known.beyond" : "known.within", { placements })}</p>
    ${points.length > 1 && html`<${Plot} title=${t("known.by_placement")} points=${points} limits=${[limit]} unit="mm" scale=${1e3} label=${(x) => number(x, 0)} />`}
  </${Card}>`;
}

function useTraces(run) {
  const [traces, setTraces] = useState({});
  useEffect(() => {
    let over = false;
    const kept = {};
    const next = {};
    const look = async () => {
      const now = await get(`/api/live?since=${encodeURIComponent(JSON.stringify(next))}`);
      if (over || now.run_id !== run) return;
      for (const [name, trace] of Object.entries(now.traces)) {
        next[name] = trace.next;
        const rows = [...((kept[name] && kept[name].rows) || []), ...trace.rows].slice(-MOST_ROWS);
        const begin = rows.length ? rows[rows.length - 1][0] - SHOWN_S : 0;
        kept[name] = { columns: trace.columns, rows: rows.filter((row) => row[0] >= begin) };
      }
      setTraces({ ...kept });
    };
    const timer = setInterval(() => look().catch(() => {}), LOOK_MS);
    return () => {
      over = true;
      clearInterval(timer);
    };
  }, [run]);
  return traces;
}
