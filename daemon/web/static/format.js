// Numbers for people's eyes: millimetres and degrees with their unit, in the chosen language.

import { language } from "./texts.js";

export function number(value, digits) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = new Intl.NumberFormat(language(), {
    minimumFractionDigits: digits,
    maximumFractionDigits: digits,
  }).format(value);
  return text.replace(/^-(?=[0.,]*$)/, "").replace("-", "−"); // no minus before a zero; a true minus sign
}

// With as many digits as it has, two at most: a limit that somebody has written, if there is one.
export const asWritten = (value) =>
  number(value, value === null ? 0 : [0, 1].find((n) => Math.abs(value - value.toFixed(n)) < 1e-9) ?? 2);

export const mm = (metres, digits = 2) => `${number(metres === null ? null : 1e3 * metres, digits)} mm`;
export const degrees = (radians, digits = 2) =>
  `${number(radians === null ? null : (radians * 180) / Math.PI, digits)}°`;

const SHOWN = { m: [1e3, " mm"], rad: [180 / Math.PI, "°"], s: [1e3, " ms"] };
const USUAL_DIGITS = 3;
const MOST_DIGITS = 7;

// The main figure of a result with its unit, as precise as its uncertainty (95 %) is: two digits of that.
export function figureText({ value, unit, uncertainty }) {
  if (!unit) return number(value, 0);
  const [scale, symbol] = SHOWN[unit] || [1, ` ${unit}`];
  const half = uncertainty === null ? null : scale * uncertainty;
  const digits = half ? Math.max(0, Math.min(MOST_DIGITS, 1 - Math.floor(Math.log10(half)))) : USUAL_DIGITS;
  const text = number(scale * value, digits);
  return half === null ? `${text}${symbol}` : `${text} ± ${number(half, digits)}${symbol}`;
}

// A span of time in the unit that a person would use.
export function span(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 1) return `${number(1e3 * seconds, 0)} ms`;
  if (seconds < 100) return `${number(seconds, seconds < 10 ? 1 : 0)} s`;
  if (seconds < 5400) return `${number(seconds / 60, 0)} min`;
  if (seconds < 172800) return `${number(seconds / 3600, 0)} h`;
  return `${number(seconds / 86400, 0)} d`;
}

// A moment: the time alone when it is today.
export function moment(stamp) {
  if (stamp === null || stamp === undefined) return "–";
  const date = typeof stamp === "number" ? new Date(1e3 * stamp) : new Date(stamp);
  const time = { hour: "2-digit", minute: "2-digit", hourCycle: "h23" };
  const today = date.toDateString() === new Date().toDateString();
  const how = today ? { ...time, second: "2-digit" } : { ...time, year: "numeric", month: "2-digit", day: "2-digit" };
  return new Intl.DateTimeFormat(language(), how).format(date);
}

export function sinceMoment(stamp) {
  const at = typeof stamp === "number" ? 1e3 * stamp : Date.parse(stamp);
  return Math.max(0, (Date.now() - at) / 1e3);
}
