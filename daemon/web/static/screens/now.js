// Now: one sentence that says how things are, and the one or two things to do about it.

import { ask, may } from "../cell.js";
import { asWritten, moment, number, span } from "../format.js";
import { Action, Actions, calibrationName, Card, Dot, Facts, Verdict } from "../parts.js";
import { html } from "../vendor/htm-preact.js";
import { t, textOr } from "../texts.js";

// Why a calibration wants to be checked, as the daemon told it.
export const dueWords = ({ cause, value, limit }) =>
  t(`due.${cause}`, { value: number(value, cause === "age" ? 1 : 0), limit: asWritten(limit) });
export const jobName = (job) => textOr(`job.${job}`, job);
// Of a running or ended job, with its tool where the cell has several.
const jobAndTool = ({ job, tool }) => (tool ? `${jobName(job)} (${tool})` : jobName(job));
// The start screen of what measures a calibration that is due.
export const dueStart = ({ job, tool }) => (tool ? `#start/${job}/${tool}` : `#start/${job}`);
const HELD = new Set(["HELD", "HOLDING", "SUSPENDED"]);
const ENDING = new Set(["STOPPING", "ABORTING", "COMPLETING", "CLEARING"]);

export function Now({ state }) {
  const { status } = state;
  return html`<h1 class="hidden">${t("screen.now")}</h1>
    <${What} state=${state} />
    ${status.program_start && html`<${ProgramStart} told=${status.program_start} />`}
    ${status.waiting.map((result) => html`<${Waiting} key=${result.id} result=${result} last=${status.last_run} />`)}
    ${status.interrupted.map((run) => html`<${Card} wide kind="state wait" key=${run}>
      <p class="big">${t("now.interrupted", { run })}</p><p>${t("now.interrupted_do")}</p></${Card}>`)}
    ${state.plc === false && html`<${Card} wide kind="state wait"><p class="big">${t("now.plc_silent")}</p>
      <p>${t("now.plc_silent_do")}</p></${Card}>`}
    ${status.ledger_damage && html`<${Damage} open=${status.ledger_damage.still_open} />`}
    ${status.due.map((due) => html`<${Card} wide kind="state wait" key=${due.name}>
      <p class="big">${t("now.due", { name: calibrationName(due.name) })}</p>
      <p>${dueWords(due)}${due.job && html` <a href=${dueStart(due)}>${t("now.due_do", { job: jobName(due.job) })}</a>`}</p></${Card}>`)}
    ${status.disk && status.disk.warning && html`<${Card} wide kind="state wait"><p class="big">${t("now.disk")}</p>
      <p>${status.disk.warning}</p></${Card}>`}
    <${Devices} devices=${status.devices} />
    <${Lately} writes=${state.writes} />`;
}

function What({ state }) {
  const { status } = state;
  if (status.prompt) return html`<${Prompt} state=${state} />`;
  if (status.job) return html`<${Running} state=${state} />`;
  if (status.latched || status.error) return html`<${Fault} status=${status} />`;
  const last = status.last_run;
  return html`<${Card} wide kind="state">
    <p class="big">${t("now.ready")}</p>
    ${last && html`<p>${t("now.last", { run: last.run_id, job: jobAndTool(last) })} <${Outcome} last=${last} />
      ${" "}<a href=${`#runs/${last.run_id}`}>${t("now.show_run")}</a></p>`}
    <div class="actions"><a class="button go" href="#start">${t("now.start")}</a></div>
  </${Card}>`;
}

const Outcome = ({ last }) =>
  last.verdict ? html`<${Verdict} verdict=${last.verdict} />` : html`<b>${t(`outcome.${last.outcome}`)}</b>`;

function Prompt({ state }) {
  const { status } = state;
  return html`<${Card} wide kind="state wait">
    <p class="big">${t("now.waits")}</p>
    <p class="prompt">${status.prompt.text}</p>
    <p>${t("now.stands")}</p>
    <${Progress} state=${state} />
    <${Actions}>${(telling) => html`
      <${Action} kind="go" disabled=${!may("operator")}
        run=${telling(() => ask("confirm", { prompt_id: status.prompt.id }))}>${t("now.confirm")}</${Action}>
      ${status.prompt.skippable && html`<${Action} disabled=${!may("operator")}
        run=${telling(() => ask("skip", { prompt_id: status.prompt.id }))}>${t("now.skip")}</${Action}>`}
      <${Action} disabled=${!may("operator")} run=${telling(() => ask("finish"))}>${t("now.finish")}</${Action}>`}
    </${Actions}>
    <${NoRole} role="operator" />
  </${Card}>`;
}

