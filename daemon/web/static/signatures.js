// Who signed the record of a run, and whether it is still what was signed.

import { ask, may } from "./cell.js";
import { moment } from "./format.js";
import { Action, Actions, Card, Loading, useGot } from "./parts.js";
import { html, useState } from "./vendor/htm-preact.js";
import { t, textOr } from "./texts.js";

const SHOWN = 16; // letters of a digest; the report and the bundle have all of them

const ROLES = ["measured", "checked", "approved"]; // those have lines in the report
const shortDigest = (digest) => `${digest.slice(0, SHOWN)}…`;

export function Signature({ signature }) {
  const { name, role, at, digest, remark, changed } = signature;
  const as = role && textOr(`signs.${role}`, role);
  return html`<p>${name !== null && t("sign.by", { name, role: as, at: moment(at), digest: shortDigest(digest) })}
    ${remark && html`<small>${remark}</small>`}
    ${changed.length > 0 && html`<b class="refused"> ${t(name === null ? "sign.unreadable" : "sign.changed")}: ${changed.join("; ")}</b>`}</p>`;
}

// What was signed so far, and the form by which an integrator signs what stands here now.
export function Signatures({ run }) {
  const [count, again] = useState(0);
  const got = useGot(`/api/runs/${run}/record`, count);
  const record = got.content;
  return html`<${Card} wide title=${t("sign.title")}>
    ${!record && html`<${Loading} got=${got} />`}
    ${record && html`
      ${record.signatures.length === 0 && html`<p>${t("sign.nobody")}</p>`}
      ${record.signatures.map((one) => html`<${Signature} signature=${one} />`)}
      <p class="dim">${t("sign.record", { files: record.files })} <code>${record.digest}</code></p>
      <${Form} run=${run} digest=${record.digest} again=${() => again((n) => n + 1)} />`}
  </${Card}>`;
}

function Form({ run, digest, again }) {
  const [name, setName] = useState("");
  const [role, setRole] = useState(ROLES[0]);
  const [remark, setRemark] = useState("");
  if (!may("integrator")) return html`<p class="dim">${t("login.needs", { role: t("role.integrator") })}</p>`;
  const sign = async () => {
    try {
      return await ask("sign", { run_id: Number(run), digest, name: name.trim(), role, remark: remark.trim() });
    } finally {
      again(); // refused as the record is another one, too
    }
  };
  return html`<p>${t("sign.means")}</p>
    <label>${t("sign.name")} <input maxlength="80" autocomplete="name" value=${name} onInput=${(event) => setName(event.target.value)} /></label>
    <label>${t("sign.as")} <select onChange=${(event) => setRole(event.target.value)}>
      ${ROLES.map((each) => html`<option value=${each} selected=${each === role}>${t(`signs.${each}`)}</option>`)}</select></label>
    <label>${t("sign.remark")} <input maxlength="500" value=${remark} onInput=${(event) => setRemark(event.target.value)} /></label>
    <${Actions}>${(telling) => html`<${Action} kind="go" disabled=${!name.trim()}
      run=${telling(sign, t("sign.done"))}>${t("sign.do")}</${Action}>`}</${Actions}>`;
}
