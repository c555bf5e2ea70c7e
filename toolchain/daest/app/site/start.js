// Start: which model, which recordings, and what the commands have found out about them.
import {h, put, number} from "./dom.js";

const MODEL = /\.(mo|bmo|fmu)$/i;
let chosen = {model: null, data: null};

export function view(place, state, page) {
  put(place, [state.project, state.files, state.check, state.commands, Boolean(page.running()), chosen], () =>
    state.project ? known(state, page) : fresh(place, state, page));
}

function fresh(place, state, page) {
  const models = state.files.filter(name => MODEL.test(name)), data = state.files.filter(name => !MODEL.test(name));
  if (!models.includes(chosen.model)) chosen.model = models[0] ?? null;
  if (!data.includes(chosen.data)) chosen.data = data[0] ?? null;
  const choice = (label, key, names) => h("label", {className: "choice"}, label,
    h("select", {"data-key": key, onchange: event => { chosen = {...chosen, [key]: event.target.value}; view(place, state, page); }},
      names.map(name => h("option", {value: name, selected: name === chosen[key]}, name))));
  return [
    h("p", {}, "A model and a recording of the machine are all it takes. Drop both here, or choose them; they are copied into this folder."),
    dropZone(page),
    models.length && data.length ? h("div", {className: "row"}, choice("Model", "model", models), choice("Recording", "data", data)) : null,
    models.length && data.length ? page.button("Set up", {action: "init", ...chosen},
      {lines: [`daest init ${chosen.model} ${chosen.data}`, "daest check"], strong: true}) : null,
  ];
}

function dropZone(page) {
  const take = async files => { for (const file of files) if (!(await page.drop(file))) break; };
  const input = h("input", {type: "file", multiple: true, accept: ".mo,.bmo,.fmu,.csv,.mat,.parquet,.xlsx,.txt,.tsv", "data-key": "files", onchange: event => take(event.target.files)});
  const zone = h("label", {className: "drop"}, "Drop a model (.mo, .fmu) and a recording (.csv, .mat, .parquet, .xlsx) here, or ", input);
  zone.addEventListener("dragover", event => { event.preventDefault(); zone.classList.add("over"); });
  zone.addEventListener("dragleave", () => zone.classList.remove("over"));
  zone.addEventListener("drop", event => { event.preventDefault(); zone.classList.remove("over"); take(event.dataTransfer.files); });
  return zone;
}

function known(state, page) {
  const project = state.project;
  const rows = [["model", project.source], ["class", project.class], ["estimated from", project.estimate.join(", ")],
    ["judged by", project.validate.join(", ") || (project.split ? `the part behind ${100 * project.split} % of each recording` : "the same recordings")],
    ...Object.entries(project.inputs).map(([name, column]) => [`input ${name}`, `column ${column}`]),
    ...Object.entries(project.outputs).map(([name, column]) => [`output ${name}`, `column ${column}`])];
  return [
    h("div", {className: "scroll"}, h("table", {}, h("tbody", {}, rows.filter(([, text]) => text).map(([name, text]) =>
      h("tr", {}, h("th", {scope: "row"}, name), h("td", {}, text)))))),
    h("details", {"data-key": "toml"}, h("summary", {}, "daest.toml, to be confirmed or changed in an editor"), h("pre", {className: "code"}, project.text)),
    h("h3", {}, "The recordings"),
    ...(state.check ? checked(state.check) : [h("p", {className: "missing"}, "They have not been looked at yet.")]),
    page.button(state.check ? "Check again" : "Check the recordings", {action: "check"}),
    h("h3", {}, "Go on"),
    page.button("Fit and compare", {action: "identify"}, {strong: !state.fit}),
  ];
}

function checked(check) {
  const found = check.recordings.flatMap(recording => (recording.findings ?? []).map(finding => ({...finding, recording: recording.name})));
  return [
    ...check.recordings.map(recording => h("div", {className: "scroll", tabIndex: 0, role: "region", "aria-label": `Columns of ${recording.name}`},
      h("table", {}, h("caption", {}, `${recording.name}: ${recording.n_samples} samples from ${number(recording.start)} s to ${number(recording.stop)} s` + (recording.period ? ` every ${number(recording.period)} s` : ", unevenly")),
        h("thead", {}, h("tr", {}, ["column", "is", "unit", "smallest", "largest", "noise"].map(name => h("th", {scope: "col"}, name)))),
        h("tbody", {}, recording.columns.map(column => h("tr", {}, h("th", {scope: "row"}, column.name), h("td", {}, column.role ?? ""), h("td", {}, column.unit ?? ""),
          h("td", {className: "n"}, number(column.min)), h("td", {className: "n"}, number(column.max)), h("td", {className: "n"}, number(column.noise_std, 2)))))))),
    found.length ? h("ul", {className: "findings"}, found.map(finding => h("li", {className: finding.level}, h("span", {className: `badge ${finding.level === "warning" ? "bad" : "verdict"}`}, finding.level), " ", `${finding.recording}: ${finding.text}`)))
      : h("p", {}, h("span", {className: "badge good"}, "✓ no fault found")),
  ];
}
