// Which joints matter and how exactly: proposed, and changed by who knows better.
import type { Draft, ProposedJoint } from "../api";
import { el, setText } from "../dom";
import { jointText, texts } from "../texts";
import { LINES, Plot } from "./plot";

const t = texts.record;
const DRAWN = 30;  // curves have so many points a second [Hz]

export type Choice = Record<string, { weight: number; tolerance_deg: number }>;

/// What a draft proposes.
export function proposed(draft: Draft): Choice {
  return Object.fromEntries(draft.joints.map(({ name, weight, tolerance_deg }) => [name, { weight, tolerance_deg }]));
}

/// @param choice  changed in place
export function jointList(draft: Draft, choice: Choice): HTMLElement {
  const sorted = [...draft.joints].sort((a, b) => b.weight - a.weight);
  const list = (joints: ProposedJoint[]): HTMLElement =>
    el("ul", { class: "joints" }, ...joints.map((joint) => jointRow(joint, draft.experts, choice)));
  return el("div", {},
    el("h3", {}, t.interest), list(sorted.filter((joint) => joint.of_interest)),
    el("details", {}, el("summary", {}, t.others), list(sorted.filter((joint) => !joint.of_interest))));
}

function jointRow(joint: ProposedJoint, experts: number, choice: Choice): HTMLElement {
  const name = jointText(joint.name);
  const chosen = choice[joint.name]!;
  const slider = (label: string, short: string, field: "weight" | "tolerance_deg", max: number, step: number, text: (v: number) => string): HTMLElement => {
    const words = el("output", {}, text(chosen[field]));
    const input = el("input", { type: "range", min: field === "weight" ? 0 : 1, max, step, value: chosen[field], "aria-label": label });
    input.setAttribute("aria-valuetext", text(chosen[field]));
    input.addEventListener("input", () => {
      chosen[field] = Number(input.value);
      setText(words, text(chosen[field]));
      input.setAttribute("aria-valuetext", text(chosen[field]));
    });
    return el("label", {}, el("span", {}, short), input, words);
  };
  return el("li", { "data-joint": joint.name },
    el("strong", {}, name),
    el("p", { class: "muted" }, joint.measured ? t.reason(joint.range_deg, joint.spread_deg, experts, joint.tolerance_deg) : t.notMeasured),
    el("div", { class: "cuts" },
      slider(t.mattersOf(name), t.matters, "weight", 1, 0.1, t.share),
      slider(t.toleranceOf(name), t.tolerance, "tolerance_deg", 60, 1, t.deg)));
}

/// The joints that move most, all repetitions over each other in the mean's time.
/// @param names  of the parts, in the draft's order
export function curves(draft: Draft, names: string[]): HTMLElement {
  return el("div", { class: "plots" }, ...draft.curves.slice(0, 4).map((curve) => {
    const name = `${jointText(curve.joint)}, ${t.movement[curve.movement] ?? curve.movement}`;
    const many = curve.parts.length > 1;
    const lines = [...(many ? [{ label: t.legendMean, colour: "#ffffff" }] : []),
      ...curve.parts.map((_, i) => ({ label: names[i] ?? "", colour: LINES[i % LINES.length]!, dashed: i >= LINES.length }))];
    const all = curve.parts.flat().concat(curve.mean);
    const low = Math.min(...all);
    const high = Math.max(...all, low + 10);
    const plot = new Plot(name, lines, { unit: texts.signals.degrees, range: [low - 3, high + 3], height: 190 });
    plot.set([curve.mean.map((_, i) => i / DRAWN), ...(many ? [curve.mean] : []), ...curve.parts]);
    return el("div", { class: "joint-plot" }, el("h3", {}, name), plot.element);
  }));
}
