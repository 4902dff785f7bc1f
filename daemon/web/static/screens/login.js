// Log in with a token. Who may look without one can go back to the cell.

import { cell, login } from "../cell.js";
import { Card, Notice, useNotice } from "../parts.js";
import { html, useState } from "../vendor/htm-preact.js";
import { t } from "../texts.js";

export function Login() {
  const [notice, tell] = useNotice();
  const [token, setToken] = useState("");
  const send = async (event) => {
    event.preventDefault();
    try {
      await login(token);
      location.hash = "#now";
    } catch (refused) {
      tell({ text: refused.message, hint: refused.error ? refused.error.hint : t("page.not_sent") });
    }
  };
  if (cell.me && !cell.me.users) {
    return html`<h1>${t("login.title")}</h1><${Card} wide><p>${t("login.no_users")}</p>
      <pre>cellward token NAME --role operator</pre></${Card}>`;
  }
  return html`<h1>${t("login.title")}</h1><${Card} wide>
    <p>${t("login.about")}</p>
    <form onSubmit=${send}>
      <label>${t("login.token")}
        <input type="password" autocomplete="current-password" autocapitalize="characters" spellcheck="false"
          required maxlength="64" value=${token} onInput=${(event) => setToken(event.target.value)} /></label>
      <button class="go">${t("login.in")}</button>
    </form>
    <${Notice} notice=${notice} />
    ${cell.me && cell.me.look && html`<p><a href="#now">${t("login.only_look")}</a></p>`}
  </${Card}>`;
}
