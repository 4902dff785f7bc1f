// Results: what is in effect for each calibration, by whom, and the way back.

import { ask, may } from "../cell.js";
import { moment } from "../format.js";
import { Action, Actions, calibrationName, Card, Grid, Loading, useGot } from "../parts.js";
import { html, useState } from "../vendor/htm-preact.js";
import { t } from "../texts.js";
import { NoRole } from "./now.js";

export function Results({ state }) {
  const [count, again] = useState(0);
  const got = useGot("/api/results", JSON.stringify(state.status.waiting) + count);
  if (!got.content) return html`<${Loading} got=${got} />`;
  const names = [...new Set(got.content.map((entry) => entry.name))];
  return html`<h1>${t("screen.results")}</h1>
    ${names.length === 0 && html`<${Card} wide><p>${t("results.none")}</p></${Card}>`}
    ${names.map((name) => html`<${Calibration} key=${name} name=${name} again=${() => again((n) => n + 1)}
      entries=${got.content.filter((entry) => entry.name === name)} />`)}`;
}

function Calibration({ name, entries, again }) {
  const active = entries.find((entry) => entry.state === "committed");
  const rows = entries.map((entry) => ({
    key: entry.id,
    cells: [
      html`<a href=${`#result/${entry.id}`}>${entry.id}</a>`,
      t(`state.${entry.state}`),
      entry.version ?? "–",
      html`<a href=${`#runs/${entry.run_id}`}>${entry.run_id}</a>`,
      moment(entry.decided || entry.proposed),
      entry.who || "–",
      entry.why || "–",
      entry.compared && active && active.run_id !== entry.run_id ? html`<${CompareLink} runs=${[active.run_id, entry.run_id]} />` : "–",
    ],
  }));
  const columns = ["result", "state", "version", "run", "when", "who", "why", "compare"].map((key) => t(`column.${key}`));
  return html`<${Card} wide title=${calibrationName(name)}>
    <p class="dim">${name}</p>
    <p>${active ? html`<b>${t("results.active", { version: active.version })}</b> ${active.words}` : t("results.configured")}</p>
    <${Grid} columns=${columns} rows=${rows} empty="" />
    ${active && html`<${RollBack} name=${name} active=${active} again=${again} />`}
  </${Card}>`;
}

function CompareLink({ runs }) {
  const [first, second] = runs.sort((a, b) => a - b);
  return html`<a href=${`#compare/${first}/${second}`}>${t("results.with_active")}</a>`;
}

function RollBack({ name, active, again }) {
  const [sure, setSure] = useState(false);
  if (!sure) {
    return html`<div class="actions"><button onClick=${() => setSure(true)} disabled=${!may("integrator")}>${t("results.roll_back")}</button></div>
      <${NoRole} role="integrator" />`;
  }
  return html`<p>${t("results.roll_back_means", { version: active.version })}</p>
    <${Actions}>${(telling) => html`
      <${Action} kind="go" run=${telling(
        () => ask("rollback", { name }).finally(() => { setSure(false); again(); }),
        (done) => (done.version === null ? t("results.back_to_config") : t("results.back_to", { version: done.version })),
      )}>${t("results.roll_back_do")}</${Action}>
      <button onClick=${() => setSure(false)}>${t("page.back")}</button>`}
    </${Actions}>`;
}
