// Who signed the record of a run, and whether it is still what was signed.

import { moment } from "./format.js";
import { html } from "./vendor/htm-preact.js";
import { t, textOr } from "./texts.js";

const SHOWN = 16; // letters of a digest; the report and the bundle have all of them

export const shortDigest = (digest) => `${digest.slice(0, SHOWN)}…`;

export function Signature({ signature }) {
  const { name, role, at, digest, remark, changed } = signature;
  const as = role && textOr(`signs.${role}`, role);
  return html`<p>${name !== null && t("sign.by", { name, role: as, at: moment(at), digest: shortDigest(digest) })}
    ${remark && html`<small>${remark}</small>`}
    ${changed.length > 0 && html`<b class="refused"> ${t(name === null ? "sign.unreadable" : "sign.changed")}: ${changed.join("; ")}</b>`}</p>`;
}
