// The coach run again with other settings, and what it would have done beside what it did.
import { api, type Job, type Rerun } from "../api";
import { el, labelled, setText, table } from "../dom";
import type { RepetitionScore } from "../messages";
import { degrees } from "../model/error";
import { HttpBytes, openRecording, openStates } from "../model/recording";
import { Track, type Player } from "../player";
import { jointText, readable, texts } from "../texts";
import { Plot } from "./plot";

const t = texts.rerun;
const POLL = 300;    // [ms]
const AROUND = 10;   // shown before and after the play head [s]
const EVERY = 150;   // between two drawings of the plot [ms]
const TOLERANCES = [0.5, 0.75, 1, 1.25, 1.5, 2, 3];
const CUES = [1, 2, 3, 4, 6, 8];

const mean = (values: number[]): number => values.reduce((a, b) => a + b, 0) / values.length;

export class Compare {
  readonly element: HTMLElement;
  private readonly reference = el("select", { id: "rerun-reference" });
  private readonly tolerance = el("select", { id: "rerun-tolerance" });
  private readonly cues = el("select", { id: "rerun-cues" });
  private readonly bodyMap = el("select", { id: "rerun-body-map" });
  private readonly plan = el("select", { id: "rerun-plan" });
  private readonly run = el("button", { type: "button", class: "primary", id: "rerun" }, t.run);
  private readonly message = el("p", { role: "status", id: "rerun-message" });
  private readonly tables = el("div", { class: "plots" });
  private readonly joint = el("select", { id: "compare-joint" });
  private readonly plot = new Plot(t.plot, [
    { label: t.line.recorded, colour: "#56b4e9" }, { label: t.line.rerun, colour: "#e69f00" },
    { label: t.line.tolerance, colour: "#56b4e9", dashed: true }, { label: t.line.toleranceAgain, colour: "#e69f00", dashed: true },
    { label: t.line.head, colour: "#ffffff" },
  ], { unit: texts.signals.degrees, time: "ago" });
  private drawn = 0;

  constructor(private readonly name: string, private readonly player: Player, server: boolean, private readonly show: (track: Track) => void) {
    const track = player.tracks[0]!;
    const state = track.states.find(({ name: one }) => one === "references")?.message as { references: { name: string }[] } | undefined;
    const option = (value: string | number, text: string): HTMLElement => el("option", { value }, text);
    const same = (): HTMLElement => option("", t.asRecorded);
    this.reference.append(same(), ...(state?.references ?? []).map(({ name: one }) => option(one, readable(one))));
    this.tolerance.append(same(), ...TOLERANCES.map((value) => option(value, texts.player.times(value))));
    this.cues.append(same(), ...CUES.map((value) => option(value, String(value))));
    this.bodyMap.append(same());
    this.plan.append(same(), option("none", t.noPlan));
    const form = name === "" ? el("p", { class: "muted" }, t.onlyBridge) : !server ? el("p", { class: "muted" }, t.notCoached)
      : el("div", { class: "row fields" }, labelled(t.reference, this.reference), labelled(t.tolerance, this.tolerance),
        labelled(t.cues, this.cues), labelled(t.bodyMap, this.bodyMap), labelled(t.plan, this.plan), this.run);
    this.run.addEventListener("click", () => void this.start());
    const joints = track.repetitions()[0]?.joints.filter(({ measured }) => measured).map(({ joint }) => joint) ?? [];
    this.joint.append(...joints.map((joint) => option(joint, jointText(joint))));
    this.joint.value = this.worst(track) ?? joints[0] ?? "";
    this.joint.addEventListener("change", () => { this.drawn = 0; });
    this.element = el("section", { class: "card compare", "aria-label": t.heading },
      el("h2", {}, t.heading), el("p", { class: "muted" }, t.hint), form, this.message, this.tables,
      el("div", { hidden: joints.length === 0 }, el("div", { class: "row fields" }, labelled(`${t.plot}: ${t.joint}`, this.joint)), this.plot.element));
    if (server) void this.listChoices();
  }

  frame(): void {
    const now = performance.now();
    if (now - this.drawn < EVERY || this.joint.value === "") return;
    this.drawn = now;
    const { head } = this.player.playback;
    const joint = this.joint.value;
    const lines = this.player.tracks.map((track) => {
      const points: { time: number; error: number; tolerance: number }[] = [];
      for (const { time, joints } of track.errors(head - AROUND, head + AROUND)) {
        const line = joints.get(joint);
        time.forEach((at, i) => { if (line && Math.abs(at - head) <= AROUND) points.push({ time: at, error: line.error[i]!, tolerance: line.tolerance[i]! }); });
      }
      return points;
    });
    // One axis for both: a re-run is at the recording's own times.
    const times = [...new Set(lines.flat().map(({ time }) => time))].sort((a, b) => a - b);
    const columns = lines.map((points) => new Map(points.map((point) => [point.time, point])));
    const column = (i: number, of: "error" | "tolerance"): (number | null)[] => times.map((time) => columns[i]?.get(time)?.[of] ?? null);
    const top = Math.max(1, ...lines.flat().map(({ error, tolerance }) => Math.max(error, tolerance)));
    // The play head is an upright line: two points, all but above each other; the curves are held there.
    const at = times.findIndex((time) => time >= head);
    const where = at < 0 ? times.length : at;
    const data = [times, column(0, "error"), column(1, "error"), column(0, "tolerance"), column(1, "tolerance"), times.map(() => null)] as (number | null)[][];
    data.forEach((list, k) => {
      const held = list[where] ?? list[where - 1] ?? null;
      list.splice(where, 0, ...(k === 0 ? [head - 1e-7, head + 1e-7] : k === 5 ? [0, top] : [held, held]));
    });
    this.plot.set(data);
  }

