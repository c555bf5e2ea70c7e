// The live page: shows the state that the server reads from the folder, and asks for commands.
import {h, put} from "./dom.js";
import {view as start} from "./start.js";
import {view as compare} from "./compare.js";
import {view as missing} from "./missing.js";
import {view as doubt} from "./doubt.js";
import {view as report} from "./report.js";
import {view as parameters} from "./parameters.js";

const VIEWS = {start, compare, parameters, missing, doubt, report};
const RETRY = 700; // ms until a lost connection is tried again
const listeners = new Set(), laws = new Map();
let state = null, socket = null;

export const page = {
  get state() { return state; },
  send(message) { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); },
  listen(function_) { listeners.add(function_); },
  running() { return (state?.jobs ?? []).find(job => job.status === "running"); },
  async run(asked) {
    const answer = await fetch("api/run", {method: "POST", body: JSON.stringify(asked)}).catch(() => null);
    const told = await answer?.json().catch(() => null);
    if (answer?.ok) {
      trouble(null);
      if (told?.job) document.documentElement.dataset.asked = told.job;
      return told;
    }
    if (!asked.dry) trouble(told?.what ? `${told.what}. ${told.remedy}.` : "The server does not answer: start daest app again.");
    return null;
  },
  async drop(file) {
    const answer = await fetch(`api/drop?name=${encodeURIComponent(file.name)}`, {method: "PUT", body: file}).catch(() => null);
    const told = await answer?.json().catch(() => null);
    trouble(answer?.ok ? null : told?.what ? `${told.what}; ${told.remedy}.` : "The file did not arrive: it may be too large.");
    return answer?.ok ?? false;
  },
  async law(name) {
    laws.set(name, laws.get(name) ?? fetch(`api/effect?name=${encodeURIComponent(name)}`).then(found => found.ok ? found.json() : null).catch(() => null));
    return laws.get(name);
  },
  // A button with the line that it types.
  button(label, asked, {lines = state?.commands?.[asked.action], strong = false, title} = {}) {
    return h("div", {className: "act"},
      h("button", {className: strong ? "strong" : "", "data-key": JSON.stringify(asked), disabled: Boolean(page.running()),
        onclick: () => page.run(asked), title}, label),
      lines?.length ? h("code", {className: "typed"}, lines.join("\n")) : null);
  },
};

// What went wrong stands until the next click; what the state says, as long as it says so.
let is_answer = false;
export function trouble(text, of_answer = true) {
  const place = document.getElementById("trouble");
  if (!of_answer && is_answer && !text) return;
  is_answer = of_answer && Boolean(text);
  place.hidden = !text;
  place.textContent = text ?? "";
}

function part() {
  const wanted = location.hash.slice(1).split("/")[0];
  if (wanted in VIEWS) return wanted;
  history.replaceState(null, "", state.project ? "#compare" : "#start");
  return location.hash.slice(1);
}

function show() {
  if (!state) return;
  const chosen = part();
  for (const name of Object.keys(VIEWS)) document.getElementById(name).hidden = name !== chosen;
  for (const link of document.querySelectorAll("#parts a")) {
    if (link.hash.slice(1) !== chosen) { link.removeAttribute("aria-current"); continue; }
    if (!link.hasAttribute("aria-current")) link.scrollIntoView({block: "nearest", inline: "center"});  // a phone shows some
    link.setAttribute("aria-current", "page");
  }
  document.title = state.title ? `${state.title}: daest` : "daest";
  document.getElementById("title").textContent = state.title ?? "daest";
  const step = state.story?.steps[state.story.current];
  document.getElementById("standing").textContent = step?.model ? step.model.split("/").pop() + (step.added ? `: ${step.added} at ${step.at}` : "") : "";
  if (state.gone) { trouble(`The folder ${state.folder} has gone. Put it back, or end daest app and start it in another folder.`, false); return; }
  if (state.error) trouble(state.error, false);
  VIEWS[chosen](document.querySelector(`#${chosen} > div`), state, page);
  work();
}

// The commands: the one that runs with what it says, and those before it.
function work() {
  const jobs = state.jobs ?? [], last = jobs.at(-1);
  put(document.getElementById("work"), [last, state.script], () => {
    if (!last) return h("p", {className: "hint"}, "Every click is a daest command. They will stand here, and in a script.");
    const said = last.said.trim().split("\n").filter(Boolean);
    const headline = last.status === "failed" ? said.findLast(line => line.startsWith("error[")) ?? said.at(-1) : said.at(-1);
    const progress = said.at(-1)?.match(/\((\d+) of (\d+)\)/);
    const words = {running: "works", done: "done", failed: "failed", stopped: "stopped; what is done is kept", lost: "was ended by force; what is done is kept"};
    return [
      h("div", {className: `job ${last.status}`, "data-number": last.number},
        h("span", {className: "state", role: "status"}, words[last.status]),
        h("code", {className: "typed"}, last.lines.map((line, i) => (last.status === "running" && i === last.codes.length ? "▸ " : "") + line).join("\n")),
        last.status === "running" ? h("button", {"data-key": "stop", onclick: () => page.run({action: "stop", job: last.number})}, "Stop") : null,
        last.status === "running" ? h("progress", progress ? {max: Number(progress[2]), value: Number(progress[1])} : {}) : null,
        said.length ? h("details", {"data-key": "said", open: last.status === "failed"}, h("summary", {}, headline), h("pre", {}, last.said)) : null),
      h("details", {"data-key": "script"}, h("summary", {}, "All commands of this folder"),
        h("pre", {}, state.script), h("p", {}, h("a", {href: "session.sh", download: "session.sh"}, "Save them as a script"))),
    ];
  });
}

function connect() {
  const address = new URL("api/live", location.href);
  address.protocol = "ws:";
  socket = new WebSocket(address);
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    if (message.kind === "state") { state = message.state; if (!state.gone && !state.error) trouble(null, false); show(); document.documentElement.dataset.ready = "true"; }
    else for (const listen of listeners) listen(message);
  };
  socket.onclose = () => {
    document.documentElement.dataset.ready = "false";
    trouble("The server has ended. Work that runs goes on; start daest app again and open its new address.", false);
    setTimeout(connect, RETRY);
  };
}

addEventListener("hashchange", show);
connect();
