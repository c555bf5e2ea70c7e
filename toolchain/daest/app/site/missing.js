// What is missing: candidates as they arrive, one opened, added, taken back; the error falls step by step.
import {h, svg, put, number, withUnit, arrows, COLORS} from "./dom.js";
import {draw} from "./plots.js";

export function view(place, state, page) {
  if (!place.firstChild) place.append(h("div"), h("div"), h("div"));
  const [stairs, search, found] = place.children;
  if (!state.project) { put(search, 0, () => h("p", {}, "There is no project yet: ", h("a", {href: "#start"}, "Start"), " sets one up.")); return; }
  put(stairs, [state.story, state.comparison?.outputs, Boolean(page.running())], () => staircase(state, page));
  const running = page.running();
  put(search, [running?.action, state.commands, Boolean(state.diagnosis), Boolean(running)], () => begin(state, page));
  put(found, [state.diagnosis, state.arrived, running?.action, Boolean(running)], () => candidates(state, page));
}

function begin(state, page) {
  const job = page.running();
  if (job?.action === "diagnose" || job?.action === "improve") {
    return [h("p", {role: "status"}, "Searching. Candidates appear below as soon as they are refitted; a search that is stopped goes on from there."),
      h("button", {"data-key": "halt", onclick: () => page.run({action: "stop", job: job.number})}, "Stop the search")];
  }
  const stopped = state.jobs.filter(one => one.action === "diagnose").at(-1)?.status;
  const label = state.diagnosis ? "Search again" : stopped === "stopped" || stopped === "lost" ? "Go on with the search" : "Search for what is missing";
  return [page.button(label, {action: "diagnose"}, {strong: !state.diagnosis}),
    h("details", {"data-key": "all"}, h("summary", {}, "Do all of it: search and add until nothing is missing"), page.button("Improve", {action: "improve"}), ledger(state))];
}

function ledger(state) {
  if (!state.ledger) return null;
  return [h("p", {}, `The last run of daest improve: ${state.ledger.reason}`),
    h("ol", {start: 0}, state.ledger.steps.map(step => h("li", {}, (step.added ? `${step.added} at ${step.at}` : "the model as it is") + ": " +
      Object.entries(state.ledger.outputs).map(([name, unit]) => `${name} ${withUnit(step.rms.validation?.[name], unit)}`).join(", "))))];
}

// The verdict as it forms: from the refits that have arrived, then as the command tells it.
function candidates(state, page) {
  const running = page.running(), is_searching = running?.action === "diagnose" || running?.action === "improve";
  const outputs = state.comparison?.outputs ?? state.diagnosis?.outputs ?? {};
  if (is_searching) {
    const since = state.arrived.filter(one => one.time >= running.began || one.run === state.arrived.at(-1).run);
    const held = since.filter(one => one.verdict !== "rejected").sort((a, b) => b.delta_bic - a.delta_bic);
    return [h("p", {className: "forming"}, forming(since.length, held)),
      table(since.slice().reverse(), outputs, one => h("th", {scope: "row"}, one.effect))];
  }
  const diagnosis = state.diagnosis;
  if (!diagnosis) return state.arrived.length ? h("p", {className: "missing"}, `${state.arrived.length} refits of an earlier search are kept; a search of the same model and data goes on from them.`) : null;
  return [h("p", {}, h("span", {className: `badge ${tone(diagnosis.verdict)}`}, diagnosis.verdict), " ", arrows(diagnosis.message)),
    h("div", {className: "candidates"}, diagnosis.candidates.map((one, i) => candidate(one, i, outputs, state, page))),
    diagnosis.candidates.length ? h("p", {className: "hint"}, diagnosis.baseline?.remark ?? "") : h("p", {}, "No candidate came as far as a refit.")];
}

function forming(n, held) {
  if (!n) return "No candidate has arrived yet.";
  if (!held.length) return `${n} arrived so far, and ${n === 1 ? "is" : "all are"} rejected.`;
  const rivals = held.length - 1;
  return `${n} arrived so far. Best stands ${held[0].effect} at ${held[0].at}` + (rivals ? `; ${rivals} more ${rivals === 1 ? "is" : "are"} not rejected.` : ", alone.");
}

