// For whoever sets the system up: is each source healthy, how late is it, how far off are the joints.
import { seconds } from "../connection";
import { el, setData, setText, table } from "../dom";
import type { Live } from "../live";
import { ALIGNMENT_PHASES, SERVICE_STATES, type ServiceHealth } from "../messages";
import { degrees, norm } from "../model/error";
import { Series } from "../model/series";
import { jointText, readable, texts } from "../texts";
import { Plot } from "./plot";

const t = texts.signals;
const SPAN = 30;           // of the plots [s]
const DRAW = 0.2;          // plots are redrawn so often [s]
const SILENT = 3;          // a service says something once a second
const PLOTS = 4;
const GROUP = 8;           // detectors with a name each
const FIRST = ["left_shoulder", "right_shoulder", "left_elbow", "right_elbow"];

function ms(value: number): string { return Number.isFinite(value) ? (value * 1000).toFixed(1) : "–"; }
function percent(value: number): string { return `${(value * 100).toFixed(value > 0 && value < 0.01 ? 2 : 0)} %`; }

interface JointPlot { joint: string; select: HTMLSelectElement; series: Series; plot: Plot; element: HTMLElement }

export class SignalsView {
  readonly element: HTMLElement;
  private readonly services = new Map<string, { health: ServiceHealth; came: number }>();
  private readonly list = el("div", {});
  private readonly latency = new Series(["latency"], SPAN);
  private readonly latencyPlot = new Plot(t.latency, [{ label: t.latencyLine }], { unit: t.latencyUnit });
  private readonly joints: JointPlot[];
  private readonly projector = el("select", { "aria-label": t.projector });
  private readonly detector = el("select", { "aria-label": t.detectors });
  private readonly rawRoom = el("div", {}, el("p", { class: "muted" }, t.rawNone));
  private readonly rawNow = el("p", { id: "raw-now" });  // no status: it changes all the time
  private readonly hold = el("button", { type: "button", "aria-pressed": "false" }, t.hold);
  private raw: { series: Series; plot: Plot; key: string; count: number; projectors: number; detectors: number[] } | null = null;
  private start: bigint | null = null;
  private drawn = 0;
  private listed = 0;
  private held = false;

  constructor(private readonly live: Live) {
    this.joints = FIRST.slice(0, PLOTS).map((joint) => this.jointPlot(joint));
    this.hold.addEventListener("click", () => {
      this.held = !this.held;
      this.hold.setAttribute("aria-pressed", String(this.held));
    });
    this.projector.addEventListener("change", () => this.raw?.series.clear());
    this.detector.addEventListener("change", () => { if (this.raw) this.makeRaw(this.raw.count, this.raw.projectors, this.raw.key); });
    const section = (heading: string, ...children: (Node | null)[]): HTMLElement =>
      el("section", { class: "card" }, el("h2", {}, heading), ...children);
    this.element = el("div", { class: "signals" },
      section(t.services, this.list),
      section(t.latency, this.latencyPlot.element),
      section(t.errors, el("div", { class: "row" }, el("p", { class: "muted" }, t.errorsHint), this.hold),
        el("div", { class: "plots" }, ...this.joints.map(({ element }) => element))),
      section(t.raw, el("p", { class: "muted" }, t.rawHint), this.rawRoom));
    live.on("health", (health) => {
      const known = this.services.get(health.service);
      // One line a service: the newest instance; a late word of an earlier one does not count.
      if (known && known.health.publish_ns > health.publish_ns) return;
      this.services.set(health.service, { health, came: seconds() });
    });
    live.on("skeleton", (skeleton) => this.listJoints(skeleton.joints.map(({ name }) => name)));
  }

  /// Collects in every view, draws only when shown.
  frame(shown: boolean): void {
    this.collect();
    const now = seconds();
    if (!shown) return;
    if (now - this.listed > 0.5) {
      this.listed = now;
      this.listServices(now);
    }
    if (this.held || now - this.drawn < DRAW) return;
    this.drawn = now;
    this.latencyPlot.set([this.latency.time, ...this.latency.lines]);
    for (const { series, plot } of this.joints) plot.set([series.time, ...series.lines]);
    if (this.raw) {
      this.raw.plot.set([this.raw.series.time, ...this.raw.series.lines]);
      setText(this.rawNow, this.rawWords(this.raw));
    }
  }

  private collect(): void {
    const { tactors, correction, raw, alignment } = this.live.newest;
    if (this.live.isFresh("tactors") && tactors) {
      const { stamp_ns, publish_ns } = tactors.header;
      this.latency.push(this.time(stamp_ns), [Number(publish_ns - stamp_ns) / 1e6]);
    }
    if (this.live.isFresh("correction") && correction) {
      const time = this.time(correction.header.stamp_ns);
      // An error says something only while the learner is being followed.
      const phase = ALIGNMENT_PHASES[alignment?.phase ?? 0];
      const followed = phase === "moving" || phase === "paused";
      for (const { joint, series } of this.joints) {
        const found = correction.joints.find((one) => one.joint === joint);
        if (found) series.push(time, [degrees(found.tolerance), followed ? degrees(norm(found.error)) : null]);
      }
    }
    if (this.live.isFresh("raw") && raw) {
      const key = `${raw.detectors}x${raw.projectors}`;
      if (this.raw?.key !== key) this.makeRaw(raw.detectors, raw.projectors, key);
      const projector = Number(this.projector.value);
      this.raw!.series.push(this.time(raw.header.stamp_ns), this.raw!.detectors.map((d) => {
        const value = raw.values[d * raw.projectors + projector] ?? 0;
        return value === 0 ? null : value;
      }));
    }
  }

