// Play, hold, scrub and loop over what the stage shows.
import { el, setText } from "../dom";
import { texts } from "../texts";

const t = texts.record;

export class TakePlayer {
  readonly element: HTMLElement;
  time = 0;
  private duration = 0;
  private playing = true;
  private last = 0;
  private readonly button = el("button", { type: "button", id: "take-play" }, t.hold);
  private readonly place = el("input", { type: "range", min: 0, max: 1, step: 0.01, value: 0, "aria-label": t.place });
  private readonly loop = el("input", { type: "checkbox", checked: true });
  private readonly words = el("span", { class: "take-time" });

  constructor() {
    this.button.addEventListener("click", () => this.play(!this.playing));
    this.place.addEventListener("input", () => {
      this.play(false);
      this.time = Number(this.place.value);
    });
    this.element = el("div", { class: "take-player", hidden: true }, this.button, this.place, this.words,
      el("label", { class: "check" }, this.loop, t.loop));
  }

  set(duration: number): void {
    this.duration = duration;
    this.place.max = String(duration);
    this.time = Math.min(this.time, duration);
    this.element.hidden = duration <= 0;
  }

  play(on: boolean): void {
    this.playing = on;
    if (on && this.time >= this.duration) this.time = 0;
    setText(this.button, on ? t.hold : t.play);
  }

  /// Once an animation frame.
  frame(now: number): void {
    const passed = Math.min(now - this.last, 0.2);
    this.last = now;
    if (this.playing && this.duration > 0) {
      this.time += passed;
      if (this.time > this.duration) {
        this.time = this.loop.checked ? this.time % this.duration : this.duration;
        if (!this.loop.checked) this.play(false);
      }
      this.place.value = String(this.time);
    }
    setText(this.words, t.at(this.time.toFixed(1), this.duration.toFixed(1)));
  }
}
