// Record a reference: takes, which repetitions count, which joints matter, a name, and train with it.
import { api, type ChosenPart, type Draft, type RecorderState, type TakeInfo } from "../api";
import { seconds, type Connection } from "../connection";
import { ask, el, labelled, say, setData, setText } from "../dom";
import type { Live } from "../live";
import { plainName } from "../model/names";
import { readable, texts } from "../texts";
import { LINES } from "./plot";
import "./record.css";
import { curves, jointList, proposed, type Choice } from "./record_joints";
import { takeList } from "./record_parts";
import { Performance, TakeStage, type Shown } from "./take_stage";
import { TakePlayer } from "./take_player";

const t = texts.record;
const POLL = 0.25;     // [s]
const SETTLE = 400;    // after a change, before it is averaged [ms]
const DRAWN = 30;      // of a draft's times [Hz]
const MEAN = "#ffffff";

export class RecordView {
  readonly element: HTMLElement;
  private readonly stage: TakeStage | null;
  private readonly player = new TakePlayer();
  private readonly overlay = el("div", { class: "record-overlay", role: "status", hidden: true });
  private readonly steps = t.steps.map((name, i) =>
    el("button", { type: "button", class: "step", onclick: () => this.go(i) }, `${i + 1} ${name}`));
  private readonly panel = el("div", { class: "record-panel" });
  private readonly message = el("p", { class: "message", role: "alert", hidden: true });
  private readonly source = el("p", { class: "record-source", role: "status" });
  private readonly main = el("button", { type: "button", class: "primary big", id: "record-main" }, t.start);
  private readonly countdown = this.choice("record-countdown", [3, 5, 10], 5);
  private readonly longest = this.choice("record-longest", [15, 30, 60, 120], 60);
  private readonly file = el("input", { type: "file", id: "record-file", accept: ".bvh,.c3d,.trc,.mcap,.txt,.gz" });
  private readonly takeRoom = el("div", {});
  private readonly draftRoom = el("div", {});
  private readonly name = el("input", { type: "text", id: "reference-name", maxlength: 64, autocomplete: "off" });
  private readonly description = el("input", { type: "text", id: "reference-description", maxlength: 200, autocomplete: "off" });
  private readonly standing = el("input", { type: "checkbox", id: "reference-standing" });

  private step = 0;
  private takes: TakeInfo[] = [];
  private state: RecorderState | null = null;
  private draft: Draft | null = null;
  private joints: Choice = {};
  private drafted = "";          // what the draft was made of
  private readonly motions = new Map<string, Performance>();
  private ids = 1;
  private asked = 0;
  private polled = 0;
  private busy = false;
  private timer = 0;
  private savedName = "";

  constructor(private readonly live: Live, private readonly connection: Connection, private readonly saved: () => void) {
    try {
      this.stage = new TakeStage();
    } catch {
      this.stage = null;
    }
    this.main.addEventListener("click", () => void this.toggle());
    this.file.addEventListener("change", () => void this.bring());
    this.name.addEventListener("input", () => this.sayName());
    this.element = el("div", { class: "record" },
      el("section", { class: "card stage record-stage", "aria-label": t.stage },
        this.stage?.element ?? el("p", { class: "notice" }, texts.session.noWebgl), this.overlay, this.player.element),
      el("section", { class: "card record-side" },
        el("nav", { class: "record-steps", "aria-label": t.stepsLabel }, ...this.steps), this.message, this.panel));
    this.player.set(0);
    this.go(0);
  }

  /// A key in the view. @returns whether it means something here.
  key(key: string): boolean {
    if (key === " " && this.step === 0) {
      void this.toggle();
      return true;
    }
    if (key === " ") return false;
    return this.stage?.key(key) ?? false;
  }

