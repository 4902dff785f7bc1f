// Result: before, now and the change, how sure it is against its limit, and the decision with its consequence.

import { ask, may } from "../cell.js";
import { degrees, mm, moment } from "../format.js";
import { Action, Actions, calibrationName, Card, Facts, Figures, Loading, useGot, Verdict } from "../parts.js";
import { html, useState } from "../vendor/htm-preact.js";
import { t } from "../texts.js";

const OPEN = new Set(["proposed", "accepted"]);
const AXES = ["x", "y", "z"];

export function Result({ state, rest }) {
  const got = useGot(`/api/results/${rest[0]}`, JSON.stringify(state.status.waiting));
  if (!got.content) return html`<${Loading} got=${got} />`;
  const result = got.content;
  return html`<h1>${calibrationName(result.name)}</h1>
    <${Card} wide kind=${`state ${result.verdict === "pass" ? "" : result.verdict === "fail" ? "fault" : "wait"}`}>
      <p class="big"><${Verdict} verdict=${result.verdict} /> ${t(`state.${result.state}`)}</p>
      ${result.reasons.map((reason) => html`<p>${reason}</p>`)}
      <${Figures} figures=${result.figures} />
      ${OPEN.has(result.state) ? html`<${Decide} result=${result} />` : html`<${Decided} result=${result} />`}
    </${Card}>
    <${Change} result=${result} />
    <${Card} wide title=${t("result.words")}><pre class="words">${result.words}</pre>
      <p><a href=${`#runs/${result.run_id}`}>${t("now.run", { run: result.run_id })}</a></p></${Card}>`;
}

function Decide({ result }) {
  const [why, setWhy] = useState("");
  const warned = result.warnings.length > 0;
  const role = warned ? "integrator" : "operator";
  return html`
    <p>${t("result.accepting")} ${result.use}</p>
    ${warned && html`<div class="notice"><p><b>${t("result.warned")}</b></p>${result.warnings.map((text) => html`<p>${text}</p>`)}</div>`}
    <label>${t(warned ? "result.why_warned" : "result.why")}
      <textarea rows="2" maxlength="200" value=${why} onInput=${(event) => setWhy(event.target.value)}></textarea></label>
    <${Actions}>${(telling) => html`
      <${Action} kind="go" disabled=${!may(role) || (warned && !why.trim())}
        run=${telling(() => ask("accept", { result_id: result.id, warned, why }), (done) => done.use)}>${t("result.accept")}</${Action}>
      <${Action} disabled=${!may("operator")}
        run=${telling(() => ask("reject", { result_id: result.id, why }), t("result.rejected"))}>${t("result.reject")}</${Action}>
      <a class="button" href=${`/api/runs/${result.run_id}/report`} target="_blank" rel="noopener">${t("result.report")}</a>`}
    </${Actions}>
    ${!may(role) && html`<p class="dim">${t("login.needs", { role: t(`role.${role}`) })}</p>`}`;
}

function Decided({ result }) {
  return html`<${Facts} rows=${[
    [t("result.decided"), moment(result.decided), result.who],
    result.version !== null && [t("result.version"), result.version],
    result.why && [t("result.reason"), result.why],
  ]} />
  <p class="dim">${t("result.roll_back_at")} <a href="#results">${t("screen.results")}</a></p>`;
}

function Change({ result }) {
  const { before, now } = result;
  const was = result.before_version === null ? t("result.configured") : t("result.of_version", { version: result.before_version });
  if (!before.pose || !now.pose) {
    return html`<${Card} wide title=${t("result.change")}><${Facts} rows=${[
      [was, before.words],
      [t("result.this"), now.words],
    ]} /></${Card}>`;
  }
  const moved = Math.hypot(...AXES.map((_, i) => now.pose[i] - before.pose[i]));
  const rows = AXES.map((axis, i) => line(axis, before.pose[i], now.pose[i], (v) => mm(v, 3))).concat(
    AXES.map((axis, i) => line(t("result.about", { axis }), before.pose[i + 3], now.pose[i + 3], (v) => degrees(v, 4))),
  );
  return html`<${Card} wide title=${t("result.change")}>
    <p class="num">${t("result.moved", { length: mm(moved, 3) })}</p>
    <div class="scroll" tabindex="0" role="region" aria-label=${t("result.change")}><table class="grid">
      <thead><tr><th scope="col">${result.name}</th><th scope="col">${was}</th><th scope="col">${t("result.this")}</th><th scope="col">${t("result.difference")}</th></tr></thead>
      <tbody>${rows}</tbody></table></div></${Card}>`;
}

const line = (name, before, now, show) => html`<tr><th scope="row">${name}</th><td>${show(before)}</td><td>${show(now)}</td>
  <td>${now >= before ? "+" : ""}${show(now - before)}</td></tr>`;

