// Parameters: sliders, and the simulation that follows them.
import {h, put, number, withUnit} from "./dom.js";
import {draw, source, figuresOf} from "./plots.js";

let told = null;      // the model, its parameters and recordings, as the simulating process tells them
let values = {}, locked = new Set(), recording = 0, errors = {fit: null, now: null};
let busy = false, need = {}, asked = 0, range = null, failed = null, place = null, page = null, state = null;
export const frames = [];  // ms at which simulated curves were drawn, for measurements

const answer = message => ({followable: introduced, followed: drawn, band: banded, unfollowed: lost})[message.kind]?.(message);

export function view(place_, state_, page_) {
  [place, state] = [place_, state_];
  if (!page) { page = page_; page.listen(answer); }
  if (!place.firstChild) place.append(h("div"), h("div", {className: "side"}, h("div", {className: "sliders"}), h("div", {className: "pictures"})));
  const [words] = place.children;
  if (!state.project || !state.fit) {
    put(words, [Boolean(state.project), Boolean(page.running())], () => state.project
      ? [h("p", {}, "The sliders begin at the values of a fit, and there is none of this model yet."), page.button("Fit and compare", {action: "identify"}, {strong: true})]
      : h("p", {}, "There is no project yet: ", h("a", {href: "#start"}, "Start"), " sets one up."));
    place.children[1].hidden = true;
    return;
  }
  place.children[1].hidden = false;
  const version = JSON.stringify([state.story?.current, state.fit.theta, state.fit.made_from]);
  if (place.dataset.version !== version) { place.dataset.version = version; told = null; failed = null; busy = false; page.send({hello: true}); }
  header(words);
}

function header(words) {
  put(words, [errors, failed, told?.model, Boolean(page.running()), values, [...locked], recording], () => {
    if (failed) return h("p", {className: "trouble"}, failed);
    if (!told) return h("p", {className: "missing", role: "status"}, "Preparing the simulation …");
    const rows = told.outputs.map(output => h("tr", {}, h("th", {scope: "row"}, output.name),
      h("td", {className: "n"}, withUnit(errors.fit?.[output.name], output.unit)), h("td", {className: "n", "data-error": output.name}, withUnit(errors.now?.[output.name], output.unit))));
    return [h("div", {className: "row"},
      h("div", {className: "scroll"}, h("table", {}, h("thead", {}, h("tr", {}, ["error of", "at the fit", "as set"].map((name, i) => h("th", {scope: "col", className: i ? "n" : ""}, name)))), h("tbody", {}, rows))),
      told.recordings.length > 1 ? h("label", {className: "choice"}, "Recording", h("select", {"data-key": "recording", onchange: event => { recording = Number(event.target.value); whole(); }},
        told.recordings.map((one, i) => h("option", {value: i, selected: i === recording}, one.name)))) : null),
      h("div", {className: "row"}, h("button", {"data-key": "reset", onclick: reset}, "Back to the fit"), fitButton()),
      h("code", {className: "typed", id: "simulate-line"}, simulateLine())];
  });
}

function changed() { return Object.fromEntries(Object.entries(values).filter(([name, value]) => value !== parameter(name).value)); }
const parameter = name => told.parameters.find(one => one.name === name);
const quoted = text => /^[\w./=+-]+$/.test(text) ? text : `'${text}'`;
function simulateLine() {
  const model = state.story.current ? ` ${quoted(state.story.steps[state.story.current].model)}` : "";
  return `daest simulate${model}${Object.entries(changed()).map(([name, value]) => ` --set ${quoted(`${name}=${value}`)}`).join("")}`;
}

function fitButton() {
  const fixed = Object.fromEntries([...locked].map(name => [name, values[name] ?? parameter(name).value]));
  const lines = (state.commands?.identify ?? []).map((line, i) => i ? line : line + Object.entries(fixed).map(([name, value]) => ` --fix ${quoted(`${name}=${value}`)}`).join(""));
  return page.button(locked.size ? "Fit the others" : "Fit again", {action: "identify", locked: fixed}, {lines});
}

async function introduced(message) {
  told = message;
  values = Object.fromEntries(told.parameters.map(one => [one.name, one.value]));
  locked = new Set([...locked].filter(name => name in values));
  recording = Math.min(recording, told.recordings.length - 1);
  sliders();
  header(place.children[0]);
  const found = await fetch("api/sliders").then(one => one.json()).catch(() => ({plots: []}));
  const pictures = place.querySelector(".pictures");
  await draw(pictures, found.plots);
  const parts = figuresOf(pictures);
  for (const {model} of parts) model.height = Math.max(model.height, Math.min(HIGHEST, Math.floor((innerHeight - BESIDE) / parts.length)));
  range = parts[0]?.model.x_range ?? null;
  const moved = () => { clearTimeout(moved.timer); moved.timer = setTimeout(refresh, 200); };
  range?.properties.start.change.connect(moved);
  whole();
}

function whole() {
  const one = told.recordings[recording];
  range?.setv({start: one.start, end: one.stop});
  refresh();
}