  /// Once an animation frame.
  frame(shown: boolean): void {
    if (!shown) return;
    const now = seconds();
    if (now - this.polled > POLL && !this.busy) {
      this.polled = now;
      void this.poll();
    }
    this.player.frame(now);
    if (this.step === 0) this.stage?.live(this.live.states.skeleton, this.live.newest.pose);
    else this.stage?.pose(this.player.time);
    this.stage?.frame();
  }

  // ---- steps

  private go(step: number): void {
    this.step = step;
    this.tell("");
    this.steps.forEach((button, i) => {
      if (i === step) button.setAttribute("aria-current", "step");
      else button.removeAttribute("aria-current");
    });
    if (step > 0) this.stage?.live(undefined, undefined);
    else {
      this.stage?.show([]);
      this.player.set(0);
      this.drafted = "";
    }
    this.panel.replaceChildren(el("h2", { class: "visually-hidden" }, t.steps[step] ?? ""), ...[() => this.recordStep(), () => this.chooseStep(), () => this.jointsStep(), () => this.saveStep()][step]!());
    this.listTakes();
    if (step > 0) void this.makeDraft();
    if (step === 3) this.sayName();
  }

  private walk(back: boolean, next: boolean): HTMLElement {
    return el("div", { class: "row walk" },
      back && el("button", { type: "button", class: "big", onclick: () => this.go(this.step - 1) }, t.back), el("span", { class: "gap" }),
      next && el("button", { type: "button", class: "big", id: "record-next", onclick: () => this.go(this.step + 1) }, t.next));
  }

  private recordStep(): HTMLElement[] {
    return [this.source, el("p", { class: "muted" }, t.quiet),
      el("div", { class: "row fields" }, labelled(t.countdown, this.countdown), labelled(t.longest, this.longest)),
      this.main, el("p", { class: "muted" }, t.space),
      el("h3", {}, t.takes), this.takeRoom,
      el("label", { class: "field" }, el("span", { class: "field-name" }, `${t.file} (${t.fileHint})`), this.file), this.walk(false, true)];
  }

  private chooseStep(): HTMLElement[] {
    return [el("p", { class: "muted" }, t.chooseHint), this.takeRoom,
      el("button", { type: "button", onclick: () => this.showDraft() }, t.overlay), this.draftRoom, this.walk(true, true)];
  }

  private jointsStep(): HTMLElement[] { return [el("p", { class: "muted" }, t.jointsHint), this.draftRoom, this.walk(true, true)]; }

  private saveStep(): HTMLElement[] {
    return [this.draftRoom, labelled(t.name, this.name, el("span", { class: "muted", id: "name-hint", role: "status" })),
      labelled(t.description, this.description), el("label", { class: "check" }, this.standing, t.standing),
      el("button", { type: "button", class: "primary big", id: "save-reference", onclick: () => void this.save() }, t.save),
      this.walk(true, false)];
  }

  // ---- recording

  private async poll(): Promise<void> {
    this.busy = true;
    try {
      const { state, takes } = await api.takes();
      this.take(state, takes);
    } catch {
      // The page says that the connection is lost.
    }
    this.busy = false;
  }

  private take(state: RecorderState, takes: TakeInfo[]): void {
    const before = this.state;
    this.state = state;
    if (before && state.recorded > before.recorded) say(t.kept(takes.length));
    if (state.trouble !== (before?.trouble ?? "")) this.tell(state.trouble);
    if (JSON.stringify(takes.map(({ id }) => id)) !== JSON.stringify(this.takes.map(({ id }) => id))) {
      const known = new Map(this.takes.map((take) => [take.id, take]));
      this.takes = takes.map((take) => known.get(take.id) ?? take);
      this.listTakes();
      if (this.step > 0) this.later();
    }
    this.showState(state);
  }

