// Teach: read where the arm stands, name it, and copy the line for cell.toml. Nothing is written, nothing moves.

import { degrees, number } from "../format.js";
import { Card, Facts, Loading, useGot } from "../parts.js";
import { html, useState } from "../vendor/htm-preact.js";
import { t } from "../texts.js";

const LOOK_MS = 500;

export function Teach() {
  const got = useGot("/api/joints", null, LOOK_MS);
  const [name, setName] = useState("home");
  const [held, hold] = useState(null);
  const [copied, setCopied] = useState(false);
  if (!got.content || got.error) return html`<h1>${t("screen.teach")}</h1><${Card} wide><${Loading} got=${got} /></${Card}>`;
  const shown = held || got.content.q;
  const line = `${name || "name"} = [${shown.map((value) => value.toFixed(6)).join(", ")}]`;
  const copy = async () => {
    await navigator.clipboard.writeText(line);
    setCopied(true);
  };
  return html`<h1>${t("screen.teach")}</h1>
    <${Card} title=${t("teach.where")}>
      <p>${t(got.content.moving ? "teach.moves" : "teach.stands")}</p>
      <${Facts} rows=${got.content.q.map((value, index) => [t("teach.joint", { number: index + 1 }), `${degrees(value, 3)} · ${number(value, 5)} rad`])} />
    </${Card}>
    <${Card} title=${t("teach.line")}>
      <p>${t("teach.about")}</p>
      <label>${t("teach.name")} <input value=${name} maxlength="40" pattern="[A-Za-z0-9_-]+"
        onInput=${(event) => setName(event.target.value.replace(/[^A-Za-z0-9_-]/g, "_"))} /></label>
      <div class="actions">
        <button class="go" disabled=${got.content.moving} onClick=${() => { hold(got.content.q); setCopied(false); }}>${t("teach.read")}</button>
        <button onClick=${copy} disabled=${!navigator.clipboard}>${t("teach.copy")}</button>
      </div>
      <pre tabindex="0">[poses]${"\n"}${line}</pre>
      ${copied && html`<p role="status">${t("teach.copied")}</p>`}
      <p class="dim">${t("teach.not_written")}</p>
    </${Card}>`;
}
