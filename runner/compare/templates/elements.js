// Elements of the pages. Nothing parses a text as HTML: values are text nodes.

// Control characters, overrides of the direction and separators of lines, as escapes.
const HIDDEN =
  /[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]/g;

function visible(text) {
  return String(text).toWellFormed().replace(HIDDEN, (letter) =>
    `\\u${letter.charCodeAt(0).toString(16).padStart(4, "0")}`);
}

// Give an element attributes and children; functions become listeners, null leaves out.
function fill(made, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") made.addEventListener(key, value);
    else made.setAttribute(key, value === true ? "" : visible(value));
  }
  const flat = children.flat(Infinity).filter((child) => child !== null && child !== undefined);
  made.append(...flat.map((child) => (child instanceof Node ? child : visible(child))));
  return made;
}

function element(name, attributes = {}, ...children) {
  return fill(document.createElement(name), attributes, children);
}

function svg(name, attributes = {}, ...children) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);
}

// A drop-down list of pairs of a value and its text.
function choice(id, label, pairs, current, change) {
  const options = pairs.map(([value, text]) => element("option", { value, selected: value === current }, text));
  return element("label", {}, label,
    element("select", { id, change: (event) => change(event.target.value) }, options));
}
