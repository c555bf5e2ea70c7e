"use strict";
// Bokeh's figures in a page, in the report as in the live page: the keyboard moves and zooms them, curves stay in view,
// colours are those of the style sheet.
const Figures = (() => {
  // The figures inside a view, which may be a layout of several.
  function inside(view) {
    const inner = view.child_views ?? [];
    return view.model.type === "Figure" || view.model.type === "Plot" ? [view] : inner.flatMap(inside);
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

  // A finger that drags over a plot scrolls the page; the tools of the plot's own bar zoom.
  function prepare(parts) {
    if (matchMedia("(pointer: coarse)").matches) for (const part of parts) part.model.toolbar.active_drag = null;
    for (const part of parts) {
      if (part.model.name !== "compare") continue;
      part.model.x_range.properties.start.change.connect(() => requestAnimationFrame(() => fitted(part)));
    }
  }

  const move = (range, share) => {
    const span = range.end - range.start;
    range.setv({start: range.start + share * span, end: range.end + share * span});
  };
  const zoom = (range, factor) => {
    const middle = (range.start + range.end) / 2, half = (range.end - range.start) / 2 * factor;
    range.setv({start: middle - half, end: middle + half});
  };
  const KEYS = {
    ArrowLeft: r => move(r.x, -0.1), ArrowRight: r => move(r.x, 0.1),
    ArrowUp: r => move(r.y, 0.1), ArrowDown: r => move(r.y, -0.1),
    "+": r => zoom(r.x, 0.8), "=": r => zoom(r.x, 0.8), "-": r => zoom(r.x, 1.25),
  };

  // What a key does to figures; ranges that they share are moved once.
  function onKey(event, parts) {
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

  // Axes and text take the colours of the style sheet when they are painted; legends and labels are told.
  function paint(parts) {
    const ink = getComputedStyle(document.documentElement).getPropertyValue("--ink").trim();
    for (const part of parts) {
      for (const piece of [...part.model.above, ...part.model.center]) {
        if (piece.type === "Legend") piece.label_text_color = ink;
        if (piece.type === "LabelSet") piece.text_color = {value: ink};
      }
    }
    for (const part of parts) part.request_repaint?.();
  }

  return {inside, prepare, onKey, paint};
})();
