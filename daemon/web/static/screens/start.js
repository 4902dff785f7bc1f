// Start: one card a question. Before anything moves: what is missing, the plan with its limits, a clear floor.

import { ask, may } from "../cell.js";
import { sinceMoment, span } from "../format.js";
import { Action, calibrationName, Card, Figures, Loading, Notice, useGot, useNotice, Verdict } from "../parts.js";
import { html, useState } from "../vendor/htm-preact.js";
import { t, textOr } from "../texts.js";
import { dueWords, jobName, NoRole } from "./now.js";

const LOOK_MS = 5000;

export function Start({ state, rest }) {
  const got = useGot("/api/jobs", state.status.run_id, LOOK_MS);
  const chosen = rest[0];
  if (!got.content) return html`<${Loading} got=${got} />`;
  const job = got.content.find((one) => one.name === chosen);
  if (job) return html`<${Prepare} key=${`${chosen}/${rest[1]}`} job=${job} asked=${rest[1]} state=${state} />`;
  const here = got.content.filter((one) => one.configured);
  const others = got.content.filter((one) => !one.configured);
  return html`<h1>${t("start.title")}</h1>
    ${state.status.job && html`<p class="wide">${t("start.busy", { job: jobName(state.status.job) })}</p>`}
    <div class="cards">${here.map((one) => html`<${JobCard} key=${one.name} job=${one} due=${state.status.due.filter((due) => !one.recipe && due.job === one.name)} />`)}</div>
    ${here.length === 0 && html`<${Card} wide><p>${t("start.none")}</p></${Card}>`}
    ${others.length > 0 && html`<p class="wide dim">${t("start.others")}: ${others.map((one) => jobName(one.name)).join(" · ")}</p>`}`;
}

