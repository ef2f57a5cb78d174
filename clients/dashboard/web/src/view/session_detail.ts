// One session: its blocks, repetitions and what the skin bore.
import type { Details } from "../api";
import { el, openDialog, table } from "../dom";
import { jointText, readable, segmentText, texts } from "../texts";
import { day } from "./history";
import { scheduleText } from "./timeline";

const t = texts.history;

type Joints = Details["blocks"][number]["repetitions"][number]["joints"];

function worstOf(joints: Joints): string {
  const worst = joints.flatMap(({ name, rms_deg, in_band }) => (rms_deg == null || in_band == null || in_band >= 0.9 ? [] : [{ name, rms_deg, in_band }]))
    .sort((a, b) => a.in_band - b.in_band).slice(0, 3);
  return worst.length === 0 ? t.noneWorst
    : worst.map(({ name, rms_deg }) => `${jointText(name)} ${rms_deg.toFixed(0)}°`).join(", ");
}

export function sessionDetail(session: Details): void {
  const b = t.blockTable;
  const e = t.exposureTable;
  const blocks = session.blocks.map((block) => el("section", {},
    el("h3", {}, `${readable(block.name || t.practice)}: ${texts.timeline.blockDetail(block.tempo == null ? "?" : String(block.tempo), scheduleText(block.schedule))}`),
    table(block.name, [b.number, b.total, b.cues, b.worst],
      block.repetitions.map((one) => [String(one.number), one.total.toFixed(0), String(one.cues), worstOf(one.joints)]), [1, 2])));
  const exposure = session.exposure.length === 0 ? null : el("section", {}, el("h3", {}, t.exposure),
    table(t.exposure, [e.segment, e.dose, e.duty, e.heat], session.exposure.map((one) => [
      `${segmentText(one.segment)} (${one.channel})`, `${one.dose.toFixed(1)} s`, `${(one.duty * 100).toFixed(0)} %`,
      `${one.heat.toFixed(1)} K`]), [1, 2, 3]));
  const dialog = el("dialog", { class: "wide", "aria-labelledby": "detail-title" },
    el("h2", { id: "detail-title" }, `${t.details(day(session.start))}: ${readable(session.reference)}`),
    ...blocks, exposure,
    el("form", { method: "dialog", class: "row" }, el("button", { class: "primary big", autofocus: true }, texts.close)));
  openDialog(dialog);
}
