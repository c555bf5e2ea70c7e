import {h, put, number} from "./dom.js";
export function view(place, state, page) {
  put(place, [state.fit?.parameters, Boolean(page.running())], () => h("p", {className: "missing"}, "Nothing has been fitted yet."));
}
