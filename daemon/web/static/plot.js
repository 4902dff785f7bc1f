// A plot as drawing instructions of the page itself: one series, its axes with round numbers, and a limit.

import { number } from "./format.js";
import { html } from "./vendor/htm-preact.js";
import { t } from "./texts.js";

const WIDTH = 520;
const HEIGHT = 190;
const LEFT = 78;
const BOTTOM = 26;
const TOP = 12;
const MOST_POINTS = 400; // drawn; more look the same

// points: [[x, y], ..]; limits: heights that are drawn in; label: of an x in words.
export function Plot({ title, points, limits = [], unit = "", scale = 1, line = false, label = (x) => number(x, 1) }) {
  const step = Math.ceil(points.length / MOST_POINTS);
  const shown = points.filter((_, index) => index % step === 0 || index === points.length - 1);
  const xs = shown.map((point) => point[0]);
  const ys = shown.map((point) => scale * point[1]);
  const bound = limits.map((limit) => scale * limit);
  const [low, high, ticks] = round(Math.min(...ys, ...bound), Math.max(...ys, ...bound));
  const [first, last] = [Math.min(...xs), Math.max(...xs)];
  const x = (value) => LEFT + ((WIDTH - LEFT - 12) * (value - first)) / (last - first || 1);
  const y = (value) => TOP + ((HEIGHT - TOP - BOTTOM) * (high - value)) / (high - low || 1);
  const digits = Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(ticks[1] - ticks[0] || 1))));
  const words = t("plot.about", { title, count: points.length, last: `${number(ys[ys.length - 1], digits)} ${unit}` });
  return html`<figure class="figure">
    <figcaption>${title}${unit && ` (${unit})`}: <b class="num">${number(ys[ys.length - 1], digits)}</b></figcaption>
    <svg class="plot" viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label=${words}>
      ${ticks.map((tick) => html`<path class="axis" d=${`M${LEFT} ${y(tick)}H${WIDTH - 12}`} />
        <text x=${LEFT - 8} y=${y(tick) + 4} text-anchor="end">${number(tick, digits)}</text>`)}
      ${bound.map((limit) => html`<path class="limit" d=${`M${LEFT} ${y(limit)}H${WIDTH - 12}`} />
        <text class="limit-text" x=${WIDTH - 14} y=${y(limit) + (y(limit) < 2 * TOP ? 17 : -6)} text-anchor="end">${t("plot.limit")} ${number(limit, digits)} ${unit}</text>`)}
      ${(line || shown.length > 1) && html`<polyline class="line" points=${shown.map((_, i) => `${x(xs[i]).toFixed(1)},${y(ys[i]).toFixed(1)}`).join(" ")} />`}
      ${!line && shown.map((_, i) => html`<circle class="point" cx=${x(xs[i])} cy=${y(ys[i])} r="4.5" />`)}
      <text x=${LEFT} y=${HEIGHT - 4}>${label(first)}</text>
      ${last > first && html`<text x=${WIDTH - 12} y=${HEIGHT - 4} text-anchor="end">${label(last)}</text>`}
    </svg></figure>`;
}

// Bounds and three to six round ticks that hold everything between low and high.
function round(low, high) {
  if (low === high) [low, high] = low === 0 ? [0, 1] : [low - Math.abs(low) * 0.05, high + Math.abs(high) * 0.05];
  const raw = (high - low) / 3;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= raw) * power;
  const begin = Math.floor(low / step) * step;
  const ticks = [];
  for (let tick = begin; tick < high + step * 0.999; tick += step) ticks.push(Math.round(tick / step) * step);
  return [ticks[0], ticks[ticks.length - 1], ticks];
}
