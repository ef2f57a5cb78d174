// Progress over weeks, what stayed, schedules compared.
import type { Progress, ProgressPoint } from "../api";
import { el, table } from "../dom";
import { readable, texts } from "../texts";
import { Plot } from "./plot";
import { scheduleText } from "./timeline";

const t = texts.history;

function shown(value: unknown): string {
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : value.toFixed(1);
  if (typeof value === "string" && /^\d{4}-\d\d-\d\dT/.test(value)) return new Date(value).toLocaleDateString("en-GB", { dateStyle: "medium" });
  return value == null ? "–" : String(value);
}

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
    cued.push(point.cued ? value : null);
    alone.push(point.cued ? null : value);
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

/// Whatever fields the history gives, one row each.
export function retentionPart(rows: unknown[]): HTMLElement | null {
  const objects = rows.filter((row): row is Record<string, unknown> => row != null && typeof row === "object");
  if (objects.length === 0) return null;
  const fields = Object.keys(objects[0]!).filter((field) => typeof objects[0]![field] !== "object" || objects[0]![field] == null);
  return el("div", {}, el("h3", {}, t.retention),
    table(t.retention, fields.map(readable), objects.map((row) => fields.map((field) => shown(row[field])))));
}

export function schedulePart(rows: Progress["schedules"]): HTMLElement | null {
  if (rows.length === 0) return null;
  const s = t.scheduleTable;
  return el("div", {}, el("h3", {}, t.schedules),
    table(t.schedules, [s.schedule, s.sessions, s.first, s.last, s.retention],
      rows.map((row) => [scheduleText(row.schedule), String(row.sessions), shown(row.first), shown(row.last), shown(row.retention)]),
      [1, 2, 3, 4]));
}
