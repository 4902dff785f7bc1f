// Trends: every health number over its runs, in the unit of people.

import { moment } from "../format.js";
import { Card, Loading, useGot } from "../parts.js";
import { Plot } from "../plot.js";
import { html } from "../vendor/htm-preact.js";
import { t, textOr } from "../texts.js";

export function Trends({ state }) {
  const got = useGot("/api/trends", state.status.run_id);
  if (!got.content) return html`<${Loading} got=${got} />`;
  const names = Object.keys(got.content);
  return html`<h1>${t("screen.trends")}</h1>
    ${names.length === 0 && html`<${Card} wide><p>${t("trends.none")}</p></${Card}>`}
    ${names.map((name) => html`<${Trend} key=${name} name=${name} points=${got.content[name]} />`)}`;
}

function Trend({ name, points }) {
  const owner = name.split(".").pop();
  const kind = name.slice(0, -owner.length - 1);
  const [unit, scale] = unitOf(kind);
  const title = `${textOr(`trend.${kind.replace(/\W/g, "_")}`, kind)}: ${owner}`;
  return html`<${Card} title=${title}>
    <${Plot} title=${t("trends.points", { count: points.length })} points=${points} unit=${unit} scale=${scale} label=${moment} />
  </${Card}>`;
}

function unitOf(kind) {
  if (kind.endsWith("_s")) return ["ms", 1e3];
  if (kind.endsWith("_m")) return ["mm", 1e3];
  if (kind.endsWith("_rad")) return ["°", 180 / Math.PI];
  return ["", 1];
}
