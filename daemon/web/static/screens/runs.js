// Runs: every run with its outcome, filtered; and one with its journal, its result in words and its report.

import { ask, may } from "../cell.js";
import { figureText, moment, span } from "../format.js";
import { Action, Actions, Card, Facts, Grid, Loading, Notice, useGot, Verdict } from "../parts.js";
import { html, useState } from "../vendor/htm-preact.js";
import { Signature, Signatures } from "../signatures.js";
import { t, textOr } from "../texts.js";
import { jobName } from "./now.js";

export function Runs({ state, rest }) {
  return rest[0] ? html`<${OneRun} state=${state} number=${rest[0]} />` : html`<${AllRuns} state=${state} />`;
}

function AllRuns({ state }) {
  const got = useGot("/api/runs", state.status.run_id);
  const [job, setJob] = useState("");
  const [chosen, choose] = useState([]);
  if (!got.content) return html`<${Loading} got=${got} />`;
  const jobs = [...new Set(got.content.map((run) => run.job))].sort();
  const tools = new Set(got.content.map((run) => run.tool).filter(Boolean)).size;
  const shown = got.content.filter((run) => !job || run.job === job);
  const compared = got.content.filter((run) => chosen.includes(run.run_id));
  const rows = shown.map((run) => ({
    key: run.run_id,
    cells: [
      html`<a href=${`#runs/${run.run_id}`}>${run.run_id}</a>`,
      run.compared_as ? html`<${Choice} run=${run} chosen=${compared} choose=${choose} />` : "–",
      html`${jobName(run.job)}${tools > 1 && run.tool && html`<small>${run.tool}</small>`}`,
      html`${moment(run.started)}${run.who && html`<small>${run.who}</small>`}`,
      run.outcome === "complete" && run.verdict ? html`<${Verdict} verdict=${run.verdict} />` : html`<${HowItEnded} run=${run} />`,
      run.figure ? html`<b class="num">${figureText(run.figure)}</b><small>${textOr(`figure.${run.figure.name}`, run.figure.words)}</small>` : "–",
      run.decided.length ? run.decided.map((row) => html`<${Decision} key=${row.id} row=${row} />`) : "–",
      run.signatures.length ? run.signatures.map((one) => html`<${Signature} signature=${one} />`) : "–",
      run.report ? html`<a href=${`/api/runs/${run.run_id}/report`} target="_blank" rel="noopener">${t("result.report")}</a>` : "–",
    ],
  }));
  const keys = ["run", "compare", "job", "started", "verdict", "figure", "decision", "signed", "report"];
  const columns = keys.map((key) => t(`column.${key}`));
  return html`<h1>${t("screen.runs")}</h1>
    <${Card} wide>
      ${jobs.length > 1 && html`<label>${t("runs.only")} <select onChange=${(event) => setJob(event.target.value)}>
        <option value="">${t("runs.all")}</option>${jobs.map((name) => html`<option value=${name}>${jobName(name)}</option>`)}</select></label>`}
      <${Grid} columns=${columns} rows=${rows} empty=${t("runs.none")} />
      ${got.content.filter((run) => run.compared_as).length > 1 && html`<${CompareChosen} chosen=${compared} />`}
    </${Card}>`;
}

// Two runs whose results are of one kind are chosen: a third, or one of another kind, cannot be.
function Choice({ run, chosen, choose }) {
  const is = chosen.includes(run);
  const barred = !is && (chosen.length > 1 || chosen.some((other) => other.compared_as !== run.compared_as));
  const change = () => choose((is ? chosen.filter((other) => other !== run) : [...chosen, run]).map((one) => one.run_id));
  return html`<input type="checkbox" checked=${is} disabled=${barred} onChange=${change}
    aria-label=${t("compare.choose", { run: run.run_id })} />`;
}

function CompareChosen({ chosen }) {
  if (chosen.length < 2) return html`<p class="dim">${t("compare.choose_two")}</p>`;
  const [first, second] = chosen.map((run) => run.run_id).sort((a, b) => a - b);
  return html`<div class="actions"><a class="button go" href=${`#compare/${first}/${second}`}>${t("compare.title", { first, second })}</a></div>`;
}

const HowItEnded = ({ run }) => html`${outcomeWords(run)}${run.cause && html`<small>${run.cause}</small>`}`;

// What became of a result of the run, by whom.
function Decision({ row }) {
  const by = row.who && t("runs.decided", { who: row.who, at: moment(row.decided) });
  return html`<p><a href=${`#result/${row.id}`}>${t(`state.${row.state}`)}</a> ${by}${row.why && html`<small>${row.why}</small>`}</p>`;
}

const outcomeWords = (run) => (run.outcome ? t(`outcome.${run.outcome}`) : t("runs.goes_on"));

function OneRun({ state, number }) {
  const got = useGot(`/api/runs/${number}`, `${state.status.run_id} ${state.status.step} ${state.status.state}`);
  if (!got.content) return html`<${Loading} got=${got} />`;
  const run = got.content;
  const took = run.ended ? (Date.parse(run.ended) - Date.parse(run.started)) / 1e3 : null;
  return html`<h1>${t("runs.title", { run: run.run_id, job: jobName(run.job) })}</h1>
    <${Card} title=${t("runs.facts")}>
      <${Facts} rows=${[
        [t("column.job"), run.job],
        run.recipe && [t("runs.recipe"), run.recipe],
        run.tool && [t("runs.tool"), run.tool],
        [t("column.started"), moment(run.started)],
        took !== null && [t("runs.took"), span(took)],
        [t("column.outcome"), run.running ? t("runs.goes_on") : outcomeWords(run)],
        [t("column.verdict"), html`<${Verdict} verdict=${run.verdict} />`],
        ...Object.entries(run.parameters).map(([name, value]) => [name, value]),
      ]} />
      <div class="actions">
        ${run.report && html`<a class="button" href=${`/api/runs/${run.run_id}/report`} target="_blank" rel="noopener">${t("result.report")}</a>`}
        <a class="button" href="#runs">${t("runs.back")}</a>
      </div>
      ${run.outcome === "interrupted" && html`<${Adopt} run=${run} />`}
    </${Card}>
    ${run.error && html`<${Card} title=${t("runs.cause")}><${Notice} notice=${run.error} /></${Card}>`}
    ${run.result && run.result.waiting.map((one) => html`<${Card} key=${one.id} kind="state wait"><p>${t("runs.waits")}</p>
      <a class="button go" href=${`#result/${one.id}`}>${t("now.look_decide")}</a></${Card}>`)}
    ${run.ended && html`<${Signatures} run=${run.run_id} />`}
    ${run.result && html`<${Card} wide title=${t("result.words")}><pre class="words">${run.result.words}</pre></${Card}>`}
    <${Card} wide title=${t("runs.journal")}>
      <div class="scroll tall" tabindex="0" role="region" aria-label=${t("runs.journal")}><pre>${run.journal}</pre></div></${Card}>`;
}

// What an interrupted run has finished can be taken over; the arm moves then.
function Adopt({ run }) {
  const adopt = () => ask("start", { job: run.recipe || run.job, params: run.parameters, adopt: run.run_id });
  return html`<p>${t("runs.adopt_means")}</p><${Actions}>${(telling) => html`<${Action} kind="go" disabled=${!may("operator")}
    run=${telling(() => adopt().then(() => (location.hash = "#run")))}>${t("runs.adopt")}</${Action}>`}</${Actions}>`;
}