  private showState(state: RecorderState): void {
    setText(this.source, (state.alive ? t.alive(state.source.split("/").at(-1) ?? "", state.rate_hz) : t.nobody) + (state.paused ? ` ${t.paused}` : ""));
    setData(this.source, "alive", String(state.alive));
    setText(this.main, state.phase === "idle" ? t.start : state.phase === "countdown" ? t.cancel : t.stop);
    setData(this.main, "phase", state.phase);
    this.main.disabled = !state.alive && state.phase === "idle";
    this.overlay.hidden = state.phase === "idle" || this.step !== 0;
    setData(this.overlay, "phase", state.phase);
    if (this.overlay.hidden) return;
    const count = state.phase === "countdown";
    const big = count ? String(Math.ceil(state.remaining)) : `${state.elapsed.toFixed(0)} s`;
    if (this.overlay.dataset.big === big + state.lost) return;
    this.overlay.dataset.big = big + state.lost;
    this.overlay.replaceChildren(el("span", {}, count ? t.getReady : `● ${t.recording}`), el("strong", {}, big),
      state.lost > 0 ? el("span", {}, t.lost(state.lost)) : "");
  }

  private async toggle(): Promise<void> {
    await this.guard(async () => {
      const idle = (this.state?.phase ?? "idle") === "idle";
      const { state, takes } = idle ? await api.record(Number(this.countdown.value), Number(this.longest.value)) : await api.stopRecording();
      this.take(state, takes);
    });
  }

  private async bring(): Promise<void> {
    const file = this.file.files?.[0];
    if (file == undefined) return;
    await this.guard(async () => {
      await api.importTake(file);
      this.file.value = "";
      await this.poll();
    });
  }

  private listTakes(): void {
    this.takeRoom.replaceChildren(takeList(this.takes, this.step === 1, {
      changed: (take) => this.changed(take), look: (take) => void this.look(take), remove: (take, n) => void this.remove(take, n),
    }));
  }

  private changed(take: TakeInfo): void {
    void this.guard(async () => { await api.setParts(take.id, take.parts); });
    this.later();
  }

  private async remove(take: TakeInfo, n: number): Promise<void> {
    if (!await ask({ title: t.removeTitle(n), body: t.removeBody, yes: t.removeYes, no: t.removeNo, danger: true })) return;
    await this.guard(async () => {
      await api.removeTake(take.id);
      this.motions.delete(take.id);
      await this.poll();
    });
  }

  // ---- the chosen ones

  private get parts(): (ChosenPart & { label: string })[] {
    return this.takes.flatMap((take, i) => take.parts.map((part, k) => ({ ...part, take: take.id, label: t.legendPart(i + 1, k + 1) }))
      .filter(({ chosen }) => chosen).map(({ take: id, start, end, label }) => ({ take: id, start, end, label })));
  }

