// uPlot in the page's colours.
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { el } from "../dom";

const INK = "#b6c2cf";
const GRID = { stroke: "#2a333f", width: 1 };
const FONT = "14px system-ui, sans-serif";
export const LINES = ["#56b4e9", "#e69f00", "#3fbf93", "#cc79a7", "#f0e442", "#e8662a", "#7aa8ff", "#c9d1d9"];
const MOST_NAMED = 8;
const DASHES = [[], [8, 5], [2, 4], [10, 4, 2, 4]];

const DAY = 86400;

// A day and a bit at least: one session is a point on its date, not on an axis of years.
// uPlot itself takes a point alone for years.
function dates({ data: [times] }: uPlot): [number, number] {
  const from = times[0] ?? Date.now() / 1000;
  const to = times.at(-1) ?? from;
  const room = Math.max((to - from) * 0.05, DAY);
  return [from - room, to + room];
}

// The day, and the year where an axis is long.
const SPLITS = [1, 2, 7, 14, 30, 91, 182, 365].map((days) => days * DAY);
function dayNames(_plot: uPlot, splits: number[]): string[] {
  const long = (splits.at(-1) ?? 0) - (splits[0] ?? 0) > 300 * DAY;
  return splits.map((at) => new Date(at * 1000).toLocaleDateString("en-GB", { day: "numeric", month: "short", ...(long && { year: "2-digit" }) }));
}

export interface Line { label: string; dashed?: boolean; band?: boolean; points?: boolean; colour?: string }

export class Plot {
  readonly element: HTMLElement;
  private readonly room = el("div", { class: "plot-room" });
  private plot: uPlot | null = null;
  private data: uPlot.AlignedData;

  /// @param time  "clock": seconds since the epoch are shown as dates; "ago": as they are
  constructor(label: string, private readonly lines: Line[],
              private readonly options: { unit: string; time?: "clock" | "ago"; range?: [number, number]; height?: number }) {
    this.element = el("div", { class: "plot", role: "img", "aria-label": label }, this.room);
    this.data = [[], ...lines.map(() => [])] as unknown as uPlot.AlignedData;
    new ResizeObserver(() => this.resize()).observe(this.room);
  }

  set(data: (number | null)[][]): void {
    this.data = data as unknown as uPlot.AlignedData;
    this.plot?.setData(this.data);
  }

  private resize(): void {
    const width = Math.floor(this.room.clientWidth);
    if (width === 0) return;
    const height = this.options.height ?? 220;
    if (this.plot) this.plot.setSize({ width, height });
    else this.plot = new uPlot({ width, height, ...this.rest() }, this.data, this.room);
  }

  private rest(): Omit<uPlot.Options, "width" | "height"> {
    const { unit, time, range } = this.options;
    const axis = { stroke: INK, grid: GRID, ticks: GRID, font: FONT };
    return {
      cursor: { y: false },
      legend: { show: this.lines.length <= MOST_NAMED, live: false },
      scales: { x: { time: time === "clock", ...(time === "clock" && { range: dates }) }, y: { range: range ?? ((_plot, _low, high): [number, number] => [0, Math.max(1, high * 1.1)]) } },
      axes: [{ ...axis, ...(time === "clock" && { incrs: SPLITS, values: dayNames }) }, { ...axis, label: unit, labelFont: FONT, size: 58 }],
      series: [
        {},
        ...this.lines.map((line, i): uPlot.Series => ({
          label: line.label,
          stroke: line.colour ?? LINES[i % LINES.length]!,
          width: line.band || this.lines.length > MOST_NAMED ? 1.5 : 2.5,
          dash: line.dashed ? [8, 6] : DASHES[Math.floor(i / LINES.length) % DASHES.length]!,
          spanGaps: false,
          ...(line.band && { fill: "#56b4e922" }),
          points: { show: line.points ?? false, size: 9 },
        })),
      ],
    };
  }
}
