// Compare: two results of one kind beside each other, and their difference against its uncertainty.

import { degrees, mm, moment } from "../format.js";
import { Card, Facts, Grid, Loading, useGot, Verdict } from "../parts.js";
import { html } from "../vendor/htm-preact.js";
import { t, textOr } from "../texts.js";

export function Compare({ rest: [first, second] }) {
  const got = useGot(`/api/runs/${second}/against/${first}`);
  const title = html`<h1>${t("compare.title", { first, second })}</h1>`;
  const back = html`<p class="wide"><a href="#runs">${t("runs.back")}</a></p>`;
  if (!got.content) return html`${title}<${Card} wide><${Loading} got=${got} /></${Card}>${back}`;
  const { figures, rows, words } = got.content;
  const judged = figures.significant === undefined ? null : figures.significant;
  const columns = [t("compare.quantity"), runName(first), runName(second), t("result.difference"), t("compare.sigma")];
  return html`${title}
    <${Card} wide kind=${judged === null ? "" : judged ? "state wait" : "state"}>
      ${judged !== null && html`<p class="big">${t(judged ? "compare.differ" : "compare.same")}</p>`}
      <${Grid} columns=${columns} rows=${rows.map(row)} empty=${t("compare.none")} />
      ${rows.some((one) => one.name.startsWith("about_")) && html`<p class="dim">${t("compare.frame", { frame: figures.frame || t("compare.frame_of", { first }) })}</p>`}
      ${figures.detectable_m !== undefined && html`<p class="dim">${t("compare.found", { times: Math.round(1 / figures.false_alarm), length: mm(figures.detectable_m, 3) })}</p>`}
      <p class="dim">${t("compare.independent")}</p>
      <details><summary>${t("result.words")}</summary><pre class="words">${words}</pre></details>
    </${Card}>
    <${One} number=${first} /><${One} number=${second} />${back}`;
}

const runName = (number) => t("now.run", { run: number });

function row({ name, of, unit, first, second, difference, sigma }) {
  const show = (value) => (value === null ? "–" : unit === "rad" ? degrees(value, 4) : mm(value, 3));
  const words = textOr(`compared.${name}`, name);
  return {
    key: of + name,
    cells: [of ? `${of}: ${words}` : words, show(first), show(second), html`<b>${show(difference)}</b>`, show(sigma)],
  };
}

function One({ number }) {
  const got = useGot(`/api/runs/${number}`);
  if (!got.content) return html`<${Card}><${Loading} got=${got} /></${Card}>`;
  const run = got.content;
  return html`<${Card} title=${runName(number)}>
    <${Facts} rows=${[
      [t("column.job"), run.job],
      [t("column.started"), moment(run.started)],
      [t("column.verdict"), html`<${Verdict} verdict=${run.verdict} />`],
    ]} />
    ${run.result && html`<pre class="words">${run.result.words}</pre>`}
    <p><a href=${`#runs/${number}`}>${t("compare.whole")}</a></p>
  </${Card}>`;
}