  private later(): void {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => void this.makeDraft(), SETTLE);
  }

  private async makeDraft(): Promise<void> {
    const parts = this.parts;
    const key = JSON.stringify(parts);
    if (parts.length === 0) {
      this.drafted = "";
      this.draft = null;
      this.stage?.show([]);
      this.player.set(0);
      return this.draftRoom.replaceChildren(el("p", { class: "muted" }, t.none));
    }
    if (key === this.drafted && this.draft) return this.showDraft();
    const mine = ++this.asked;
    this.draftRoom.replaceChildren(el("p", { class: "muted" }, t.working));
    await this.guard(async () => {
      const draft = await api.draft(parts.map(({ take, start, end }) => ({ take, start, end })));
      for (const { take } of parts) await this.motion(take);
      if (mine !== this.asked || this.step === 0) return;
      this.draft = draft;
      this.drafted = key;
      this.joints = proposed(draft);
      this.standing.checked = draft.standing;
      this.showDraft();
    });
  }

  private async motion(take: string): Promise<Performance> {
    const known = this.motions.get(take);
    if (known) return known;
    const performance = new Performance(await api.takeMotion(take), this.ids++);
    this.motions.set(take, performance);
    return performance;
  }

  // All chosen repetitions over each other, each warped onto the mean's time.
  private showDraft(): void {
    const { draft } = this;
    if (draft == null) return;
    const parts = this.parts;
    const shown: Shown[] = parts.slice(0, LINES.length).flatMap(({ take, start }, i) => {
      const performance = this.motions.get(take);
      const when = draft.when[i];
      if (performance == undefined || when == undefined) return [];
      const at = (time: number): number => {
        const place = Math.min(time * DRAWN, when.length - 1);
        const low = Math.floor(place);
        const a = when[low]!;
        return start + a + (place - low) * ((when[low + 1] ?? a) - a);
      };
      return [{ performance, colour: LINES[i]!, opacity: parts.length > 1 ? 0.45 : 1, when: at }];
    });
    if (parts.length > 1) {
      shown.unshift({ performance: new Performance(draft.mean, this.ids++), colour: MEAN, opacity: 1, when: (time) => time });
    }
    this.stage?.show(shown);
    this.player.set(draft.duration);
    const words = el("p", { class: "average" }, t.average(draft.experts, draft.duration.toFixed(1)));
    const legend = el("ul", { class: "record-legend" }, ...[...(parts.length > 1 ? [{ label: t.legendMean, colour: MEAN }] : []),
      ...parts.map(({ label }, i) => ({ label, colour: LINES[i % LINES.length]! }))].map(({ label, colour }) => {
      const swatch = el("span", { class: "swatch", "aria-hidden": "true" });
      swatch.style.background = colour;
      return el("li", {}, swatch, label);
    }));
    if (this.step === 2) this.draftRoom.replaceChildren(words, jointList(draft, this.joints));
    else if (this.step === 1) {
      this.draftRoom.replaceChildren(words, legend, el("h3", {}, t.curves), curves(draft, parts.map(({ label }) => label)));
    } else this.draftRoom.replaceChildren(words);
  }

  private async look(take: TakeInfo): Promise<void> {
    await this.guard(async () => {
      const performance = await this.motion(take.id);
      this.stage?.show([{ performance, colour: "#c3ccd6", opacity: 1, when: (time) => time }]);
      this.player.set(performance.duration);
      this.player.play(true);
    });
  }

  // ---- saving

  private sayName(): void {
    const name = plainName(this.name.value);
    const hint = this.panel.querySelector("#name-hint");
    if (hint) setText(hint, name === "" ? t.nameNone : t.nameHint(name));
  }

  private async save(): Promise<void> {
    await this.guard(async () => {
      const { name } = await api.saveReference({
        name: plainName(this.name.value), description: this.description.value, standing: this.standing.checked,
        parts: this.parts.map(({ take, start, end }) => ({ take, start, end })), joints: this.joints,
      });
      this.savedName = name;
      this.saved();
      this.tell("");
      say(t.saved(readable(name)));
      const link = (format: string): HTMLElement =>
        el("a", { class: "button", href: api.exportReferenceUrl(name, format), download: true }, format.toUpperCase());
      this.panel.replaceChildren(
        el("p", { class: "saved", role: "status" }, `✓ ${t.saved(readable(name))}`),
        el("button", { type: "button", class: "primary big", id: "train-now", onclick: () => this.train() }, t.train),
        el("div", { class: "row" }, t.exportAs, ...["bvh", "c3d", "trc", "csv", "mcap"].map(link)),
        el("div", { class: "row walk" }, el("button", { type: "button", class: "big", onclick: () => {
          this.name.value = this.description.value = "";
          this.go(0);
        } }, t.another)));
    });
  }

  private train(): void {
    if (this.connection.session({ action: "start", reference: this.savedName, plan: "none" })) location.hash = "session";
  }

  private async guard(work: () => Promise<void>): Promise<void> {
    try {
      await work();
    } catch (error) {
      this.tell(t.failed((error as Error).message));
    }
  }

  private tell(text: string): void {
    this.message.hidden = text === "";
    setText(this.message, text);
  }

  private choice(id: string, values: number[], chosen: number): HTMLSelectElement {
    return el("select", { id }, ...values.map((value) => el("option", { value, selected: value === chosen }, t.seconds(value))));
  }
}