  // The newest values of the plot in words: of all detectors how many, of eight each.
  private rawWords({ series, detectors }: { series: Series; detectors: number[] }): string {
    if (series.time.length === 0) return t.none;
    const values = series.lines.map((line) => line.at(-1) ?? 0);
    const seen = values.filter((value) => value > 0);
    if (detectors.length <= GROUP) return t.values(values, detectors[0] ?? 0);
    return t.received(seen.length, values.length, Math.min(...seen), Math.max(...seen));
  }

  // Seconds since the page first saw data: plain numbers on the axis.
  private time(stamp: bigint): number {
    this.start ??= stamp;
    return Number(stamp - this.start) / 1e9;
  }

  // A suit has a hundred detectors: all at once as thin lines, or eight by name.
  private makeRaw(count: number, projectors: number, key: string): void {
    const options = (select: HTMLSelectElement, texts: string[]): void => {
      if (select.options.length === texts.length) return;
      select.replaceChildren(...texts.map((text, value) => el("option", { value }, text)));
    };
    options(this.projector, Array.from({ length: projectors }, (_, p) => `${t.projector} ${p}`));
    const groups = Math.ceil(count / GROUP);
    options(this.detector, [t.allDetectors, ...Array.from({ length: groups }, (_, g) =>
      t.someDetectors(g * GROUP, Math.min(count, (g + 1) * GROUP) - 1))]);
    const group = Number(this.detector.value) - 1;
    const detectors = Array.from({ length: count }, (_, d) => d).filter((d) => group < 0 || Math.floor(d / GROUP) === group);
    const names = detectors.map(t.detector);
    const plot = new Plot(t.raw, names.map((label) => ({ label })), { unit: t.value, range: [0, 256], height: 320 });
    this.raw = { series: new Series(names, SPAN, 2000), plot, key, count, projectors, detectors };
    this.rawRoom.replaceChildren(el("div", { class: "row" }, this.projector, this.detector), this.rawNow, plot.element);
  }

  private jointPlot(joint: string): JointPlot {
    const select = el("select", { "aria-label": t.errors }, el("option", { value: joint }, jointText(joint)));
    const series = new Series(["tolerance", "error"], SPAN);
    const plot = new Plot(t.errors, [
      { label: t.toleranceLine, band: true, dashed: true }, { label: t.errorLine, colour: "#e69f00" },
    ], { unit: t.degrees, height: 190 });
    const one: JointPlot = { joint, select, series, plot, element: el("div", { class: "joint-plot" }, select, plot.element) };
    select.addEventListener("change", () => {
      one.joint = select.value;
      series.clear();
    });
    return one;
  }

  private listJoints(names: string[]): void {
    for (const { select, joint } of this.joints) {
      select.replaceChildren(...names.map((name) => el("option", { value: name, selected: name === joint }, jointText(name))));
    }
  }

  private listServices(now: number): void {
    if (this.services.size === 0) {
      this.list.replaceChildren(el("p", { class: "muted" }, t.servicesNone));
      return;
    }
    const s = t.serviceTable;
    const all = [...this.services.values()].sort((a, b) => a.health.service.localeCompare(b.health.service));
    const rows = all.map(({ health, came }) => {
      const silent = now - came;
      const state = SERVICE_STATES[health.state] ?? "fault";
      const quiet = silent > SILENT && state !== "ended";
      const badge = el("span", { class: "badge", "data-state": quiet ? "fault" : state },
        quiet ? t.silent(Math.round(silent)) : t.state[state]);
      return [readable(health.service), badge, `${health.rate_hz.toFixed(0)} Hz`,
        health.latency_p50 > 0 ? `${ms(health.latency_p50)}, ${ms(health.latency_p99)} ms` : "–",
        String(health.lost), percent(health.confidence), health.message || "–"];
    });
    const room = this.list.querySelector(".table-scroll");
    const sensors = all.filter(({ health }) => health.sensors.length > 0);
    // The tables are made anew, but never under a finger or a focus.
    if (room?.contains(document.activeElement) || this.list.querySelector("details[open]")) return;
    this.list.replaceChildren(
      table(t.services, [s.service, s.state, s.rate, s.latency, s.lost, s.confidence, s.message], rows, [2, 3, 4, 5]),
      ...sensors.map(({ health }) => el("details", {},
        el("summary", {}, `${readable(health.service)}: ${t.sensors(health.sensors.length)}`),
        table(health.service, [t.sensorTable.name, t.sensorTable.rate, t.sensorTable.loss, t.sensorTable.confidence],
          health.sensors.map((one) => [one.name, `${one.rate_hz.toFixed(0)} Hz`, percent(one.loss), percent(one.confidence)]), [1, 2, 3]))));
    setData(this.list, "services", all.map(({ health }) => health.service).join(" "));
    setText(this.hold, this.held ? t.run : t.hold);
  }
}
