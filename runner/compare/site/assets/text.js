"use strict";
// Texts and elements. Nothing here, or elsewhere, parses a text as HTML: values are text nodes.

// Control characters, overrides of the direction and separators of lines, as escapes.
const HIDDEN =
  /[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]/g;

function visible(text) {
  return String(text).toWellFormed().replace(HIDDEN, (letter) =>
    `\\u${letter.charCodeAt(0).toString(16).padStart(4, "0")}`);
}

// An element with attributes and children; functions become listeners, null leaves out.
function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") made.addEventListener(key, value);
    else made.setAttribute(key, value === true ? "" : visible(value));
  }
  const flat = children.flat(Infinity).filter((child) => child !== null && child !== undefined);
  made.append(...flat.map((child) => (child instanceof Node ? child : visible(child))));
  return made;
}

// A number with significant digits, as the tables of the command line write it.
function numberText(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "nan";
  if (!Number.isFinite(value)) return value > 0 ? "inf" : "-inf";
  if (value === 0) return "0";
  const size = Number(value.toExponential(digits - 1).split("e")[1]);
  if (size < -4 || size >= 6) {
    return value.toExponential(digits - 1).replace(/e([+-])(\d)$/, "e$10$2");
  }
  return fixed(value, Math.max(0, digits - 1 - size));
}

// Fixed decimals; halves go to the even digit.
function fixed(value, decimals) {
  const exact = Math.abs(value).toFixed(Math.min(100, decimals + 40));
  const [whole, part = ""] = exact.split(".");
  const half = /^50*$/.test(part.slice(decimals));
  const kept = decimals ? `${whole}.${part.slice(0, decimals)}` : whole;
  if (!half) return value.toFixed(decimals);
  const even = Number(kept.at(-1)) % 2 === 0;
  return even ? (value < 0 ? `-${kept}` : kept) : value.toFixed(decimals);
}

function unitText(unit) {
  if (!unit || unit === "1" || unit === "-") return "";
  return unit.replaceAll("^2", "²").replaceAll("^3", "³").replaceAll("^-1", "⁻¹")
    .replaceAll("^-2", "⁻²").replaceAll("*", "·");
}

function withUnit(name, unit) {
  const shown = unitText(unit);
  return shown ? `${name} [${shown}]` : name;
}

// A name in words: duration_s becomes Duration [s]; dotted names of the configuration stay.
function inWords(name) {
  return name.includes(".") || !name ? name : name[0].toUpperCase() + name.slice(1).replace(/_s$/, " [s]").replaceAll("_", " ");
}

function plural(count, noun) {
  return `${count.toLocaleString("en")} ${noun}${count === 1 ? "" : "s"}`;
}

// A word as a POSIX shell takes it literally.
function shellQuoted(word) {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'"'"'`)}'`;
}