// The values that a figure shows hold all curves. While a slider moves they only grow, and by more than is needed at
// once: an axis that moves with the curve shows nothing, and the whole figure would be painted for every picture.
// What the user has chosen stays.
const HIGHEST = 480, BESIDE = 480;  // px: of a figure, and of what else a screen shows
const ROOM = {rest: 0.08, moving: 0.4};
const given = new WeakMap();
function settle(moving) {
  const pictures = place.querySelector(".pictures");
  figuresOf(pictures).forEach(({model}, i) => {
    const axis = model.y_range, last = given.get(axis);
    if (last && (axis.start !== last.start || axis.end !== last.end)) return;
    let low = Infinity, high = -Infinity;
    for (const [name, keys] of [["measured", ["y"]], ["fit", ["y"]], ["now", ["y"]], ["band", ["low", "high"]]]) {
      const data = source(pictures, `${name}-${i}`)?.data ?? {};
      for (const key of keys) for (const value of data[key] ?? []) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (low > high || (moving && low >= axis.start && high <= axis.end)) return;
    const margin = ROOM[moving ? "moving" : "rest"] * (high - low) || Math.abs(high) || 1;
    const wanted = {start: low - margin, end: high + margin};
    given.set(axis, wanted);
    axis.setv({...wanted, reset_start: wanted.start, reset_end: wanted.end});
  });
}
function refresh() { need = {now: true, fit: true, band: true}; pump(); }
function reset() { values = Object.fromEntries(told.parameters.map(one => [one.name, one.value])); sliders(); need.now = true; pump(); header(place.children[0]); }

// One question at a time; while it is answered, the newest values wait.
function pump() {
  if (busy || !told) return;
  const kind = ["now", "fit", "band"].find(one => need[one]);
  if (!kind) return;
  need[kind] = false;
  busy = kind;
  const window_ = range ? [range.start, range.end] : null;
  page.send({id: ++asked, recording, window: window_, ...(kind === "band" ? {band: true} : kind === "fit" ? {values: {}, measured: true} : {values: changed()})});
}

function drawn(message) {
  if (message.id !== asked) return;
  const pictures = place.querySelector(".pictures"), kind = busy;
  busy = false;
  pump();  // the next values are simulated while these curves are drawn
  errors = {...errors, [kind]: message.rms};
  const cells = place.querySelectorAll("td[data-error]"), kept = cells.length === told.outputs.length ? cells : null;
  message.curves.forEach((curve, i) => fill(pictures, `${kind}-${i}`, curve));
  message.measured?.forEach((curve, i) => fill(pictures, `measured-${i}`, curve));
  if (kind === "now") { frames.push(performance.now()); if (frames.length > 1000) frames.shift(); pictures.dataset.frames = String(frames.length); }
  if (kind === "now" && kept) {
    told.outputs.forEach((output, i) => { kept[i].textContent = withUnit(errors.now[output.name], output.unit); });
    place.querySelector("#simulate-line").textContent = simulateLine();  // the line that gives these errors
  }
  settle(true);
  // Buttons and axes change when the slider rests; while it moves, every frame counts.
  clearTimeout(drawn.timer);
  drawn.timer = setTimeout(() => { header(place.children[0]); settle(false); signs(pictures); }, 150);
}
function banded(message) {
  if (message.id !== asked) return;
  busy = false;
  const pictures = place.querySelector(".pictures");
  message.bands?.forEach((one, i) => fill(pictures, `band-${i}`, {x: one.low.x, low: one.low.y, high: one.high.y}));
  settle(false);
  signs(pictures);
  pump();
}
// A legend draws its signs from the first values of the curves, which came after it.
function signs(pictures) {
  for (const part of figuresOf(pictures)) {
    for (const piece of part.model.above) if (piece.type === "Legend") piece.change.emit();
    part.request_repaint?.();
  }
}
function fill(pictures, name, curve) {
  const found = source(pictures, name);
  if (found) found.data = Object.fromEntries(Object.entries(curve).map(([key, list]) => [key, Float64Array.from(list, one => one ?? NaN)]));
}
function lost(message) { busy = false; told = null; failed = `The model cannot be simulated here: ${message.what}`; place.dataset.version = ""; header(place.children[0]); }

// Positions of a slider are whole steps; a logarithmic one has equal ratios.
const STEPS = 1000;
const at = (one, position) => one.log ? one.low * (one.high / one.low) ** (position / STEPS) : one.low + (one.high - one.low) * position / STEPS;
const where = (one, value) => Math.round(STEPS * (one.log ? Math.log(value / one.low) / Math.log(one.high / one.low) : (value - one.low) / (one.high - one.low)));

function sliders() {
  const own = told.parameters.filter(one => one.estimated), others = told.parameters.filter(one => !one.estimated);
  place.querySelector(".sliders").replaceChildren(...own.map(slider),
    others.length ? h("details", {open: !own.length}, h("summary", {}, `${others.length} more, which were held`), others.map(slider)) : "");
}

function slider(one) {
  const shown = h("output", {}, withUnit(values[one.name], one.unit, 5));
  const moved = wanted => { const value = wanted === one.value ? wanted : Number(wanted.toPrecision(6)); values = {...values, [one.name]: value}; shown.textContent = withUnit(value, one.unit, 5); need.now = true; pump(); };
  const input = h("input", {type: "range", min: 0, max: STEPS, step: 1, "aria-label": one.name, "data-parameter": one.name, title: one.description,
    oninput: event => { const position = Number(event.target.value); moved(position === where(one, one.value) ? one.value : at(one, position)); input.setAttribute("aria-valuetext", shown.textContent); }});
  input.value = where(one, values[one.name]);
  input.setAttribute("aria-valuetext", shown.textContent);
  const lock = h("input", {type: "checkbox", checked: locked.has(one.name), "aria-label": `hold ${one.name} in a fit`, onchange: event => { if (event.target.checked) locked.add(one.name); else locked.delete(one.name); header(place.children[0]); }});
  return h("div", {className: "slider"}, h("div", {className: "row"}, h("strong", {}, one.name), shown,
    h("span", {className: "unit"}, one.std_error === null ? "" : `± ${number(one.std_error, 2)} in the fit`), h("label", {className: "lock"}, lock, "hold")), input,
    one.description ? h("p", {className: "hint"}, one.description) : null);
}
