// The page's words in the chosen language. Every text is in texts.json, one entry a text, one key a language.

const STORE = "cellward-language";
let catalogue = {};
let chosen = "en";

export const LANGUAGES = { en: "English", de: "Deutsch" };

export async function loadTexts() {
  catalogue = await (await fetch("/static/texts.json")).json();
  const wanted = localStorage.getItem(STORE) || navigator.language.slice(0, 2);
  chooseLanguage(wanted in LANGUAGES ? wanted : "en");
}

export function language() {
  return chosen;
}

export function chooseLanguage(name) {
  chosen = name;
  localStorage.setItem(STORE, name);
  document.documentElement.lang = name;
}

// The text of a key, with {name} replaced; a key that is in no catalogue is shown as it is.
export function t(key, values = {}) {
  const entry = catalogue[key];
  const text = entry ? entry[chosen] || entry.en : key;
  return text.replace(/\{(\w+)\}/g, (whole, name) => (name in values ? String(values[name]) : whole));
}

// The text of a key that may be missing, as of a job or a register that another package brings.
export function textOr(key, other) {
  return key in catalogue ? t(key) : other;
}
