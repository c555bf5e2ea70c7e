// Report: one page of everything, for those who were not here.
import {h, put} from "./dom.js";

export function view(place, state, page) {
  put(place, [state.has_report, state.commands, Boolean(page.running())], () => state.project || state.has_report ? [
    h("p", {}, "One HTML page of all that was found out, which opens anywhere without a network."),
    page.button(state.has_report ? "Write it anew" : "Write the report", {action: "report"}, {strong: !state.has_report}),
    state.has_report ? h("p", {}, h("a", {href: "report.html", target: "_blank", rel: "noopener"}, "Open the report"), " (report.html in the folder)") : null,
  ] : h("p", {}, "There is no project yet: ", h("a", {href: "#start"}, "Start"), " sets one up."));
}
