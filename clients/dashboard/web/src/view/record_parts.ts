// Takes with their repetitions: which count, and where their cuts are.
import type { TakeInfo, TakePart } from "../api";
import { el, setText } from "../dom";
import { texts } from "../texts";

const t = texts.record;
const STEP = 0.02;      // a press of an arrow key moves a cut by [s]
const SHORTEST = 0.3;   // the bridge takes no shorter part [s]

export interface TakeActions {
  changed(take: TakeInfo): void;
  look(take: TakeInfo): void;
  remove(take: TakeInfo, n: number): void;
}

/// @param editable  with the repetitions; else only the takes
export function takeList(takes: TakeInfo[], editable: boolean, actions: TakeActions): HTMLElement {
  if (takes.length === 0) return el("p", { class: "muted" }, t.noTakes);
  return el("ol", { class: "takes" }, ...takes.map((take, i) => takeItem(take, i + 1, editable, actions)));
}

function takeItem(take: TakeInfo, n: number, editable: boolean, actions: TakeActions): HTMLElement {
  const rows = el("ul", { class: "take-parts" });
  const fill = (): void => {
    if (!editable) return;
    rows.replaceChildren(...take.parts.map((part, i) => partRow(take, n, part, i + 1, () => actions.changed(take))),
      el("li", {}, el("button", { type: "button", onclick: () => {
        take.parts.push({ start: 0, end: Number(take.duration.toFixed(3)), chosen: true });
        fill();
        actions.changed(take);
      } }, t.addPart)));
  };
  fill();
  return el("li", { class: "take", "data-take": take.id },
    el("div", { class: "row" },
      el("strong", {}, t.take(n)), el("span", { class: "muted" }, t.about(take.duration.toFixed(1), take.found)),
      el("span", { class: "gap" }),
      editable && el("button", { type: "button", "aria-label": t.only(n), onclick: () => actions.look(take) }, t.onlyShort),
      el("button", { type: "button", class: "danger", "aria-label": t.remove(n), onclick: () => actions.remove(take, n) }, t.removeShort)),
    ...take.faults.map((fault) => el("p", { class: "take-fault" }, `⚠ ${fault}`)), editable && rows);
}

function partRow(take: TakeInfo, n: number, part: TakePart, k: number, changed: () => void): HTMLElement {
  const box = el("input", { type: "checkbox", checked: part.chosen, "aria-label": t.use(n, k) });
  box.addEventListener("change", () => {
    part.chosen = box.checked;
    changed();
  });
  const bar = el("span", { class: "part-bar", "aria-hidden": "true" }, el("span", {}));
  const words = el("span", { class: "take-time" });
  const range = (label: string, end: "start" | "end"): HTMLInputElement => {
    const slider = el("input", { type: "range", min: 0, max: take.duration, step: STEP, value: part[end], "aria-label": label });
    slider.addEventListener("input", () => {
      const value = Number(slider.value);
      part[end] = end === "start" ? Math.min(value, part.end - SHORTEST) : Math.max(value, part.start + SHORTEST);
      part[end] = Math.min(Math.max(Number(part[end].toFixed(3)), 0), take.duration);
      slider.value = String(part[end]);
      show();
    });
    slider.addEventListener("change", changed);
    return slider;
  };
  const start = range(t.from(n, k), "start");
  const end = range(t.to(n, k), "end");
  const show = (): void => {
    const inner = bar.firstElementChild as HTMLElement;
    inner.style.left = `${100 * part.start / take.duration}%`;
    inner.style.width = `${100 * (part.end - part.start) / take.duration}%`;
    setText(words, `${part.start.toFixed(2)} – ${part.end.toFixed(2)} s`);
    start.setAttribute("aria-valuetext", t.seconds(Number(part.start.toFixed(2))));
    end.setAttribute("aria-valuetext", t.seconds(Number(part.end.toFixed(2))));
  };
  show();
  return el("li", { class: "take-part" },
    el("div", { class: "row" }, el("label", { class: "check" }, box, t.repetition(k)), words), bar,
    el("div", { class: "cuts" }, el("label", {}, t.fromShort, start), el("label", {}, t.toShort, end)));
}
