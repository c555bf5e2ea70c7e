// Doubt: the verdict with its evidence and its price in plain words, and what would settle it.
import {h, put, number, withUnit, arrows, COLORS} from "./dom.js";

const MEANS = {
  "nothing missing": "What the model leaves is what its own noise would leave. Nothing has to be added.",
  "parameters off": "No effect is missing: other values of the parameters do.",
  "supported": "One effect stands out, and everything that was asked of it holds.",
  "cannot tell": "Several effects explain these data equally well. The data do not say which one it is.",
  "unknown effect": "Something acts that follows a variable of the model, but no law of the library says it.",
  "external disturbance": "Something acts that follows no variable of the model: it comes from outside.",
};

export function view(place, state, page) {
  put(place, [state.diagnosis, state.earlier, state.design, state.comparison, state.rivals, state.commands, Boolean(page.running())], () => {
    const found = state.diagnosis ?? state.earlier;
    const search = state.diagnosis || !state.project ? [] : [h("p", {className: "missing"}, "Nothing has been searched for yet in this model."), page.button("Search for what is missing", {action: "diagnose"}, {strong: true})];
    if (!found) return search;
    const held = found.candidates.filter(one => one.verdict !== "rejected"), refitted = found.candidates.filter(one => one.refitted !== false);
    return [
      search, state.diagnosis ? null : h("h3", {}, `The search before, in ${found.model?.name ?? "the model before"}`),
      h("p", {className: "verdict-line"}, h("span", {className: `badge ${["supported", "nothing missing"].includes(found.verdict) ? "good" : "verdict"}`}, found.verdict), " ", MEANS[found.verdict] ?? ""),
      h("p", {}, arrows(found.message)),
      h("h3", {}, "What the search cost"),
      h("p", {}, found.screen ? `${found.screen.n_screened} effects at places were looked at, and ${refitted.length} were refitted, in ${number(found.seconds, 3)} s. The best of so many looks good by chance alone; the evidence below is what is left after that is taken off: with nothing missing, a score as high as the best one would be seen with probability ${probability(found.screen.p_value)}.` : `${refitted.length} effects were refitted in ${number(found.seconds, 3)} s.`),
      h("h3", {}, held.length > 1 ? "The rivals" : "The evidence"), evidence(held.length ? held : refitted.slice(0, 4), found), state.diagnosis ? rivals(state, page) : null,
      found.next_experiment ? [h("h3", {}, "What would settle it"), h("p", {className: "next"}, found.next_experiment)] : null,
      state.design ? h("p", {}, "Designed: ", state.design.message, state.design.file ? [" The input is in ", h("code", {}, state.design.file), "."] : "") : null,
      state.commands?.design ? page.button(state.design ? "Design the next experiment anew" : "Design the next experiment", {action: "design"}) : null,
      found.places?.length ? [h("h3", {}, "Where the model needs help"), h("ul", {}, found.places.slice(0, 5).map(one => h("li", {}, `${one.group.join(", ")}: noise there would make the data ${number(one.log_likelihood_gain, 3)} units of log-likelihood more likely`)))] : null,
      (found.notes ?? []).map(text => h("p", {className: "remark"}, text)),
      tests(state.comparison),
    ].flat();
  });
}

const probability = p => p === null || p === undefined ? "unknown" : p < 1e-3 ? (p > 0 ? `below 0.001 (${number(p, 2)})` : "below 0.001") : number(p, 2);

function evidence(rows, found) {
  if (!rows.length) return h("p", {}, "No effect came as far as a refit.");
  return h("ul", {className: "evidence"}, rows.map(one => h("li", {}, h("strong", {}, `${one.effect} at ${one.at}`), ": ",
    Object.entries(one.parameters).map(([name, p]) => `${name} = ${number(p.value)}${p.std_error === null ? "" : ` ± ${number(p.std_error, 2)}`} ${p.unit ?? ""}`.trim()).join(", "), ". ",
    one.delta_bic === null || one.delta_bic === undefined ? "" : `BIC gain ${number(one.delta_bic)} (10 is very strong), `,
    one.p_value === null ? "" : `by chance with probability ${probability(one.p_value)}`,
    one.explained === null || one.explained === undefined ? "" : `, explains ${number(100 * one.explained, 2)} % of the load`, ". ",
    one.reason ? `${one.reason}. ` : "", one.not_separable_from?.length ? `Not told apart from ${one.not_separable_from.join(", ")}.` : "")));
}

// The rivals as models of their own, refitted and laid over each other on the data.
function rivals(state, page) {
  const lines = state.commands?.rivals, found = state.rivals;
  if (!lines) return null;
  return [found ? h("ul", {className: "evidence"}, found.models.map((model, i) => h("li", {}, h("span", {className: "swatch", style: {background: COLORS[i % COLORS.length]}}), h("strong", {}, `${i + 1} ${model.name}`), ": ",
      Object.entries(found.outputs).map(([name, unit]) => `${name} ${withUnit(model.rms[name], unit)}`).join(", ")))) : null,
    found?.shown ? h("p", {}, h("a", {href: "#compare", "data-key": "rivals"}, "See them over each other on the data, in their colours")) : null,
    page.button(found ? "Lay the rivals over each other again" : "Lay the rivals over each other", {action: "rivals"}, {lines, strong: !found})].flat();
}

function tests(comparison) {
  const rows = (comparison?.models ?? []).flatMap(model => Object.entries(model.tests ?? {}).flatMap(([kind, by_output]) => Object.entries(by_output ?? {}).map(([output, test]) => ({model: model.name, kind, output, ...test}))));
  if (!rows.length) return null;
  const words = {whiteness: "one-step errors are white", input_independence: "they do not follow the inputs", variable_independence: "they do not follow the variables", nis: "they are of the predicted size"};
  return [h("h3", {}, "Whether the data contradict the model"), h("div", {className: "scroll", tabIndex: 0, role: "region", "aria-label": "Tests"}, h("table", {},
    h("thead", {}, h("tr", {}, ["model", "test", "output", "by chance with probability", ""].map(name => h("th", {scope: "col"}, name)))),
    h("tbody", {}, rows.map(row => h("tr", {}, h("th", {scope: "row"}, row.model), h("td", {}, words[row.kind] ?? row.kind), h("td", {}, row.output), h("td", {className: "n"}, probability(row.p_value)),
      h("td", {}, row.pass === null ? "" : h("span", {className: `badge ${row.pass ? "good" : "bad"}`}, row.pass ? "✓ holds" : "✗ fails")))))))];
}