const tone = verdict => verdict === "supported" || verdict === "nothing missing" ? "good" : verdict === "rejected" ? "bad" : "verdict";

function table(rows, outputs, head) {
  return h("div", {className: "scroll", tabIndex: 0, role: "region", "aria-label": "Candidates"}, h("table", {},
    h("thead", {}, h("tr", {}, h("th", {scope: "col"}, "effect"), h("th", {scope: "col"}, "place"), Object.entries(outputs).map(([name, unit]) => h("th", {scope: "col", className: "n"}, `error of ${name} [${unit || "1"}]`)), h("th", {scope: "col", className: "n"}, "BIC gain"), h("th", {scope: "col"}, "verdict"))),
    h("tbody", {}, rows.map(one => h("tr", {}, head(one), h("td", {}, one.at), Object.keys(outputs).map(name => h("td", {className: "n"}, number(one.rms?.[name], 3))), h("td", {className: "n"}, number(one.delta_bic)),
      h("td", {}, h("span", {className: `badge ${tone(one.verdict)}`}, one.verdict)))))));
}

function candidate(one, i, outputs, state, page) {
  const rms = one.rms?.validation ?? one.rms?.estimation ?? {}, before = state.diagnosis.baseline.rms.validation ?? {};
  const key = `${one.effect} at ${one.at}`;
  const errors = Object.entries(outputs).map(([name, unit]) => `${name} ${number(before[name], 3)} → ${withUnit(rms[name], unit)}`).join(", ");
  const asked = {action: "add", effect: one.effect, at: one.at};
  const place = h("div", {});
  return h("details", {className: "candidate", "data-key": key, ontoggle: event => { if (event.target.open && !place.firstChild) opened(place, one, asked, state, page); }},
    h("summary", {}, h("span", {className: `badge ${tone(one.verdict)}`}, one.verdict), " ", h("strong", {}, key), " ", h("span", {className: "hint"}, one.refitted === false ? "not refitted" : errors)), place);
}

async function opened(place, one, asked, state, page) {
  const sizes = Object.entries(one.parameters).map(([name, p]) => h("tr", {}, h("th", {scope: "row"}, name), h("td", {className: "n"}, number(p.value)), h("td", {}, p.std_error === null ? "" : `± ${number(p.std_error, 2)}`), h("td", {}, p.unit || "")));
  const law = h("p", {className: "law"});
  const act = h("div"), overlay = h("div");
  place.append(law, h("div", {className: "scroll"}, h("table", {}, h("tbody", {}, sizes))),
    ...(one.reason ? [h("p", {}, one.reason)] : []),
    ...(one.explained !== null && one.explained !== undefined ? [h("p", {}, `It explains ${number(100 * one.explained, 2)} % of the load that the model as it is needs there.`)] : []),
    ...(one.equivalent_places?.length ? [h("p", {}, `These sensors see no difference from ${one.equivalent_places.join(", ")}.`)] : []),
    ...(one.not_separable_from?.length ? [h("p", {}, `The data cannot tell it from ${one.not_separable_from.join(", ")}.`)] : []),
    overlay, ...(one.lines.length ? [h("h4", {}, "What it adds to the model"), difference(one.lines)] : []), act);
  if (one.refitted !== false && one.lines.length) beside(overlay, one);
  const effect = await page.law(one.class ?? one.effect);
  if (effect) law.append(h("code", {}, effect.law), h("span", {className: "hint"}, ` ${effect.description}`));
  const told = await page.run({...asked, dry: true});
  act.append(page.button("Add it", asked, {lines: told?.lines, strong: one.verdict !== "rejected", title: "Writes the extended model, fits it and compares it with the model before"}));
}

