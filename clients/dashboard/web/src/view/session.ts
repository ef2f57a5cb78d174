// The live view.
import { api, type Plan } from "../api";
import { seconds } from "../connection";
import { el, setData, setText } from "../dom";
import type { Live } from "../live";
import { COLOURS } from "../model/error";
import { Repetitions } from "../model/repetitions";
import { texts } from "../texts";
import { BodyMap } from "./body_map";
import { Stage, type View } from "./stage";
import { Status } from "./status";
import { Timeline } from "./timeline";

const OLD = 1.0;  // a pose is not live after [s]
const t = texts.stage;

/// What stands below the views.
export interface Bottom { element: HTMLElement; frame(): void }

/// @param C  the live session's controls, or a player's
export class SessionView<C extends Bottom = Bottom> {
  readonly element: HTMLElement;
  readonly stage: Stage | null;
  private readonly status: Status;
  private readonly body = new BodyMap();
  private readonly timeline: Timeline;
  private readonly notice = el("div", { class: "notice", role: "status", hidden: true });
  private readonly repetitions = new Repetitions();
  private reference = "";

  constructor(private readonly live: Live, readonly controls: C, private readonly stop: { readonly active: boolean }) {
    this.status = new Status(this.repetitions);
    this.timeline = new Timeline(this.status.bars);
    this.stage = this.makeStage();
    this.element = el("div", { class: "session" },
      el("section", { class: "stage card", "aria-label": t.label },
        this.stage?.element ?? el("p", { class: "notice" }, texts.session.noWebgl),
        this.stage && this.tools(this.stage), this.legend(), this.notice),
      el("div", { class: "side" }, this.status.element, this.body.element),
      this.timeline.element, this.controls.element);
    live.on("repetition", (score) => this.repetitions.add(score));
    live.on("session_state", (state) => {
      this.body.setSites(state.tactors);
      if (state.reference !== this.reference) void this.learnReference(state.reference);
    });
  }

  setPlans(plans: Plan[]): void { this.timeline.plans = plans; }

  /// The repetitions are told anew.
  forgetRepetitions(): void { this.repetitions.clear(); }

  frame(): void {
    const now = seconds();
    const moving = this.live.isLive("pose", now, OLD);
    const judged = moving && this.status.judged(this.live);
    this.stage?.frame(this.live, judged);
    this.status.frame(this.live);
    this.body.frame(this.live, now, this.stop.active);
    this.timeline.frame(this.live, moving);
    this.controls.frame();
    const came = this.live.newest.pose != undefined;
    this.notice.hidden = moving || !this.live.connected;
    setText(this.notice, came ? `${texts.session.noPose}. ${texts.session.noPoseBody}` : texts.session.waitingForPose);
    setData(this.element, "live", String(moving));
  }

  private makeStage(): Stage | null {
    try {
      return new Stage();
    } catch {
      return null;
    }
  }

  private async learnReference(name: string): Promise<void> {
    this.reference = name;
    try {
      const { joints } = await api.reference(name);
      if (this.reference === name && this.stage) {
        this.stage.weights = new Map(joints.map((joint) => [joint.name, joint.weight]));
      }
    } catch {
      // Labels then weigh all joints alike.
    }
  }

  private tools(stage: Stage): HTMLElement {
    const view = (name: View): HTMLElement =>
      el("button", { type: "button", onclick: () => stage.view(name) }, t[name]);
    const toggle = (text: string, change: (on: boolean) => void): HTMLElement => {
      const button = el("button", { type: "button", "aria-pressed": "false" }, text);
      button.addEventListener("click", () => {
        const on = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(on));
        change(on);
      });
      return button;
    };
    return el("div", { class: "stage-tools" },
      view("front"), view("side"), view("top"), el("span", { class: "gap" }),
      toggle(t.apart, (on) => { stage.sideBySide = on; }),
      toggle(t.axes, (on) => { stage.showAxes = on; }),
      toggle(t.points, (on) => { stage.showPoints = on; }));
  }

  private legend(): HTMLElement {
    const entry = (grade: "inside" | "outside" | "far", thickness: number): HTMLElement => {
      const swatch = el("span", { class: "swatch", "aria-hidden": "true" });
      swatch.style.background = COLOURS[grade];
      swatch.style.height = `${thickness}px`;
      return el("li", {}, swatch, t.grade[grade]);
    };
    return el("ul", { class: "legend", "aria-label": t.legend }, entry("inside", 8), entry("outside", 13), entry("far", 19));
  }
}
