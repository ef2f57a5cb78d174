// One recording opened: the session's views moved by a player, and beside them a re-run.
import { seconds } from "../connection";
import { el, labelled, setData, setText } from "../dom";
import { clock, SPEEDS } from "../model/playback";
import type { Player, Track } from "../player";
import { texts } from "../texts";
import { Compare } from "./compare";
import { SessionView } from "./session";

const t = texts.player;
const ARROW = 1;  // [s]
type Side = "recorded" | "rerun" | "both";

const EMPTY = (): { element: HTMLElement; frame(): void } => ({ element: el("span", { hidden: true }), frame: () => {} });

export class PlayerView {
  readonly element: HTMLElement;
  private readonly views: SessionView[] = [];
  private readonly panes = el("div", { class: "panes", "data-side": "recorded" });
  private readonly notes = el("p", { class: "player-message", role: "status" });
  private readonly ghostNote = el("p", { class: "player-message", role: "status", id: "ghost-note" });
  private readonly failure = el("p", { class: "player-message", role: "alert" });
  private readonly play = el("button", { type: "button", class: "primary big", id: "play" }, t.play);
  private readonly slider = el("input", { type: "range", id: "seek", min: 0, step: 0.05, "aria-label": t.seek });
  private readonly clock = el("output", { id: "clock" });
  private readonly speed = el("select", { id: "speed" });
  private readonly loops = el("select", { id: "loop" });
  private readonly band = el("span", { class: "loop-band", "aria-hidden": "true", hidden: true });
  private readonly sides = el("div", { class: "row sides", role: "group", "aria-label": t.sides, hidden: true });
  private readonly compare: Compare;
  private from = 0;  // of a loop that is being set

  /// @param name    in the bridge's folder; empty: a file of the user's
  constructor(readonly name: string, title: string, readonly player: Player, note: string, server: boolean, back: () => void) {
    const { playback } = player;
    this.slider.max = playback.duration.toFixed(2);
    this.slider.value = "0";
    this.speed.append(...SPEEDS.map((value) => el("option", { value, selected: value === 1 }, t.times(value))));
    this.play.addEventListener("click", () => playback.toggle());
    this.slider.addEventListener("input", () => player.seek(Number(this.slider.value)));
    this.speed.addEventListener("change", () => { playback.speed = Number(this.speed.value); });
    this.loops.addEventListener("change", () => this.choseLoop());
    this.listLoops();
    this.compare = new Compare(name, player, server, (track) => this.addRerun(track));
    const button = (text: string, id: string, press: () => void, name = text): HTMLElement =>
      el("button", { type: "button", id, "aria-label": name, title: name, onclick: press }, text);
    const bar = el("section", { class: "card player-bar", "aria-label": t.heading },
      el("div", { class: "seek-room" }, this.band, this.slider),
      el("div", { class: "row" }, this.play,
        button("◂|", "frame-back", () => player.step(-1), t.back), button("|▸", "frame-on", () => player.step(1), t.forward),
        this.clock, el("span", { class: "gap" }),
        labelled(t.speed, this.speed), labelled(t.loop, this.loops),
        button(t.fromHere, "loop-from", () => { this.from = playback.head; }, t.from),
        button(t.toHere, "loop-to", () => this.setLoop(this.from, playback.head), t.to)));
    for (const side of ["recorded", "rerun", "both"] as const) {
      this.sides.append(el("button", { type: "button", "data-side": side, "aria-pressed": String(side === "recorded"), onclick: () => this.show(side) }, t.side[side]));
    }
    setText(this.notes, [note, player.tracks[0]!.states.some(({ name: state }) => state === "skeleton") ? "" : texts.recordings.noSkeleton].filter(Boolean).join(" "));
    this.element = el("div", { class: "player" },
      el("div", { class: "row" }, el("button", { type: "button", id: "back", onclick: back }, `‹ ${texts.recordings.back}`), el("h2", {}, title), this.sides),
      this.notes, this.ghostNote, this.failure, this.panes, bar, el("p", { class: "muted" }, t.keys), this.compare.element);
    this.addView(player.tracks[0]!, t.side.recorded);
  }

  ghost(text: string): void { setText(this.ghostNote, text); }

