// Who learns what, and start, pause, end.
import { api, type Plan } from "../api";
import type { Connection } from "../connection";
import { ask, el, labelled, setText } from "../dom";
import type { Live } from "../live";
import { SESSION_PHASES } from "../messages";
import { readable, texts } from "../texts";

const t = texts.controls;
const NEW = "\u0000new";
const NO_PLAN = "none";

interface Stepper { element: HTMLElement; value: number; touched: boolean; set(value: number): void }

function stepper(name: string, id: string, values: number[], text: (v: number) => string, changed: () => void): Stepper {
  const shown = el("output", { id, "aria-live": "polite" });
  let value = values[0]!;
  const move = (by: number): void => {
    // From a value of the command line that is none of ours, to the next of ours.
    const larger = values.findIndex((v) => v > value + 1e-9);
    const smaller = values.findLastIndex((v) => v < value - 1e-9);
    const to = by > 0 ? larger : smaller;
    if (to < 0) return;
    set(values[to]!);
    stepper.touched = true;
    changed();
  };
  const less = el("button", { type: "button", "aria-label": `${name}: ${t.less}`, onclick: () => move(-1) }, "−");
  const more = el("button", { type: "button", "aria-label": `${name}: ${t.more}`, onclick: () => move(1) }, "+");
  const set = (to: number): void => {
    value = to;
    setText(shown, text(to));
  };
  set(value);
  const stepper: Stepper = {
    element: el("div", { class: "field", role: "group", "aria-label": name },
      el("span", { class: "field-name" }, name), el("span", { class: "stepper" }, less, shown, more)),
    get value() { return value; },
    touched: false,
    set,
  };
  return stepper;
}

export class Controls {
  readonly element: HTMLElement;
  private readonly learner = el("select", { id: "learner" });
  private readonly reference = el("select", { id: "reference" });
  private readonly plan = el("select", { id: "plan" });
  private readonly tolerance = stepper(t.tolerance, "tolerance", [0.5, 0.75, 1, 1.25, 1.5, 2, 3], (v) => t.times(String(v)), () => this.edited());
  private readonly cues = stepper(t.cues, "cues", [1, 2, 3, 4, 6, 8], String, () => this.edited());
  private readonly main = el("button", { class: "primary big", id: "main", type: "button" });
  private readonly end = el("button", { class: "big", id: "end", type: "button" }, t.end);
  private readonly hint = el("p", { class: "hint", id: "hint", role: "status" });
  private touched = false;   // the user chose something that the session does not have yet
  private history = false;
  private own: string[] = [];

  constructor(private readonly live: Live, private readonly connection: Connection) {
    this.element = el("section", { class: "controls card", "aria-label": t.heading },
      labelled(t.learner, this.learner), labelled(t.reference, this.reference), labelled(t.plan, this.plan),
      this.tolerance.element, this.cues.element,
      el("div", { class: "actions" }, this.main, this.end), this.hint);
    this.main.addEventListener("click", () => this.toggle());
    this.end.addEventListener("click", () => void this.finish());
    for (const select of [this.reference, this.plan]) select.addEventListener("change", () => this.edited());
    this.learner.addEventListener("change", () => void this.choseLearner());
    live.on("references", () => this.listReferences());
    live.on("session_state", () => this.adopt());
    this.tolerance.set(1);
    this.cues.set(2);
    this.learner.append(el("option", { value: "" }, t.keepLearner));
    this.setPlans([]);
    this.listReferences();
    this.adopt();
  }

  setPlans(plans: Plan[]): void {
    this.fill(this.plan, [[NO_PLAN, t.noPlan], ...plans.map(({ name }): [string, string] => [name, readable(name)])]);
    this.adopt();
  }

  async loadLearners(history: boolean): Promise<void> {
    this.history = history;
    if (!history) return;
    const learners = await api.learners().catch(() => []);
    this.fill(this.learner, [["", t.keepLearner],
      ...learners.map(({ id, note }): [string, string] => [id, note ? `${id} · ${note}` : id]), [NEW, t.newLearner]]);
    this.adopt();
  }

