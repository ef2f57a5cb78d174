// What a therapist reads from three metres: what happens now, which repetition, which score.
import { el, openDialog, say, setData, setText, table } from "../dom";
import type { Live } from "../live";
import { ALIGNMENT_PHASES, SESSION_PHASES, type RepetitionScore } from "../messages";
import { degrees } from "../model/error";
import type { Repetitions } from "../model/repetitions";
import { jointText, texts } from "../texts";

const t = texts.session;
const SHOWN = 8;

function number(value: number, digits = 0): string {
  return Number.isFinite(value) ? value.toFixed(digits) : t.noScore;
}

export class Status {
  readonly element: HTMLElement;
  private readonly phase = el("p", { class: "phase" });
  private readonly learner = el("p", { class: "who" });
  private readonly repetition = el("span", { class: "figure", id: "repetition" });
  private readonly planned = el("span", { class: "unit" });
  private readonly score = el("span", { class: "figure score", id: "score" });
  /// The scores of the block's repetitions; they stand beside the timeline.
  readonly bars = el("ol", { class: "score-bars", "aria-label": t.scores });
  private shownBars = "";

  constructor(private readonly repetitions: Repetitions) {
    this.element = el("section", { class: "card status", "aria-label": t.heading },
      this.phase, this.learner,
      el("div", { class: "figures-row" },
        el("p", {}, el("span", { class: "figure-name" }, t.repetition), this.repetition, this.planned),
        el("p", {}, el("span", { class: "figure-name" }, t.score), this.score, el("span", { class: "unit" }, t.scoreOf))));
  }

  /// Whether the learner is being compared with the expert right now.
  judged(live: Live): boolean {
    const phase = ALIGNMENT_PHASES[live.newest.alignment?.phase ?? 0];
    return this.running(live) && (phase === "moving" || phase === "paused");
  }

  frame(live: Live): void {
    const state = live.states.session_state;
    const words = this.words(live);
    setText(this.phase, words);
    const running = this.running(live);
    setData(this.phase, "state", !running ? "off" : words === t.phase.lost ? "lost" : "running");
    if (state == undefined) return;
    setText(this.learner, `${t.learner}: ${state.learner || t.nobody}`);
    const planned = state.block_planned;
    setText(this.repetition, String(planned > 0 ? state.block_repetitions : state.repetitions));
    setText(this.planned, planned > 0 ? t.of(planned) : "");
    const block = this.repetitions.ofBlock(state);
    const all = this.repetitions.ofSession(state);
    setText(this.score, all.length > 0 ? number(all.at(-1)!.total) : t.noScore);
    this.drawBars(block.slice(-SHOWN), planned);
  }

  private running(live: Live): boolean {
    const state = live.states.session_state;
    return live.connected && state != undefined && SESSION_PHASES[state.phase] === "running" && !state.resting;
  }

  private words(live: Live): string {
    const state = live.states.session_state;
    if (state == undefined) return t.phase.none;
    const phase = SESSION_PHASES[state.phase] ?? "idle";
    if (phase !== "running") return t.phase[phase];
    if (state.resting) return t.phase.resting;
    const at = ALIGNMENT_PHASES[live.newest.alignment?.phase ?? 0] ?? "waiting";
    return at === "paused" ? t.phase.still : t.phase[at];
  }

  private drawBars(scores: RepetitionScore[], planned: number): void {
    const key = `${planned}|${scores.map((s) => s.end_ns).join()}`;
    if (key === this.shownBars) return;
    if (this.shownBars !== "" && scores.length > 0) {
      const last = scores.at(-1)!;
      say(t.scoreBar(last.repetition, number(last.total), last.cues));
    }
    this.shownBars = key;
    const empty = planned > 0 ? Math.max(0, Math.min(SHOWN, planned) - scores.length) : 0;
    this.bars.replaceChildren(
      ...scores.map((score) => {
        const label = t.scoreBar(score.repetition, number(score.total), score.cues);
        const bar = el("span", { class: "bar", "aria-hidden": "true" });
        bar.style.height = `${Math.max(4, Math.min(100, score.total))}%`;
        return el("li", {}, el("button", { type: "button", "aria-label": label, title: label, onclick: () => this.detail(score) },
          el("span", { class: "bar-value", "aria-hidden": "true" }, number(score.total)),
          el("span", { class: "bar-room", "aria-hidden": "true" }, bar)));
      }),
      ...Array.from({ length: empty }, () => el("li", { class: "planned", "aria-hidden": "true" })));
  }

  private detail(score: RepetitionScore): void {
    const s = t.scoreTable;
    const rows = score.joints.map((joint) => joint.measured
      ? [jointText(joint.joint), `${number(degrees(joint.rms))}°`, `${number(degrees(joint.peak))}°`,
        `${number(joint.in_band * 100)} %`, Number.isFinite(joint.timing_error) ? `${number(joint.timing_error, 2)} s` : "",
        `${number(degrees(joint.range))}° (${number(degrees(joint.reference_range))}°)`]
      : [jointText(joint.joint), t.notMeasured, "", "", "", ""]);
    const dialog = el("dialog", { class: "wide", "aria-labelledby": "score-title" },
      el("h2", { id: "score-title" }, `${t.scoreTitle(score.repetition)}: ${number(score.total)} ${t.scoreOf}`),
      table(t.scoreTitle(score.repetition), [s.joint, s.rms, s.peak, s.inBand, s.timing, s.range], rows, [1, 2, 3, 4, 5]),
      el("form", { method: "dialog", class: "row" }, el("button", { class: "primary big" }, texts.close)));
    openDialog(dialog);
  }
}