// The simulation with the candidate over that without it and what was measured.
async function beside(place, one) {
  const wait = h("p", {className: "missing", role: "status"}, "Simulating the model with it …"), pictures = h("div", {className: "pictures"});
  place.append(h("h4", {}, "The model with it, on the data"), wait, pictures);
  const answer = await fetch(`api/beside?effect=${encodeURIComponent(one.effect)}&at=${encodeURIComponent(one.at)}`).catch(() => null);
  const told = answer?.ok ? await answer.json().catch(() => null) : null;
  if (!place.isConnected) return;
  if (!told) { wait.textContent = "It cannot be simulated on these data."; return; }
  wait.replaceWith(h("code", {className: "typed"}, told.line));
  await draw(pictures, [{...told.plot, id: `plot-beside-${one.effect}-${one.at}`.replace(/[^\w-]/g, "-")}]);
  pictures.dataset.drawn = "1";
}

function difference(lines) {
  return h("pre", {className: "difference", tabIndex: 0, "aria-label": "Added lines"}, lines.map(line => h("span", {className: "added"}, `+ ${line.text}\n`)));
}

// The error of every output from step to step; a branch that was left is a thin bar, and a click goes back to it.
function staircase(state, page) {
  const steps = state.story.steps, outputs = Object.entries(state.comparison?.outputs ?? {});
  const measured = steps.filter(step => step.errors);
  const path = measured.filter(step => step.on_path);
  const rows = steps.map(step => h("li", {className: step.current ? "here" : step.on_path ? "" : "left"},
    h("button", {className: "link", "data-key": `step ${step.number}`, disabled: Boolean(page.running()), "aria-current": step.current ? "step" : null, onclick: () => page.run({action: "stand", step: step.number})},
      step.added ? `${step.added} at ${step.at}` : "the model as it is"),
    " ", step.errors ? outputs.map(([name, unit]) => `${name} ${withUnit(step.errors.rms[name], unit)}`).join(", ") : h("span", {className: "missing"}, step.number ? "not compared yet" : "not compared yet: Fit and compare"),
    step.on_path ? "" : h("span", {className: "unit"}, " a branch not taken"),
    step.lines.length ? h("details", {"data-key": `lines ${step.number}`}, h("summary", {}, step.model), difference(step.lines)) : null));
  const here = steps[state.story.current];
  return [
    path.length ? h("div", {className: "pair"}, outputs.map(([name, unit], i) => stairs(path, name, unit, COLORS[i % COLORS.length]))) : null,
    h("ol", {className: "steps", start: 0}, rows),
    here.parent !== null ? h("button", {"data-key": "undo", disabled: Boolean(page.running()), onclick: () => page.run({action: "stand", step: here.parent})}, `Take ${here.added} back`) : null,
  ];
}

function stairs(path, name, unit, color) {
  const values = path.map(step => step.errors.rms[name] ?? 0), most = Math.max(...values) || 1, width = 100 / Math.max(path.length, 2);
  const top = value => 12 + 108 * (1 - value / most);
  let line = "";
  const parts = values.map((value, i) => { line += `${i ? "L" : "M"}${i * width * 4} ${top(value)} L${(i + 1) * width * 4} ${top(value)} `; return value; });
  const label = `Error of ${name} from step to step: ${values.map(value => withUnit(value, unit)).join(", ")}`;
  return h("figure", {className: "plot-frame"}, svg("svg", {viewBox: "0 -8 400 158", role: "img", "aria-label": label, class: "stairs"},
    svg("path", {d: `${line} L${parts.length * width * 4} 120 L0 120 Z`, fill: color, "fill-opacity": 0.18}), svg("path", {d: line, fill: "none", stroke: color, "stroke-width": 2.5}),
    ...values.map((value, i) => svg("text", {x: (i + 0.5) * width * 4, y: top(value) - 4, "text-anchor": "middle"}, number(value, 3))),
    ...path.map((step, i) => svg("text", {x: (i + 0.5) * width * 4, y: 138, "text-anchor": "middle", class: "soft"}, step.added ? `+ ${step.added}` : "as it is"))),
    h("figcaption", {}, `Error of ${name} [${unit || "1"}] on data that were not fitted`));
}