function JobCard({ job, due }) {
  return html`<${Card} title=${jobName(job.name)}>
    <p class="dim">${job.recipe ? t("start.recipe", { job: jobName(job.job) }) : job.name}</p>
    <p>${textOr(`about.${job.job}`, "")}</p>
    <${Last} job=${job} />
    ${due.map((one) => html`<p key=${one.name}><b>${t("now.due", { name: calibrationName(one.name) })}</b> ${dueWords(one)}</p>`)}
    ${job.obstacle && job.obstacle.name !== "BUSY" && html`<${Obstacle} obstacle=${job.obstacle} />`}
    <div class="actions"><a class="button go" href=${`#start/${job.name}`}>${t("start.prepare")}</a></div>
  </${Card}>`;
}

function Last({ job }) {
  if (!job.last) return html`<p>${t("start.never")}</p>`;
  const { outcome, verdict, started, run_id } = job.last;
  return html`<p>${t("start.last", { age: span(sinceMoment(started)) })}
    ${" "}${verdict ? html`<${Verdict} verdict=${verdict} />` : outcome ? t(`outcome.${outcome}`) : t("start.runs_now")}
    ${" "}<a href=${`#runs/${run_id}`}>${t("now.run", { run: run_id })}</a>
    ${job.seconds !== null && html`<small>${t("start.took", { span: span(job.seconds) })}</small>`}</p>`;
}

const Obstacle = ({ obstacle }) =>
  html`<div class="notice"><p><b>${t("start.missing")}: ${obstacle.text}</b></p><p>${obstacle.hint}</p></div>`;

// What the configuration and the calibrations in effect promise, against the limits that the result will be held to.
function Expected({ job, tool }) {
  const got = useGot(`/api/jobs/${job}/expected${tool ? `?tool=${encodeURIComponent(tool)}` : ""}`);
  if (got.error) return html`<${Loading} got=${got} />`;
  if (got.content === null) return html`<p class="dim">${t("start.expecting")}</p>`;
  if (got.content.expected === null) return null;
  const { text, limits, problems = [], cautions = [] } = got.content.expected;
  return html`<h2>${t("start.expected")}</h2>
    <${Figures} figures=${limits} />
    <ul class="plain">${text.split("; ").map((clause) => html`<li key=${clause}>${clause}</li>`)}</ul>
    ${[...problems, ...cautions].map((finding) => html`<div class="notice" key=${finding}><p>${finding}</p></div>`)}`;
}

// Which tool is on the flange, where the cell has several: nothing sees it.
function ToolChoice({ tools, tool, choose }) {
  if (tools.length === 0) return null;
  return html`<label>${t("start.tool")} <select value=${tool} onChange=${(event) => choose(event.target.value)}>
    ${tool === "" && html`<option value="">${t("start.tool_choose")}</option>`}
    ${tools.map((name) => html`<option value=${name}>${name}</option>`)}</select></label>`;
}

// What this run alone is asked: a slot, how many picks. What is left as it is configured is not sent.
function Choices({ choices, given, give }) {
  return choices.map(({ key, value, meaning, words, least, most }) => {
    const shown = given[key] ?? String(value);
    const changed = (event) => give(key, event.target.value);
    return html`<label key=${key}>${textOr(`choice.${key}`, key)} ${words.length
      ? html`<select value=${shown} onChange=${changed}>${words.map((word) => html`<option value=${word}>${textOr(`choice.${key}.${word}`, word)}</option>`)}</select>`
      : html`<input type="number" required min=${least} max=${most} value=${shown} onInput=${changed} />`}
      ${" "}<small class="dim">${meaning}</small></label>`;
  });
}

function Prepare({ job, asked, state }) {
  const [plan, setPlan] = useState(null);
  const [given, setGiven] = useState({});
  const [tool, setTool] = useState(job.tools.includes(asked) ? asked : job.tool || "");
  const [clear, setClear] = useState(false);
  const [notice, tell] = useNotice();
  const telling = (work) => async () => {
    try {
      tell(null);
      await work();
    } catch (refused) {
      tell({ text: refused.message, hint: refused.error ? refused.error.hint : t("page.not_sent") });
    }
  };
  const choose = (name) => {
    setTool(name);
    setPlan(null); // it was of another tool
    setClear(false);
  };
  const give = (key, text) => {
    setGiven({ ...given, [key]: text });
    setPlan(null); // it was for another place
    setClear(false);
  };
  const differing = job.choices.filter(({ key, value }) => key in given && given[key] !== String(value));
  const params = Object.fromEntries(differing.map(({ key }) => [key, given[key]]));
  const request = { job: job.name, params: job.tools.length ? { ...params, tool } : params };
  const unknown = job.tools.length > 0 && tool === "";
  const makePlan = telling(async () => {
    setPlan(await ask("start", { ...request, dry_run: true }));
  });
  const start = telling(async () => {
    await ask("start", request);
    location.hash = "#run";
  });
  const busy = state.status.job !== null;
  return html`<h1>${jobName(job.name)}</h1>
    <${Card} wide>
      ${job.recipe && html`<p class="dim">${t("start.recipe", { job: jobName(job.job) })}</p>`}
      <p>${textOr(`about.${job.job}`, "")}</p>
      <${Last} job=${job} />
      ${job.obstacle && html`<${Obstacle} obstacle=${job.obstacle} />`}
      <${ToolChoice} tools=${job.tools} tool=${tool} choose=${choose} />
      ${!busy && !unknown && html`<${Expected} key=${tool} job=${job.name} tool=${tool} />`}
      <${Choices} choices=${job.choices} given=${given} give=${give} />
      <h2>${t("start.step_plan")}</h2>
      <p>${t("start.plan_about")}</p>
      <div class="actions"><${Action} run=${makePlan} disabled=${busy || unknown || !may("operator")}>${t("start.plan")}</${Action}></div>
      ${plan && html`<div class="scroll" tabindex="0" role="region" aria-label=${t("start.step_plan")}><pre>${plan.words}</pre></div>`}
      <h2>${t("start.step_start")}</h2>
      <label><input type="checkbox" checked=${clear} onChange=${(event) => setClear(event.target.checked)} />${t("start.clear")}</label>
      <div class="actions">
        <${Action} kind="go" run=${start} disabled=${busy || unknown || !clear || !may("operator")}>${t("start.start")}</${Action}>
        <a class="button" href="#start">${t("page.back")}</a>
      </div>
      <${Notice} notice=${notice} close=${() => tell(null)} />
      <${NoRole} role="operator" />
    </${Card}>`;
}

