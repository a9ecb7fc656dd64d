// The elements of the page; text is always set as text, never as HTML.

export const $ = (id) => document.getElementById(id);

export function made(name, text, className) {
  const element = document.createElement(name);
  if (text !== undefined) element.textContent = text;
  if (className) element.className = className;
  return element;
}

// An element as a cell of a table; a button stays a button, within the cell.
export function asCell(child, role = "cell") {
  const cell = child.tagName === "BUTTON" ? made("span", undefined, "cell") : child;
  cell.setAttribute("role", role);
  if (cell !== child) cell.append(child);
  return cell;
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
