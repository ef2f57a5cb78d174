// Keys, colours, safety.
import { el, openDialog } from "../dom";
import { texts } from "../texts";

const t = texts.helpDialog;
const KEY = "secondskin.shortcuts";

export const shortcuts = {
  get on(): boolean { return localStorage.getItem(KEY) !== "off"; },
  set on(on: boolean) { localStorage.setItem(KEY, on ? "on" : "off"); },
};

export function showHelp(): void {
  if (document.querySelector("dialog.help")) return;
  const box = el("input", { type: "checkbox", checked: shortcuts.on });
  box.addEventListener("change", () => { shortcuts.on = box.checked; });
  const dialog = el("dialog", { class: "help wide", "aria-labelledby": "help-title" },
    el("h2", { id: "help-title" }, t.heading),
    el("h3", {}, t.keys),
    el("dl", { class: "keys" }, ...t.list.flatMap(([key, what]) => [el("dt", {}, el("kbd", {}, key)), el("dd", {}, what)])),
    el("label", { class: "check" }, box, t.shortcuts),
    el("h3", {}, t.colours), el("p", {}, t.coloursBody),
    el("h3", {}, t.safety), el("p", {}, t.safetyBody),
    el("form", { method: "dialog", class: "row" }, el("button", { class: "primary big", autofocus: true }, texts.close)));
  openDialog(dialog);
}
