// Where in the exercise the learner is, how fast, and the plan's blocks.
import type { Plan } from "../api";
import { el, setData, setText } from "../dom";
import type { Live } from "../live";
import { readable, texts } from "../texts";
import { ALIGNMENT_PHASES, type SessionState } from "../messages";

const t = texts.timeline;
const SLOW = 0.85;
const FAST = 1.15;

export function scheduleText(schedule: string | { kind: string } | undefined): string {
  if (schedule == undefined) return "";
  const kind = typeof schedule === "string" ? schedule.split(" ")[0]! : schedule.kind;
  return t.schedule[kind] ?? readable(kind);
}

export class Timeline {
  readonly element: HTMLElement;
  plans: Plan[] = [];
  private readonly name = el("span", { class: "exercise" });
  private readonly seconds = el("span", { class: "seconds" });
  private readonly cursor = el("span", { class: "cursor" });
  private readonly filled = el("span", { class: "filled" });
  private readonly bar = el("div", {
    class: "position", role: "progressbar", "aria-label": t.position, "aria-valuemin": 0, "aria-valuemax": 100,
  }, this.filled, this.cursor);
  private readonly tempo = el("span", { class: "tempo-value" });
  private readonly tempoWords = el("span", { class: "tempo-words" });
  private readonly blocks = el("ol", { class: "blocks", "aria-label": t.plan });
  private shownBlocks = "";

  /// @param scores  what stands beside it
  constructor(scores: HTMLElement) {
    this.element = el("section", { class: "timeline card", "aria-label": t.heading },
      el("div", { class: "timeline-head" }, this.name, this.seconds,
        el("span", { class: "tempo" }, el("span", { class: "tempo-name" }, t.tempo), this.tempo, this.tempoWords)),
      this.bar, this.blocks, scores);
  }

  frame(live: Live, following: boolean): void {
    const state = live.states.session_state;
    if (state == undefined) return;
    const reference = live.states.references?.references.find(({ name }) => name === state.reference);
    const asked = state.block_tempo > 0 ? state.block_tempo : 1;
    const duration = (reference?.duration ?? 0) / asked;
    const alignment = following ? live.newest.alignment : undefined;
    setText(this.name, readable(state.reference));
    const at = Math.min(alignment?.reference_time ?? 0, duration);
    setText(this.seconds, t.seconds(at.toFixed(1), duration.toFixed(1)));
    const share = duration > 0 ? (at / duration) * 100 : 0;
    this.cursor.style.left = this.filled.style.width = `${share.toFixed(2)}%`;
    const whole = share.toFixed(0);
    if (this.bar.getAttribute("aria-valuenow") !== whole) this.bar.setAttribute("aria-valuenow", whole);
    const moving = ALIGNMENT_PHASES[alignment?.phase ?? 0] === "moving";
    const tempo = moving ? alignment?.tempo : undefined;
    setText(this.tempo, tempo == undefined ? "–" : t.times(tempo.toFixed(2)));
    setText(this.tempoWords, tempo == undefined ? "" : tempo < SLOW ? t.slower : tempo > FAST ? t.faster : t.asAsked);
    this.drawBlocks(state);
  }

  private drawBlocks(state: SessionState): void {
    const plan = this.plans.find(({ name }) => name === state.plan);
    const key = [state.plan, state.block, state.blocks, state.block_repetitions, state.block_planned, state.resting,
      state.block_name, plan != undefined].join("|");
    if (key === this.shownBlocks) return;
    this.shownBlocks = key;
    if (state.plan === "" || state.plan === "none") {
      this.blocks.replaceChildren(el("li", { "data-state": "now", class: "practice" }, el("span", { class: "block-name" }, t.practice)));
      return;
    }
    const items = Array.from({ length: Math.max(state.blocks, 1) }, (_, i) => {
      const block = plan?.blocks[i];
      const now = i === state.block;
      const when = now ? "now" : i < state.block ? "done" : "next";
      const planned = now ? state.block_planned : block?.repetitions ?? 0;
      const done = now ? state.block_repetitions : i < state.block ? planned : 0;
      const name = readable((now ? state.block_name : block?.name) || `${i + 1}`);
      const item = el("li", { "data-state": when, ...(now && { "aria-current": "step" }) },
        el("span", { class: "block-fill", "aria-hidden": "true" }),
        el("span", { class: "block-name" }, planned > 0 ? t.block(name, done, planned) : name),
        el("span", { class: "block-detail" }, block
          ? t.blockDetail(String(block.tempo ?? 1), scheduleText(block.schedule)) : now ? t.times(state.block_tempo.toFixed(2)) : ""),
        el("span", { class: "visually-hidden" }, t[when]));
      item.title = item.innerText;
      item.style.flexGrow = String(Math.max(planned, 2));
      item.querySelector<HTMLElement>(".block-fill")!.style.width = `${planned > 0 ? Math.min(100, (done / planned) * 100) : 0}%`;
      return item;
    });
    this.blocks.replaceChildren(...items);
    setData(this.blocks, "resting", String(state.resting));
  }
}
