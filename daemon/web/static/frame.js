// What is on every screen: whose cell it is, the twin's banner, the age of the last word, and Stop run.

import { ask, cell, isStale, logout, may, silentFor } from "./cell.js";
import { span } from "./format.js";
import { Action, Notice, useNotice } from "./parts.js";
import { html } from "./vendor/htm-preact.js";
import { chooseLanguage, language, LANGUAGES, t } from "./texts.js";

export function Frame({ screen, screens = [], children }) {
  const status = cell.state && cell.state.status;
  return html`
    <a class="skip" href="#main" onClick=${toMain}>${t("page.skip")}</a>
    <header>
      <a class="cell" href="#now">${status ? status.cell : "Cellward"}</a>
      ${status && status.twin && html`<span class="twin">${t("page.twin")}</span>`}
      <span class="space"></span>
      <${Age} />
      <${User} screen=${screen} />
      ${status && html`<${Stop} running=${status.job !== null || programStarts(status)} />`}
      ${screens.length > 0 &&
      html`<nav aria-label=${t("page.screens")}>
        ${screens.map(
          (name) => html`<a href=${`#${name}`} aria-current=${name === screen ? "page" : undefined}>${t(`screen.${name}`)}</a>`,
        )}
      </nav>`}
    </header>
    <main id="main" tabindex="-1">${children}</main>
    <footer>
      <span>${t("page.no_safety")}</span>
      <span class="space"></span>
      ${cell.state && html`<span>Cellward ${cell.state.version}</span>`}
      <label>${t("page.language")}
        <select onChange=${(event) => (chooseLanguage(event.target.value), cell.changed())}>
          ${Object.entries(LANGUAGES).map(
            ([key, name]) => html`<option value=${key} selected=${key === language()}>${name}</option>`,
          )}
        </select>
      </label>
    </footer>`;
}

// The arm's own program is being started after a check that it asked for: Stop run keeps it from starting.
const programStarts = ({ program_start: told }) => Boolean(told) && told.state === "starting";

function toMain(event) {
  event.preventDefault(); // "#main" is no screen
  document.getElementById("main").focus();
}

// How long ago the daemon spoke: "now" while it speaks every second.
function Age() {
  if (cell.state === null) return null;
  const stale = isStale();
  const words = stale ? t("page.no_news", { age: span(silentFor()) }) : t("page.live");
  return html`<span class=${stale ? "age bad" : "age"} role="status">${words}</span>`;
}

function User({ screen }) {
  const me = cell.me;
  if (me && me.user) {
    return html`<span class="user">${me.user}, ${t(`role.${me.role}`)}</span>
      <button class="small" onClick=${() => logout().catch(() => {})}>${t("login.out")}</button>`;
  }
  return screen === "login" ? null : html`<a class="button small" href="#login">${t("login.in")}</a>`;
}

// One click, no question. It is offered even while the page is grey: the request may still get through.
function Stop({ running }) {
  const [notice, tell] = useNotice();
  const stop = async () => {
    try {
      await ask("halt");
      tell(null);
    } catch (refused) {
      tell({ text: refused.error ? refused.message : t("stop.not_sent"), hint: t("stop.use_hardware") });
    }
  };
  return html`<${Action} kind="stop" run=${stop} disabled=${!running || !may("viewer")} always
      >${t("stop.run")}<small>${t("stop.not_emergency")}</small></${Action}>
    <${Notice} notice=${notice} close=${() => tell(null)} />`;
}
