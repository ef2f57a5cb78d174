// Progress over weeks, what stayed, schedules compared.
import type { Progress, ProgressPoint, Retention } from "../api";
import { el, table } from "../dom";
import { texts } from "../texts";
import { Plot } from "./plot";
import { scheduleText } from "./timeline";

const t = texts.history;

function shown(value: number | null): string { return value == null ? "–" : value.toFixed(1); }

function day(iso: string): string { return new Date(iso).toLocaleDateString("en-GB", { dateStyle: "medium" }); }

/// One point a block; with and without cues are two lines.
export function progressPlot(points: ProgressPoint[], joint: string): HTMLElement {
  const sorted = [...points].sort((a, b) => a.start.localeCompare(b.start));
  const time: number[] = [];
  const cued: (number | null)[] = [];
  const alone: (number | null)[] = [];
  for (const point of sorted) {
    const value = joint === "" ? point.mean_total : point.joints[joint] ?? null;
    if (value == null) continue;
    // Blocks of one second stand side by side.
    const at = Date.parse(point.start) / 1000;
    time.push(time.length > 0 && at <= time.at(-1)! ? time.at(-1)! + 1 : at);
    cued.push(point.cued === false ? null : value);
    alone.push(point.cued === false ? value : null);
  }
  const plot = new Plot(t.progress, [{ label: t.cued, points: true }, { label: t.alone, points: true, dashed: true }], {
    unit: joint === "" ? t.total : texts.signals.degrees, time: "clock", height: 280, ...(joint === "" && { range: [0, 100] as [number, number] }),
  });
  plot.set([time, bridged(cued), bridged(alone)]);
  return plot.element;
}

// uPlot joins neighbours only; a gap of the other kind between two points is no gap of this kind.
function bridged(values: (number | null)[]): (number | null)[] {
  return values.map((value) => value ?? (undefined as unknown as null));
}

/// Each block alone beside the practice before it.
export function retentionPart(rows: Retention[]): HTMLElement | null {
  if (rows.length === 0) return null;
  const r = t.retentionTable;
  return el("div", {}, el("h3", {}, t.retention),
    table(t.retention, [r.when, r.kind, r.pause, r.practice, r.retention, r.change],
      rows.map(({ kind, practice, retention, pause, change }) => [day(retention.start), t.retentionKind[kind], t.pause(pause),
        shown(practice.mean_total), shown(retention.mean_total), `${change > 0 ? "+" : ""}${shown(change)}`]), [2, 3, 4, 5]));
}

export function schedulePart(rows: Progress["schedules"]): HTMLElement | null {
  if (rows.length === 0) return null;
  const s = t.scheduleTable;
  return el("div", {}, el("h3", {}, t.schedules),
    table(t.schedules, [s.schedule, s.sessions, s.first, s.last, s.retention],
      rows.map((row) => [scheduleText(row.schedule), String(row.sessions), shown(row.first), shown(row.last), shown(row.retention)]),
      [1, 2, 3, 4]));
}
