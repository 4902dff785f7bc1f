// Cell: for who looks after it. Devices, findings of the configuration, who may write what, and the log.

import { cell } from "../cell.js";
import { moment, span } from "../format.js";
import { Card, Dot, Facts, Grid, Loading, useGot } from "../parts.js";
import { html } from "../vendor/htm-preact.js";
import { t } from "../texts.js";
import { deviceState } from "./now.js";

const LOG_MS = 2000;

export function CellScreen({ state }) {
  const got = useGot("/api/cell");
  if (!got.content) return html`<${Loading} got=${got} />`;
  const about = got.content;
  return html`<h1>${t("cell.title", { cell: state.status.cell })}</h1>
    <${Devices} devices=${state.status.devices} roles=${about.roles} />
    <${Findings} about=${about} />
    <${Writers} writers=${about.writers} />
    <${Card} title=${t("cell.software")}><${Facts} rows=${[
      [t("cell.version"), state.version],
      [t("cell.config"), about.config],
      [t("cell.checksum"), about.checksum],
      [t("cell.lag"), span(state.status.loop_lag.max_s), t("cell.lag_about")],
      [t("cell.disk"), `${(state.status.disk.free_bytes / 1e9).toFixed(1)} GB`],
    ]} /></${Card}>
    ${cell.me && cell.me.user ? html`<${Log} />` : html`<${Card} wide><p class="dim">${t("cell.log_login")}</p></${Card}>`}`;
}

function Devices({ devices, roles }) {
  const played = (name) => Object.entries(roles).filter(([, device]) => device === name).map(([role]) => role).join(", ");
  const rows = Object.entries(devices).map(([name, device]) => ({
    key: name,
    cells: [
      html`<${Dot} state=${deviceState(device)} />${name}`,
      html`${t(`device.${device.state}`)}${device.error && html`<small>${device.error}</small>`}`,
      played(name) || "–",
      device.model || "–",
      device.serial || "–",
      device.age_s === undefined || device.age_s === null ? "–" : span(device.age_s),
      device.losses,
    ],
  }));
  const columns = ["device", "state", "role", "model", "serial", "age", "losses"].map((key) => t(`column.${key}`));
  return html`<${Card} wide title=${t("now.devices")}><${Grid} columns=${columns} rows=${rows} empty=${t("now.no_devices")} /></${Card}>`;
}

function Findings({ about }) {
  const found = [...about.problems, ...about.warnings];
  return html`<${Card} title=${t("cell.findings")}>
    ${found.length === 0
      ? html`<p>${t("cell.no_findings")}</p>`
      : html`<ul class="plain">${found.map((text) => html`<li>${text}</li>`)}</ul>`}
    <p class="dim">${t("cell.check")}</p>
  </${Card}>`;
}

function Writers({ writers }) {
  const users = Object.entries(writers.users).map(([name, role]) => `${name} (${t(`role.${role}`)})`);
  const clients = writers.modbus_write ? writers.modbus_clients.join(", ") || t("cell.nobody") : t("cell.nobody");
  return html`<${Card} title=${t("cell.writers")}><${Facts} rows=${[
    [t("cell.by_page"), users.join(", ") || t("cell.nobody"), writers.page],
    [t("cell.by_line"), t("cell.by_line_who"), writers.socket],
    [t("cell.by_plc"), clients, writers.modbus || t("cell.off")],
    [t("cell.look"), t(writers.look_without_login ? "cell.look_all" : "cell.look_users")],
  ]} /></${Card}>`;
}

function Log() {
  const got = useGot("/api/log", null, LOG_MS);
  const lines = (got.content || []).slice(-200).reverse();
  return html`<${Card} wide title=${t("cell.log")}>
    <div class="scroll tall" tabindex="0" role="region" aria-label=${t("cell.log")}>
      <ul class="plain log">${lines.map((line) => html`<li class=${line.level}><span class="dim num">${moment(line.at)}</span>
        ${" "}<b>${line.level}</b> ${line.text} <span class="dim">${line.logger}</span></li>`)}</ul></div>
  </${Card}>`;
}
