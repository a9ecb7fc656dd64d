// The elements of the page; text is always set as text, never as HTML.

export const $ = (id) => document.getElementById(id);

export function made(name, text, className) {
  const element = document.createElement(name);
  if (text !== undefined) element.textContent = text;
  if (className) element.className = className;
  return element;
}

export function madeButton(text, press, className) {
  const button = made("button", text, className);
  button.type = "button";
  if (press) button.addEventListener("click", press);
  return button;
}

export function madeOption(text, value) {
  const option = made("option", text);
  option.value = value;
  return option;
}

// A name and a value of a list at the head or the foot of the page.
export function figure(name, value, className) {
  const row = made("div", undefined, className);
  row.append(made("dt", name.replaceAll("_", " ")), made("dd", value.toLocaleString("en")));
  return row;
}

// The focus stays where it was, on the button with the same number.
export function replaceButtons(parent, elements) {
  const at = [...parent.querySelectorAll("button")].indexOf(document.activeElement);
  parent.replaceChildren(...elements);
  if (at >= 0) parent.querySelectorAll("button")[at]?.focus();
}

export function clock(seconds) {
  return new Date(seconds * 1000).toLocaleTimeString([], { hour12: false });
}

const calm = matchMedia("(prefers-reduced-motion: reduce)");
const glowing = new WeakMap();

export function glow(element) {
  if (calm.matches) return;
  const before = glowing.get(element);
  if (before) {
    before.currentTime = 0;  // one animation for each element, however often it changes
    before.play();
    return;
  }
  const color = getComputedStyle(document.documentElement).getPropertyValue("--glow");
  glowing.set(element, element.animate([{ backgroundColor: color }, {}], { duration: 1000, easing: "ease-out" }));
}

// --- drawings ------------------------------------------------------------------------------------

const SVG = "http://www.w3.org/2000/svg";
const TOP = 20;  // the highest level of a sparkline

export function drawn(name, attributes = {}) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

export function sparkline() {
  const svg = drawn("svg", { viewBox: `0 -1 60 ${TOP + 2}`, preserveAspectRatio: "none", "aria-hidden": "true" });
  svg.append(drawn("path"));
  return svg;
}

// Levels from 0 to 20, and -1 for gaps.
export function fillSpark(svg, levels) {
  const first = 60 - levels.length;
  let path = "";
  levels.forEach((level, at) => {
    if (level < 0) return;
    const isNew = at === 0 || levels[at - 1] < 0;
    path += `${isNew ? "M" : "L"}${first + at + 0.5} ${TOP - level}`;
    if (isNew && (at + 1 === levels.length || levels[at + 1] < 0)) path += "h.01";
  });
  svg.firstChild.setAttribute("d", path);
}