export function Running({ state, watched = false }) {
  const { status } = state;
  const held = HELD.has(status.packml);
  const ending = ENDING.has(status.packml);
  const words = ending ? "now.ending" : held ? "now.held" : "now.moves";
  return html`<${Card} wide kind=${`state ${held ? "wait" : "busy"}`}>
    <p class="big">${t(words, { job: jobAndTool(status) })}</p>
    <${Progress} state=${state} />
    ${!ending && html`<${Actions}>${(telling) => html`
      ${held
        ? html`<${Action} kind="go" disabled=${!may("operator")} run=${telling(() => ask("resume"))}>${t("now.resume")}</${Action}>`
        : html`<${Action} disabled=${!may("operator")} run=${telling(() => ask("pause"))}>${t("now.pause")}</${Action}>`}
      <${Action} disabled=${!may("operator")} run=${telling(() => ask("finish"))}>${t("now.finish")}</${Action}>`}
    </${Actions}>`}
    ${!watched && html`<p><a href="#run">${t("now.watch")}</a></p>`}
  </${Card}>`;
}

export function Progress({ state }) {
  const { status, pace } = state;
  const label = status.steps ? t("now.step_of", { step: status.step, steps: status.steps }) : t("now.step", { step: status.step });
  const left = pace && pace.left_s !== null ? ` · ${t("now.left", { span: span(pace.left_s) })}` : "";
  return html`
    ${status.steps > 0 && html`<progress max=${status.steps} value=${status.step} aria-label=${t("now.progress")}></progress>`}
    <p class="num">${t("now.run", { run: status.run_id })} · ${label} · ${t("now.elapsed", { span: span(pace ? pace.elapsed_s : null) })}${left}</p>`;
}

function Fault({ status }) {
  const fault = status.error;
  return html`<${Card} wide kind="state fault">
    <p class="big">${fault ? fault.text : t("now.locked")}</p>
    ${fault && html`<p>${fault.hint}</p>`}
    <p>${t(status.latched ? "now.locked_do" : "now.failed_do")}</p>
    <${Actions}>${(telling) => html`
      <${Action} kind="go" disabled=${!may("integrator")} run=${telling(() => ask("reset"), t("now.reset_done"))}>${t("now.reset")}</${Action}>
      ${!status.latched && html`<a class="button" href="#start">${t("now.start")}</a>`}
      ${status.last_run && html`<a class="button" href=${`#runs/${status.last_run.run_id}`}>${t("now.show_run")}</a>`}`}
    </${Actions}>
    <${NoRole} role="integrator" />
  </${Card}>`;
}

function Waiting({ result, last }) {
  const verdict = last && last.run_id === result.run_id ? last.verdict : null;
  return html`<${Card} wide kind="state wait">
    <p class="big">${t("now.decide", { name: calibrationName(result.name) })}</p>
    <p>${t("now.from_run", { run: result.run_id })} <${Verdict} verdict=${verdict} /></p>
    <div class="actions"><a class="button go" href=${`#result/${result.id}`}>${t("now.look_decide")}</a></div>
  </${Card}>`;
}

// The arm's own program after a check that it asked for: nobody may be surprised by what moves the arm.
function ProgramStart({ told }) {
  const kind = { "not started": "state wait", started: "state" }[told.state] || "state busy";
  return html`<${Card} wide kind=${kind}><p class="big">${t(`program.${told.state.replace(" ", "_")}`, { program: told.program })}</p>
    <p>${told.text}</p></${Card}>`;
}

function Damage({ open }) {
  if (open) {
    return html`<${Card} wide kind="state fault"><p class="big">${t("now.damage_open")}</p>
      <p>${t("now.damage_open_do")}</p></${Card}>`;
  }
  return html`<${Card} wide kind="state fault"><p class="big">${t("now.damage")}</p><p>${t("now.damage_do")}</p>
    <${Actions}>${(telling) => html`<${Action} disabled=${!may("integrator")}
      run=${telling(() => ask("acknowledge_ledger"))}>${t("now.acknowledge")}</${Action}>`}</${Actions}></${Card}>`;
}

// Said to who may not press what stands above.
export function NoRole({ role }) {
  return may(role) ? null : html`<p class="dim">${t("login.needs", { role: t(`role.${role}`) })}</p>`;
}

export function deviceState(device) {
  if (device.state === "READY") return "ok";
  return device.state === "FAULTED" ? "bad" : "warn";
}

function Devices({ devices }) {
  const rows = Object.entries(devices).map(([name, device]) => [
    html`<${Dot} state=${deviceState(device)} />${name}`,
    t(`device.${device.state}`),
    device.state === "READY" ? null : device.error,
  ]);
  return html`<${Card} title=${t("now.devices")}>
    ${rows.length ? html`<${Facts} rows=${rows} />` : html`<p class="dim">${t("now.no_devices")}</p>`}
  </${Card}>`;
}

// Who did what, over every channel: nobody acts unseen.
export function Lately({ writes }) {
  return html`<${Card} title=${t("now.lately")}>
    ${writes.length === 0
      ? html`<p class="dim">${t("now.nobody")}</p>`
      : html`<ul class="plain">${[...writes].reverse().map(
          (line) => html`<li key=${line.number}><span class="dim num">${moment(line.at)}</span> ${line.who}:
            ${" "}<span class=${line.accepted ? "" : "refused"}>${line.what}</span>
            ${!line.accepted && html`<small>${t("now.refused")}: ${line.detail}</small>`}</li>`,
        )}</ul>`}
  </${Card}>`;
}
