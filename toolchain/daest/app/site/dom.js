// Elements from names and texts. Texts of files become text, never markup.
export function h(tag, props = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(props)) {
    if (value === undefined || value === null || value === false) continue;
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key === "style") for (const [name, part] of Object.entries(value)) made.style.setProperty(name, part);
    else if (key in made && key !== "list" && !key.startsWith("aria")) made[key] = value;
    else made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.flat(Infinity).filter(child => child !== null && child !== undefined && child !== false));
  return made;
}

export function svg(tag, props = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(props)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// Puts content into a place if it is not what stands there, and gives the focus back to what had it.
const shown = new WeakMap();
export function put(place, key, make) {
  const text = JSON.stringify(key);
  if (shown.get(place) === text) return false;
  shown.set(place, text);
  const focused = place.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  const opened = new Set([...place.querySelectorAll("details[open][data-key]")].map(part => part.dataset.key));
  place.replaceChildren(...[make()].flat(Infinity).filter(Boolean));
  for (const part of place.querySelectorAll("details[data-key]")) if (opened.has(part.dataset.key)) part.open = true;
  if (focused) place.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
  return true;
}

export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = Number(value).toPrecision(digits);
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) return Number(value).toExponential(digits - 1).replace(/\.?0+e/, "e").replace("-", "−");
  if (text.includes("e")) return String(Number(text)).replace(/^-/, "−"); // 1.0e+2
  return (text.includes(".") ? text.replace(/\.?0+$/, "") : String(Number(text))).replace(/^-/, "−");
}

export function withUnit(value, unit, digits = 3) {
  return unit && unit !== "1" ? `${number(value, digits)} ${unit}` : number(value, digits);
}

// Arrows of the command line, which a line could end within.
export const arrows = text => (text ?? "").replaceAll("->", "→");

export const COLORS = ["#2b7fc4", "#cf5f12", "#2c8c64", "#a066c4", "#9a7b12", "#7d8590"];