  /// Start, pause or go on: whatever comes next.
  toggle(): void {
    const phase = this.phase();
    if (phase === "running" && !this.touched) this.connection.session({ action: "pause" });
    else if (phase === "paused" && !this.touched) this.connection.session({ action: "resume" });
    else this.start();
  }

  frame(): void {
    const phase = this.phase();
    setText(this.main, phase === "running" ? (this.touched ? t.startNew : t.pause)
      : phase === "paused" ? (this.touched ? t.startNew : t.resume) : t.start);
    const off = !this.live.connected || this.reference.options.length === 0;
    if (this.main.disabled !== off) this.main.disabled = off;
    const noEnd = !this.live.connected || (phase !== "running" && phase !== "paused");
    if (this.end.disabled !== noEnd) this.end.disabled = noEnd;
  }

  refused(why: string): void { setText(this.hint, t.failed(why)); }

  private start(): void {
    const sent = this.connection.session({
      action: "start", reference: this.reference.value, plan: this.plan.value,
      // What the user left alone stays as the coach has it; what is shown may be a block's own.
      ...(this.tolerance.touched && { tolerance_scale: this.tolerance.value }),
      ...(this.cues.touched && { max_cues: this.cues.value }),
      ...(this.learner.value !== "" && { learner: this.learner.value }),
    });
    if (!sent) return;
    this.touched = this.tolerance.touched = this.cues.touched = false;
    setText(this.hint, "");
  }

  private async finish(): Promise<void> {
    if (await ask({ title: t.endTitle, body: t.endBody, yes: t.endYes, no: texts.cancel })) {
      this.connection.session({ action: "stop" });
    }
  }

  private phase(): string { return SESSION_PHASES[this.live.states.session_state?.phase ?? 0] ?? "idle"; }

  private edited(): void {
    this.touched = true;
    const phase = this.phase();
    setText(this.hint, phase === "running" || phase === "paused" ? t.next : "");
  }

  private async choseLearner(): Promise<void> {
    if (this.learner.value !== NEW) return this.edited();
    try {
      const { id } = await api.addLearner();
      await this.loadLearners(true);
      this.learner.value = id;
    } catch (error) {
      this.learner.value = "";
      this.refused((error as Error).message);
    }
    this.edited();
  }

  /// The user's own references, which the coach may not have listed yet: it finds them by name.
  setOwnReferences(names: string[]): void {
    this.own = names;
    this.listReferences();
  }

  private listReferences(): void {
    const listed = this.live.states.references?.references.map(({ name }) => name) ?? [];
    const names = [...new Set([...listed, ...(listed.length > 0 ? this.own : [])])];
    this.fill(this.reference, names.map((name) => [name, readable(name)]));
    this.adopt();
  }

  // What the session says stands in the controls, unless the user is choosing something else.
  private adopt(): void {
    const state = this.live.states.session_state;
    if (state == undefined || this.touched) return;
    this.choose(this.reference, state.reference);
    this.choose(this.plan, state.plan || NO_PLAN);
    if (state.learner !== "") this.choose(this.learner, state.learner);
    if (state.tolerance_scale > 0) this.tolerance.set(Math.round(state.tolerance_scale * 100) / 100);
    if (state.max_cues > 0) this.cues.set(state.max_cues);
  }

  private choose(select: HTMLSelectElement, value: string): void {
    if (![...select.options].some((option) => option.value === value)) {
      if (value === "" || (select === this.learner && !this.history)) return;
      select.append(el("option", { value }, readable(value)));
    }
    if (select.value !== value) select.value = value;
  }

  private fill(select: HTMLSelectElement, options: [string, string][]): void {
    const before = select.value;
    select.replaceChildren(...options.map(([value, text]) => el("option", { value }, text)));
    if (options.some(([value]) => value === before)) select.value = before;
  }
}
