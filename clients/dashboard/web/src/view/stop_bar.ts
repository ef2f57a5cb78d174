// STOP: always there, whatever the view.
import { ask, el, say, setData, setText } from "../dom";
import { seconds, type Connection } from "../connection";
import type { Live } from "../live";
import { StopModel } from "../model/stop";
import { texts } from "../texts";

const AGAIN = 0.3;  // [s]

export class StopBar {
  readonly model = new StopModel();
  readonly element: HTMLElement;
  private sent = 0;
  private readonly words = el("span", { class: "stop-words" });
  private readonly button = el("button", { class: "stop", id: "stop", type: "button", "aria-keyshortcuts": "Escape" },
    el("span", { class: "stop-sign", "aria-hidden": "true" }), this.words);
  private readonly lift = el("button", { class: "lift", id: "lift", type: "button" }, texts.stop.lift);

  constructor(private readonly live: Live, private readonly connection: Connection) {
    this.button.addEventListener("click", () => this.press());
    this.lift.addEventListener("click", () => void this.allow());
    this.element = el("div", { class: "stop-bar" }, this.button, this.lift);
    live.on("stop", ({ active, reason }) => {
      const before = this.model.active;
      this.model.take(active, reason);
      if (before !== active) say(active ? texts.stop.announced : texts.stop.lifted, true);
    });
  }

  get active(): boolean { return this.model.active; }

  press(): void {
    this.model.press(seconds(), this.live.connected);
    this.send();
    this.frame();
  }

  frame(): void {
    // Until it is confirmed it is sent again, also when the connection was lost meanwhile.
    if (this.model.waiting && seconds() - this.sent > AGAIN) this.send();
    const shown = this.model.shown(seconds(), this.live.connected);
    setData(this.element, "state", shown);
    setText(this.words, {
      ready: texts.stop.press, sending: texts.stop.sending, unconfirmed: texts.stop.unconfirmed,
      "in-force": texts.stop.inForce, offline: texts.stop.offline,
    }[shown]);
    const title = shown === "in-force" && this.model.reason ? texts.stop.why(this.model.reason) : "";
    if (this.button.title !== title) this.button.title = title;
    const hidden = shown !== "in-force";
    if (this.lift.hidden !== hidden) this.lift.hidden = hidden;
  }

  private send(): void {
    if (this.connection.stop(true, texts.stop.reason)) this.sent = seconds();
  }

  private async allow(): Promise<void> {
    const yes = await ask({
      title: texts.stop.liftTitle, body: texts.stop.liftBody, yes: texts.stop.liftYes, no: texts.stop.liftNo,
    });
    if (yes) this.connection.stop(false, texts.stop.liftReason);
  }
}