  frame(): void {
    const waits = this.player.frame(seconds());
    const { playback, failure } = this.player;
    setText(this.failure, failure ? t.failed(failure.message) : "");
    setText(this.play, playback.playing ? t.pause : t.play);
    setData(this.element, "waits", String(waits));
    setText(this.clock, t.position(clock(playback.head), clock(playback.duration)));
    if (document.activeElement !== this.slider || playback.playing) this.slider.value = playback.head.toFixed(2);
    this.slider.setAttribute("aria-valuetext", this.clock.textContent ?? "");
    const { loop } = playback;
    this.band.hidden = loop == null;
    if (loop) {
      this.band.style.left = `${(loop.from / playback.duration) * 100}%`;
      this.band.style.width = `${((loop.to - loop.from) / playback.duration) * 100}%`;
    }
    const side = this.panes.dataset.side as Side;
    this.views.forEach((view, i) => { if (side === "both" || (side === "rerun") === (i === 1)) view.frame(); });
    this.compare.frame();
  }

  /// @returns whether the key was the player's
  key(key: string, target: HTMLElement): boolean {
    const { player } = this;
    const { playback } = player;
    const stage = this.views.find((view) => view.stage?.canvas === target)?.stage;
    if (stage && stage.key(key)) return true;
    if (key === " " && target.closest("button, summary, a")) return false;
    if (target.closest("[role=region]") && key !== " ") return false;
    const keys: Record<string, () => void> = {
      " ": () => playback.toggle(),
      ArrowLeft: () => player.seek(playback.head - ARROW), ArrowRight: () => player.seek(playback.head + ARROW),
      Home: () => player.seek(0), End: () => player.seek(playback.duration),
      ",": () => player.step(-1), ".": () => player.step(1),
    };
    keys[key]?.();
    return keys[key] != undefined;
  }

  close(): void {
    this.player.playback.playing = false;
    // The browser has few WebGL contexts: they are given back at once.
    for (const view of this.views) view.stage?.canvas.getContext("webgl2")?.getExtension("WEBGL_lose_context")?.loseContext();
  }

  private addView(track: Track, title: string): void {
    const view = new SessionView(track.live, EMPTY(), { get active() { return track.live.states.stop?.active ?? false; } });
    track.onRewind = () => view.forgetRepetitions();
    if (this.views.length > 0) {
      // An id names one element of a page, a landmark's name one landmark.
      for (const part of view.element.querySelectorAll("section")) {
        const by = part.getAttribute("aria-labelledby");
        const label = by ? part.querySelector(`#${by}`)?.textContent : part.getAttribute("aria-label");
        part.removeAttribute("aria-labelledby");
        part.setAttribute("aria-label", `${title}: ${label ?? ""}`);
      }
      for (const named of view.element.querySelectorAll("[id]")) named.removeAttribute("id");
    }
    this.views.push(view);
    this.panes.append(el("section", { class: "pane", "aria-label": title }, el("h3", { class: "pane-title" }, title), view.element));
  }

  private addRerun(track: Track): void {
    const old = this.views.splice(1, 1)[0];
    old?.stage?.canvas.getContext("webgl2")?.getExtension("WEBGL_lose_context")?.loseContext();
    this.panes.children[1]?.remove();
    this.player.add(track);
    this.addView(track, t.side.rerun);
    this.sides.hidden = false;
    this.show("both");
  }

  private show(side: Side): void {
    setData(this.panes, "side", side);
    for (const button of this.sides.querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.side === side));
    this.player.refresh();
  }

  private listLoops(): void {
    const track = this.player.tracks[0]!;
    this.loops.replaceChildren(el("option", { value: "" }, t.loopOff), ...track.repetitions().map((score, i) =>
      el("option", { value: i }, t.repetition(i + 1, score.total.toFixed(0)))));
  }

  private choseLoop(): void {
    const track = this.player.tracks[0]!;
    const score = this.loops.value === "" ? undefined : track.repetitions()[Number(this.loops.value)];
    this.player.loop(score ? { from: track.at(score.start_ns), to: track.at(score.end_ns) } : null);
  }

  private setLoop(from: number, to: number): void {
    this.loops.value = "";
    this.player.loop(to > from ? { from, to } : null);
  }
}