  private async listChoices(): Promise<void> {
    const maps = await api.bodyMaps().catch(() => []);
    this.bodyMap.append(...maps.map((name) => el("option", { value: name }, readable(name))));
    const plans = await api.plans().catch(() => []);
    this.plan.append(...plans.map(({ name }) => el("option", { value: name }, readable(name))));
  }

  private worst(track: Track): string | undefined {
    const all = this.means(track.repetitions());
    return [...all].sort((a, b) => b[1].rms - a[1].rms)[0]?.[0];
  }

  private means(scores: RepetitionScore[]): Map<string, { rms: number; inBand: number }> {
    const out = new Map<string, { rms: number; inBand: number }>();
    for (const joint of new Set(scores.flatMap(({ joints }) => joints.map((one) => one.joint)))) {
      const seen = scores.flatMap(({ joints }) => joints.filter((one) => one.joint === joint && one.measured));
      if (seen.length > 0) out.set(joint, { rms: mean(seen.map(({ rms }) => rms)), inBand: mean(seen.map(({ in_band }) => in_band)) });
    }
    return out;
  }

  private async start(): Promise<void> {
    const settings: Rerun = {
      ...(this.reference.value && { reference: this.reference.value }),
      ...(this.tolerance.value && { tolerance_scale: Number(this.tolerance.value) }),
      ...(this.cues.value && { max_cues: Number(this.cues.value) }),
      ...(this.bodyMap.value && { body_map: this.bodyMap.value }),
      ...(this.plan.value && { plan: this.plan.value }),
    };
    this.run.disabled = true;
    try {
      let job: Job = await api.rerun(this.name, settings);
      while (job.state === "waiting" || job.state === "running") {
        setText(this.message, t.running(Math.round(job.progress * 100)));
        await new Promise((done) => setTimeout(done, POLL));
        job = await api.rerunState(this.name, job.job);
      }
      if (job.state === "failed") throw new Error(job.error);
      const bytes = new HttpBytes(api.rerunUrl(this.name, job.job, "file"));
      const states = await openStates(bytes, api.rerunUrl(this.name, job.job, "states"));
      const track = await Track.open(await openRecording(bytes), this.player.tracks[0]!.base, states);
      this.show(track);
      this.tell(track, job.result?.remarks ?? []);
    } catch (error) {
      setText(this.message, t.failed((error as Error).message));
    }
    this.run.disabled = false;
  }

  private tell(track: Track, remarks: string[]): void {
    const before = this.player.tracks[0]!.repetitions();
    const after = track.repetitions();
    const sum = (scores: RepetitionScore[]): number => scores.reduce((all, { cues }) => all + cues, 0);
    setText(this.message, [t.done(sum(before), sum(after)), ...remarks].join(". "));
    const cell = (score: RepetitionScore | undefined, of: "total" | "cues"): string => (score ? score[of].toFixed(0) : t.none);
    const rows = Array.from({ length: Math.max(before.length, after.length) }, (_, i) => [String(i + 1),
      cell(before[i], "total"), cell(after[i], "total"), cell(before[i], "cues"), cell(after[i], "cues")]);
    const old = this.means(before);
    const fresh = this.means(after);
    const angle = (one?: { rms: number }): string => (one ? `${degrees(one.rms).toFixed(1)}°` : t.none);
    const share = (one?: { inBand: number }): string => (one ? `${(one.inBand * 100).toFixed(0)} %` : t.none);
    const joints = [...new Set([...old.keys(), ...fresh.keys()])].sort((a, b) => (old.get(b)?.rms ?? 0) - (old.get(a)?.rms ?? 0))
      .map((joint) => [jointText(joint), angle(old.get(joint)), angle(fresh.get(joint)), share(old.get(joint)), share(fresh.get(joint))]);
    const s = t.table;
    const j = t.jointTable;
    this.tables.replaceChildren(
      el("section", { id: "compare-scores" }, el("h3", {}, t.scores), table(t.scores, [s.repetition, s.score, s.again, s.cues, s.cuesAgain], rows, [1, 2, 3, 4])),
      el("section", { id: "compare-joints" }, el("h3", {}, t.joints), table(t.joints, [j.joint, j.error, j.again, j.inBand, j.inBandAgain], joints, [1, 2, 3, 4])));
  }
}
