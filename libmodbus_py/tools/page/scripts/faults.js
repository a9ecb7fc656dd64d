// The faults of the server, on and off, and the choices of its forms.

import { $, made, madeButton, madeOption, replaceButtons } from "./elements.js";
import { post, rowsOf } from "./rows.js";

const settingOf = () => rowsOf("words").get("kinds")[$("fault-kind").value];

function change(path, body) {
  const say = (text) => { $("fault-answer").textContent = text; };
  post(path, body).then(() => say(""), (error) => say(error.message));
}

export function showFaults() {
  const rows = [...rowsOf("faults")].map(([number, { unit, kind, settings, is_on: isOn }]) => {
    const row = made("li", undefined, isOn ? "" : "off");
    const what = made("span");
    what.append(made("span", kind.replaceAll("_", " "), "kind"), " ", made("span", settings, "what"));
    const button = madeButton(isOn ? "on" : "off", () => change("/fault", { number: Number(number), on: !isOn }), "value");
    const where = unit === null ? "every" : `unit ${unit}`;
    button.setAttribute("role", "switch");
    button.setAttribute("aria-checked", String(isOn));
    button.setAttribute("aria-label", `${kind} ${settings}, ${where}`);
    row.append(made("span", where, "where"), what, button);
    return row;
  });
  replaceButtons($("faults"), rows.length ? rows : [made("li", "No faults.", "none")]);
}

export function showKinds() {
  const fill = (id, names) => {
    if ($(id).options.length) return;
    $(id).replaceChildren(...names.map((name) => madeOption(name.replaceAll("_", " "), name)));
  };
  const words = rowsOf("words");
  fill("type", words.get("types"));
  fill("order", words.get("orders"));
  fill("fault-kind", Object.keys(words.get("kinds")));
  showSetting();
}

function showSetting() {
  $("fault-setting-label").hidden = !settingOf();
  $("fault-setting-label").firstElementChild.textContent = settingOf() || "";
}

function number(id) {
  const text = $(id).value.trim();
  return text === "" ? null : Number.isNaN(Number(text)) ? text : Number(text);
}

$("fault-kind").addEventListener("change", showSetting);
$("adding").addEventListener("submit", (event) => {
  event.preventDefault();
  const body = { unit: JSON.parse($("fault-unit").value), kind: $("fault-kind").value,
    function: number("fault-function"), every: number("fault-every") };
  if (settingOf()) body[settingOf()] = number("fault-setting");
  change("/faults", body);
});
