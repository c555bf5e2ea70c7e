// Plots in the page: made once, taken away when they are replaced, moved by the keyboard.
import {h} from "./dom.js";

const views = new Map();

function figures(view) {
  const inner = view.child_views ?? [];
  return view.model.type === "Figure" || view.model.type === "Plot" ? [view] : inner.flatMap(figures);
}

export async function draw(place, plots) {
  clear(place);
  const own = [];
  views.set(place, own);
  for (const plot of plots) {
    const target = h("div", {className: "plot", id: plot.id, tabIndex: 0, role: "group", "aria-label": plot.label});
    place.append(h("figure", {className: "plot-frame"}, target,
      h("figcaption", {}, `${plot.label}.${plot.note ? " " + plot.note : ""}`)));
    const manager = await Bokeh.embed.embed_item(JSON.parse(plot.item), plot.id);
    const parts = [...manager].flatMap(figures);
    own.push({id: plot.id, manager, parts});
    if (matchMedia("(pointer: coarse)").matches) for (const part of parts) part.model.toolbar.active_drag = null;
    for (const part of parts) {
      if (part.model.name !== "compare") continue;
      part.model.x_range.properties.start.change.connect(() => requestAnimationFrame(() => fitted(part)));
    }
    target.addEventListener("keydown", event => moved(event, parts));
  }
  paint();
}

// Values follow the stretch of time that is shown, so that the curves stay in view.
function fitted(view) {
  const {x_range, y_range} = view.model;
  let low = Infinity, high = -Infinity;
  for (const {data_source, glyph, visible} of view.model.renderers) {
    const x = data_source?.data?.[glyph?.x?.field], y = data_source?.data?.[glyph?.y?.field];
    if (!visible || !x || !y || typeof x[0] !== "number") continue;
    for (let i = 0; i < x.length; i++) {
      if (x[i] < x_range.start || x[i] > x_range.end || !Number.isFinite(y[i])) continue;
      low = Math.min(low, y[i]);
      high = Math.max(high, y[i]);
    }
  }
  const margin = 0.06 * (high - low) || Math.abs(high) || 1;
  if (low <= high) y_range.setv({start: low - margin, end: high + margin});
}

export function clear(place) {
  for (const {manager} of views.get(place) ?? []) {
    for (const view of [...manager]) {
      const held = view.model.document;
      view.remove();
      const at = Bokeh.documents.indexOf(held);
      if (at >= 0) Bokeh.documents.splice(at, 1);
      held?.clear();
    }
  }
  views.delete(place);
  place.replaceChildren();
}

export function source(place, name) {
  for (const {parts} of views.get(place) ?? []) {
    for (const part of parts) {
      const found = part.model.document?.get_model_by_name(name);
      if (found) return found;
    }
  }
  return null;
}

export function figureOf(place) {
  return (views.get(place) ?? [])[0]?.parts[0] ?? null;
}

// Shows the stretch of time [s] in every figure of a plot; the ranges are linked.
export function zoom(place, id, low, high) {
  const found = (views.get(place) ?? []).find(entry => entry.id === id);
  if (!found) return;
  const range = found.parts[0].model.x_range, margin = 0.1 * (high - low);
  range.setv({start: low - margin, end: high + margin});
  document.getElementById(id).scrollIntoView({block: "nearest"});
}

export function reset(place) {
  for (const {parts} of views.get(place) ?? []) parts.forEach(part => part.reset());
}

const shift = (range, share) => {
  const span = range.end - range.start;
  range.setv({start: range.start + share * span, end: range.end + share * span});
};
const scale = (range, factor) => {
  const middle = (range.start + range.end) / 2, half = (range.end - range.start) / 2 * factor;
  range.setv({start: middle - half, end: middle + half});
};
const KEYS = {
  ArrowLeft: r => shift(r.x, -0.1), ArrowRight: r => shift(r.x, 0.1),
  ArrowUp: r => shift(r.y, 0.1), ArrowDown: r => shift(r.y, -0.1),
  "+": r => scale(r.x, 0.8), "=": r => scale(r.x, 0.8), "-": r => scale(r.x, 1.25),
};

function moved(event, parts) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "0") { parts.forEach(part => part.reset()); event.preventDefault(); return; }
  if (!(event.key in KEYS)) return;
  event.preventDefault();
  const seen = new Set();
  for (const {model} of parts) {
    const ranges = {x: model.x_range, y: model.y_range};
    if (seen.has(ranges.x) || "factors" in ranges.x || "factors" in ranges.y) continue;
    seen.add(ranges.x);
    KEYS[event.key](ranges);
  }
}

// Axes take the colours of the style sheet when they are painted; legends are told.
export function paint() {
  const ink = getComputedStyle(document.documentElement).getPropertyValue("--ink").trim();
  for (const part of [...views.values()].flat().flatMap(entry => entry.parts)) {
    for (const piece of [...part.model.above, ...part.model.center]) {
      if (piece.type === "Legend") piece.label_text_color = ink;
      if (piece.type === "LabelSet") piece.text_color = {value: ink};
    }
    part.request_repaint?.();
  }
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
