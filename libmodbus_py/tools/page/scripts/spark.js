// Sparklines: levels from 0 to 20, and -1 for gaps.

const SVG = "http://www.w3.org/2000/svg";
const TOP = 20;

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
