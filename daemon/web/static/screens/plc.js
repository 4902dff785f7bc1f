// PLC: the registers as a PLC reads them, live, and its last commands with what became of them.

import { moment, number } from "../format.js";
import { Card, Grid, Loading, useGot } from "../parts.js";
import { html } from "../vendor/htm-preact.js";
import { t } from "../texts.js";

const LOOK_MS = 500;

export function Plc({ state }) {
  const got = useGot("/api/plc", null, LOOK_MS);
  if (!got.content) return html`<${Loading} got=${got} />`;
  const { registers, commands, served } = got.content;
  const rows = registers.map((register) => ({
    key: register.address,
    cells: [register.address, html`<code>${register.name}</code>`, html`<${Value} register=${register} />`, register.unit || "–", register.type, register.meaning],
  }));
  const columns = ["address", "register", "value", "unit", "type", "meaning"].map((key) => t(`column.${key}`));
  return html`<h1>${t("screen.plc")}</h1>
    <${Card} wide kind=${`state ${state.plc === false ? "wait" : ""}`}>
      <p class="big">${t(!served ? "plc.off" : state.plc === null ? "plc.never" : state.plc ? "plc.alive" : "plc.silent")}</p>
    </${Card}>
    <${Card} wide title=${t("plc.commands")}>
      ${commands.length === 0 && html`<p class="dim">${t("plc.no_commands")}</p>`}
      <ul class="plain">${[...commands].reverse().map((line) => html`<li key=${line.number}><span class="dim num">${moment(line.at)}</span> ${line.who}:
        ${" "}${line.what} <b class=${line.accepted ? "" : "refused"}>${line.accepted ? t("plc.accepted") : t("now.refused")}</b> ${line.detail}</li>`)}</ul>
    </${Card}>
    <${Card} wide title=${t("plc.registers")}><${Grid} columns=${columns} rows=${rows} empty="" />
      <p class="dim">${t("plc.mirror")}</p></${Card}>`;
}

function Value({ register }) {
  const { value, words, bits, type } = register;
  const shown = value === null || value === undefined ? "0" : type === "float32" ? number(value, 6) : value;
  return html`<b class="num">${shown}</b>${words && html`<small>${words}</small>`}
    ${bits && bits.length > 0 && html`<small>${bits.join(" · ")}</small>`}`;
}
