// What the screens are made of: cards, buttons that tell what became of them, tables of facts, and figures.

import { get, isStale } from "./cell.js";
import { degrees, mm } from "./format.js";
import { html, useEffect, useRef, useState } from "./vendor/htm-preact.js";
import { t, textOr } from "./texts.js";

export function Card({ title, kind = "", wide = false, children }) {
  return html`<section class=${`card ${kind} ${wide ? "wide" : ""}`}>
    ${title && html`<h2>${title}</h2>`} ${children}
  </section>`;
}

// A button that cannot be pressed twice while its work goes on, nor while the page is stale.
export function Action({ kind = "", run, disabled = false, always = false, children }) {
  const [busy, setBusy] = useState(false);
  const press = async () => {
    setBusy(true);
    try {
      await run();
    } finally {
      setBusy(false);
    }
  };
  return html`<button class=${kind} onClick=${press} disabled=${busy || disabled || (isStale() && !always)}>
    ${children}
  </button>`;
}

export const useNotice = () => useState(null);

export function Notice({ notice, close }) {
  if (!notice) return null;
  return html`<div class=${`notice ${notice.good ? "good" : "bad"}`} role="alert">
    <p><b>${notice.text}</b></p>
    ${notice.hint && html`<p>${notice.hint}</p>`}
    ${close && html`<button class="small" onClick=${close}>${t("page.close")}</button>`}
  </div>`;
}

// Buttons that ask the cell for something; what it answers, or why it refuses, stands below them.
export function Actions({ children }) {
  const [notice, tell] = useNotice();
  const telling = (work, done) => async () => {
    try {
      const answer = await work();
      const text = typeof done === "function" ? done(answer) : done;
      tell(text ? { good: true, text } : null);
    } catch (refused) {
      tell({ text: refused.message, hint: refused.error ? refused.error.hint : t("page.not_sent") });
    }
  };
  return html`<div class="actions">${children(telling)}</div>
    <${Notice} notice=${notice} close=${() => tell(null)} />`;
}

export function Facts({ rows }) {
  return html`<table class="facts"><tbody>
    ${rows.filter(Boolean).map(([name, value, note]) => html`<tr><th scope="row">${name}</th>
      <td>${value}${note && html`<small>${note}</small>`}</td></tr>`)}
  </tbody></table>`;
}

export function Grid({ columns, rows, empty }) {
  if (rows.length === 0) return html`<p class="dim">${empty}</p>`;
  return html`<div class="scroll" tabindex="0" role="region" aria-label=${columns.filter(Boolean).join(", ")}>
    <table class="grid">
      <thead><tr>${columns.map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
      <tbody>${rows.map((row) => html`<tr key=${row.key}>${row.cells.map((cell) => html`<td>${cell}</td>`)}</tr>`)}</tbody>
    </table></div>`;
}

export const Dot = ({ state }) => html`<span class=${`dot ${state}`} aria-hidden="true"></span>`;

export function Verdict({ verdict }) {
  if (!verdict) return html`<span class="dim">–</span>`;
  return html`<span class=${`verdict ${verdict}`}>${t(`verdict.${verdict}`)}</span>`;
}

// Each 95 % uncertainty as a bar against the limit that it was held against.
export function Figures({ figures }) {
  return figures.map(({ name, value, limit }) => {
    const show = name.endsWith("_rad") ? (v) => degrees(v, 4) : (v) => mm(v, 3);
    return html`<div key=${name}>
      <p class="num">${t(`figure.${name}`)}: <b>${show(value)}</b>${limit && ` · ${t("plot.limit")} ${show(limit)}`}</p>
      ${limit && html`<meter min="0" max=${limit * 1.25} high=${limit} value=${value} aria-label=${t(`figure.${name}`)}></meter>`}
    </div>`;
  });
}

// A calibration by its name in the ledger, in words.
export function calibrationName(name) {
  const [kind, owner] = name.split(".");
  const words = textOr(`calibration.${kind}`, kind);
  return owner ? `${words}: ${owner}` : words;
}

// What a path answers; asked again whenever `again` changes, and every `everyMs` when that is given.
export function useGot(path, again = null, everyMs = 0) {
  const [got, setGot] = useState({ content: null, error: null });
  const newest = useRef(path);
  newest.current = path;
  useEffect(() => {
    let over = false;
    const look = () =>
      get(path)
        .then((content) => !over && newest.current === path && setGot({ content, error: null }))
        .catch((error) => !over && setGot((before) => ({ ...before, error })));
    look();
    const timer = everyMs ? setInterval(look, everyMs) : null;
    return () => {
      over = true;
      if (timer) clearInterval(timer);
    };
  }, [path, again, everyMs]);
  return got;
}

export function Loading({ got }) {
  if (got.error) return html`<${Notice} notice=${{ text: got.error.message, hint: got.error.error?.hint }} />`;
  return html`<p class="dim">${t("page.loading")}</p>`;
}
