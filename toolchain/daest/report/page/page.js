"use strict";
// Puts the plots into the page, lets the keyboard move and zoom them, and paints them anew when the colours change.
(async () => {
  const coarse = matchMedia("(pointer: coarse)").matches;
  const plots = new Map();
  for (const script of document.querySelectorAll("script[data-plot]")) {
    const target = script.dataset.plot;
    const views = await Bokeh.embed.embed_item(JSON.parse(script.textContent), target);
    plots.set(target, [...views].flatMap(figures));
  }

  function figures(view) {
    const inner = view.child_views ?? [];
    return view.model.type === "Figure" || view.model.type === "Plot" ? [view] : inner.flatMap(figures);
  }

  // Values follow the stretch of time that is shown, so that the curves stay in view.
  const fitted = view => {
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
  };
  for (const views of plots.values()) {
    for (const view of views) {
      if (view.model.name !== "compare") continue;
      view.model.x_range.properties.start.change.connect(() => requestAnimationFrame(() => fitted(view)));
    }
  }

  // A finger that drags over a plot scrolls the page; the tools of the plot's own bar zoom.
  if (coarse) for (const views of plots.values()) for (const view of views) view.model.toolbar.active_drag = null;

  const move = (range, share) => {
    const span = range.end - range.start;
    range.setv({start: range.start + share * span, end: range.end + share * span});
  };
  const zoom = (range, factor) => {
    const middle = (range.start + range.end) / 2, half = (range.end - range.start) / 2 * factor;
    range.setv({start: middle - half, end: middle + half});
  };
  const actions = {
    ArrowLeft: r => move(r.x, -0.1), ArrowRight: r => move(r.x, 0.1),
    ArrowUp: r => move(r.y, 0.1), ArrowDown: r => move(r.y, -0.1),
    "+": r => zoom(r.x, 0.8), "=": r => zoom(r.x, 0.8), "-": r => zoom(r.x, 1.25),
  };
  for (const [id, views] of plots) {
    document.getElementById(id).addEventListener("keydown", event => {
      if (event.target.id !== id || event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === "0") { views.forEach(view => view.reset()); event.preventDefault(); return; }
      if (!(event.key in actions)) return;
      event.preventDefault();
      const seen = new Set();
      for (const {model} of views) {
        const ranges = {x: model.x_range, y: model.y_range};
        if (seen.has(ranges.x) || "factors" in ranges.x || "factors" in ranges.y) continue;
        seen.add(ranges.x);
        actions[event.key](ranges);
      }
    });
  }

  // Axes and text take the colours of the style sheet when they are painted; legends and labels are told.
  const paint = () => {
    const ink = getComputedStyle(document.documentElement).getPropertyValue("--ink").trim();
    for (const {model} of [...plots.values()].flat()) {
      for (const part of [...model.above, ...model.center]) {
        if (part.type === "Legend") part.label_text_color = ink;
        if (part.type === "LabelSet") part.text_color = {value: ink};
      }
    }
    for (const view of [...plots.values()].flat()) view.request_repaint();
  };
  paint();
  for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", paint);
  // Paper shows everything; afterwards the page is as it was.
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    opened.forEach(part => part.open = true);
  });
  addEventListener("afterprint", () => opened.forEach(part => part.open = false));
  document.documentElement.dataset.ready = "true";
})();
