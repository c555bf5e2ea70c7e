"use strict";
// Puts the plots into the page, lets the keyboard move and zoom them, and paints them anew when the colours change.
(async () => {
  const plots = new Map();
  for (const script of document.querySelectorAll("script[data-plot]")) {
    const target = script.dataset.plot;
    const views = await Bokeh.embed.embed_item(JSON.parse(script.textContent), target);
    plots.set(target, [...views].flatMap(Figures.inside));
  }
  for (const [id, parts] of plots) {
    Figures.prepare(parts);
    document.getElementById(id).addEventListener("keydown", event => {
      if (event.target.id === id) Figures.onKey(event, parts);
    });
  }

  const paint = () => Figures.paint([...plots.values()].flat());
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
