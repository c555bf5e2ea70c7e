// Compare: measured against model, over time, with where the model fails.
import {h, put, number, withUnit, COLORS} from "./dom.js";
import {draw, zoom, reset} from "./plots.js";

let drawn = null;

export function view(place, state, page) {
  if (!place.firstChild) place.append(h("div"), h("div", {className: "pictures"}));
  const [words, pictures] = place.children, found = state.comparison;
  put(words, [found, state.commands, Boolean(page.running()), Boolean(state.project)], () => {
    if (!state.project) return h("p", {}, "There is no project yet: ", h("a", {href: "#start"}, "Start"), " sets one up.");
    if (!found) return [h("p", {className: "missing"}, "Nothing has been compared yet."), page.button("Fit and compare", {action: "identify"}, {strong: true})];
    return [table(found), fails(found, pictures),
      h("div", {className: "row"}, page.button("Fit and compare again", {action: "identify"}),
        h("button", {"data-key": "whole", onclick: () => reset(pictures)}, "Show all"))];
  });
  const version = JSON.stringify(found ?? null);
  if (version !== drawn) { drawn = version; show(pictures, version, Boolean(found)); }
}

async function show(pictures, version, is_there) {
  if (is_there && !pictures.firstChild) pictures.append(h("p", {className: "missing", role: "status"}, "Drawing …"));
  const answer = is_there ? await fetch("api/pictures").catch(() => null) : null;
  const plots = answer?.ok ? (await answer.json()).plots : [];
  if (version !== drawn) return;
  await draw(pictures, plots);
  pictures.dataset.drawn = String(plots.length);
}

function table(found) {
  const outputs = Object.entries(found.outputs);
  return h("div", {className: "scroll", tabIndex: 0, role: "region", "aria-label": "Errors"}, h("table", {},
    h("thead", {}, h("tr", {}, h("th", {scope: "col"}, "model"), outputs.flatMap(([name, unit]) => [h("th", {scope: "col", className: "n"}, `error of ${name} [${unit || "1"}]`), h("th", {scope: "col", className: "n"}, "fit %")]), h("th", {scope: "col"}, "the data"))),
    h("tbody", {}, found.models.map((model, i) => h("tr", {}, h("th", {scope: "row"}, h("span", {className: "swatch", style: {background: COLORS[i % COLORS.length]}}), found.models.length > 1 ? `${i + 1} ${model.name}` : model.name),
      outputs.flatMap(([name]) => [h("td", {className: "n"}, number(model.rms[name], 3)), h("td", {className: "n"}, number(model.fit_percent[name], 4))]),
      h("td", {}, model.verdict ? h("span", {className: `badge ${model.verdict === "falsified" ? "bad" : "good"}`}, model.verdict === "falsified" ? "✗ contradict it" : "✓ do not contradict it") : "not tested"))))));
}

function fails(found, pictures) {
  const rows = found.models.flatMap((model, m) => model.where.map(finding => ({...finding, m, model: model.name})));
  if (!rows.length) return h("p", {}, "The error is spread evenly: nothing stands out in time, frequency or over any variable.");
  return [h("h3", {}, "Where it fails"), h("ul", {className: "fails"}, rows.map(row => {
    const text = (found.models.length > 1 ? `${row.model}: ` : "") + row.text;
    const recording = Math.max(0, found.data.indexOf(row.data));
    return h("li", {}, row.kind === "time" && row.low !== null && row.high !== null
      ? h("button", {className: "link", "data-key": text, onclick: () => zoom(pictures, `plot-compare-${recording}`, row.low, row.high)}, text) : text);
  }))];
}
