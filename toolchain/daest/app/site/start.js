// Start: which model, which recordings, and what the commands have found out about them.
import {h, put, number} from "./dom.js";
import {draw, zoom} from "./plots.js";

const MODEL = /\.(mo|bmo|fmu)$/i;
const AROUND = 0.02; // share of a recording to either side of a fault that is zoomed to
let chosen = {model: null, data: null}, drawn = null;

export function view(place, state, page) {
  if (!place.firstChild) place.append(h("div"), h("div", {className: "pictures"}), h("div"));
  const [words, pictures, next] = place.children;
  put(words, [state.project, state.files, state.check, state.commands, Boolean(page.running()), chosen], () =>
    state.project ? known(state, page, pictures) : fresh(place, state, page));
  put(next, [Boolean(state.project), Boolean(state.fit), state.commands, Boolean(page.running())], () => state.project
    ? [h("h3", {}, "Go on"), page.button("Fit and compare", {action: "identify"}, {strong: !state.fit})] : []);
  const version = JSON.stringify([state.project, state.check]);
  if (version !== drawn) { drawn = version; show(pictures, version, Boolean(state.project && state.check)); }
}

async function show(pictures, version, is_there) {
  if (is_there && !pictures.firstChild) pictures.append(h("p", {className: "missing", role: "status"}, "Drawing …"));
  const answer = is_there ? await fetch("api/recordings").catch(() => null) : null;
  const plots = answer?.ok ? (await answer.json()).plots : [];
  if (version !== drawn) return;
  await draw(pictures, plots);
  pictures.dataset.drawn = String(plots.length);
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

function known(state, page, pictures) {
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
    ...(state.check ? checked(state.check, pictures) : [h("p", {className: "missing"}, "They have not been looked at yet.")]),
    page.button(state.check ? "Check again" : "Check the recordings", {action: "check"}),
  ];
}

// What was found; a fault that has a time is shown on the recording by a click.
function finding_text(finding, r, check, pictures) {
  const text = `${finding.recording}: ${finding.text}`, recording = check.recordings[r];
  if (finding.time === null || finding.time === undefined) return text;
  const margin = AROUND * (recording.stop - recording.start);
  return h("button", {className: "link", "data-key": text, onclick: () => zoom(pictures, `plot-recording-${r}`, finding.time - margin, finding.time + margin)}, text);
}

function checked(check, pictures) {
  const found = check.recordings.flatMap((recording, r) => (recording.findings ?? []).map(finding => ({...finding, r, recording: recording.name})));
  return [
    ...check.recordings.map(recording => h("div", {className: "scroll", tabIndex: 0, role: "region", "aria-label": `Columns of ${recording.name}`},
      h("table", {}, h("caption", {}, `${recording.name}: ${recording.n_samples} samples from ${number(recording.start)} s to ${number(recording.stop)} s` + (recording.period ? ` every ${number(recording.period)} s` : ", unevenly")),
        h("thead", {}, h("tr", {}, ["column", "is", "unit", "smallest", "largest", "noise"].map(name => h("th", {scope: "col"}, name)))),
        h("tbody", {}, recording.columns.map(column => h("tr", {}, h("th", {scope: "row"}, column.name), h("td", {}, column.role ?? ""), h("td", {}, column.unit ?? ""),
          h("td", {className: "n"}, number(column.min)), h("td", {className: "n"}, number(column.max)), h("td", {className: "n"}, number(column.noise_std, 2)))))))),
    found.length ? h("ul", {className: "findings"}, found.map(finding => h("li", {className: finding.level}, h("span", {className: `badge ${finding.level === "warning" ? "bad" : "verdict"}`}, finding.level), " ", finding_text(finding, finding.r, check, pictures))))
      : h("p", {}, h("span", {className: "badge good"}, "✓ no fault found")),
  ];
}
