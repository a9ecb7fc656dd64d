// The elements of the page; text is always set as text, never as HTML.

export const $ = (id) => document.getElementById(id);

export function made(name, text, className) {
  const element = document.createElement(name);
  if (text !== undefined) element.textContent = text;
  if (className) element.className = className;
  return element;
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
    before.currentTime = 0;  // one for each, however often it changes
    before.play();
    return;
  }
  const color = getComputedStyle(document.documentElement).getPropertyValue("--glow");
  glowing.set(element, element.animate([{ backgroundColor: color }, {}], { duration: 1000, easing: "ease-out" }));
}
