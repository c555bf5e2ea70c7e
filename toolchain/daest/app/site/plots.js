// Plots in the page: made once, taken away when they are replaced, moved by the keyboard.
import {h} from "./dom.js";

const views = new Map();

export async function draw(place, plots) {
  for (const old of [...views.keys()]) if (old === place || !old.isConnected) clear(old);
  const own = [];
  views.set(place, own);
  for (const plot of plots) {
    const target = h("div", {className: "plot", id: plot.id, tabIndex: 0, role: "group", "aria-label": plot.label});
    place.append(h("figure", {className: "plot-frame"}, target,
      h("figcaption", {}, `${plot.label}.${plot.note ? " " + plot.note : ""}`)));
    const manager = await Bokeh.embed.embed_item(JSON.parse(plot.item), plot.id);
    const parts = [...manager].flatMap(Figures.inside);
    own.push({id: plot.id, manager, parts});
    Figures.prepare(parts);
    target.addEventListener("keydown", event => Figures.onKey(event, parts));
  }
  paint();
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

// The figures of the first plot, from above.
export function figuresOf(place) {
  return (views.get(place) ?? [])[0]?.parts ?? [];
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

export const paint = () => Figures.paint([...views.values()].flat().flatMap(entry => entry.parts));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
