// Recordings: the list, and one of them opened.
import { api, type RecordingRow } from "../api";
import { el, say, setText, table } from "../dom";
import { clock } from "../model/playback";
import { BlobBytes, HttpBytes, made, openRecording, openStates } from "../model/recording";
import { recordingHash } from "../model/session_recording";
import { Player, Track } from "../player";
import { readable, texts } from "../texts";
import { day } from "./history";
import { PlayerView } from "./player";
import "../player.css";

const t = texts.recordings;

export class RecordingsView {
  readonly element = el("div", { class: "recordings" });
  private readonly message = el("p", { class: "player-message", role: "status" });
  private readonly list = el("div", {});
  private readonly file = el("input", { type: "file", accept: ".mcap", class: "visually-hidden", tabindex: -1, "aria-hidden": "true" });
  private readonly listCard: HTMLElement;
  private player: PlayerView | null = null;
  private opening = 0;

  constructor() {
    this.listCard = el("section", { class: "card" },
      el("h2", {}, t.heading), el("p", { class: "muted" }, t.hint),
      el("div", { class: "row" }, el("button", { type: "button", id: "open-file", onclick: () => this.file.click() }, t.own), this.file,
        el("span", { class: "muted" }, t.drop)),
      this.message, this.list);
    this.element.append(this.listCard);
    this.file.addEventListener("change", () => {
      const chosen = this.file.files?.[0];
      this.file.value = "";
      if (chosen) void this.openFile(chosen);
    });
    this.element.addEventListener("dragover", (event) => event.preventDefault());
    this.element.addEventListener("drop", (event) => {
      event.preventDefault();
      const dropped = event.dataTransfer?.files[0];
      if (dropped) void this.openFile(dropped);
    });
  }

  /// The address says what is open, and from where on: #recordings, #recordings/NAME or #recordings/NAME/SECONDS.
  async show(): Promise<void> {
    const [, name = "", seconds = ""] = location.hash.split("/").map(decodeURIComponent);
    const at = Number(seconds) || 0;
    if (this.player?.name === name) {
      const { player } = this.player;
      // One that is still being made may have grown since it was opened.
      if (name === "" || at <= player.playback.duration) return at > 0 ? player.seek(at) : undefined;
    }
    this.close();
    if (name !== "") return this.openNamed(name, at);
    await this.load();
  }

  frame(): void { this.player?.frame(); }
  key(key: string, target: HTMLElement): boolean { return this.player?.key(key, target) ?? false; }

  private async load(): Promise<void> {
    try {
      const rows = await api.recordings();
      setText(this.message, rows.length === 0 ? t.none : "");
      this.list.replaceChildren(rows.length === 0 ? "" : this.rows(rows));
    } catch (error) {
      this.message.replaceChildren(t.failed((error as Error).message), " ",
        el("button", { type: "button", onclick: () => void this.load() }, t.again));
    }
  }

  private rows(rows: RecordingRow[]): HTMLElement {
    const h = t.table;
    return table(t.heading, [h.name, h.start, h.length, h.exercise, h.repetitions, h.size, h.state], rows.map((row) => [
      row.state === "damaged" ? row.name : el("a", { class: "button", href: recordingHash(row.name), "aria-label": t.openName(row.name) }, row.name),
      row.start ? day(row.start) : "–", row.duration == undefined ? "–" : clock(row.duration),
      row.references.map(readable).join(", ") || "–", String(row.repetitions), t.size(row.bytes),
      el("span", { class: "recording-state", "data-state": row.state, title: row.error ?? "" }, t.state[row.state], row.error ? `: ${row.error}` : ""),
    ]), [2, 4, 5]);
  }

  private async openNamed(name: string, at: number): Promise<void> {
    let expert = api.recordingUrl(name, "expert");
    await this.open(name, async (current) => {
      const row = (await api.recordings()).find((one) => one.name === name);
      const torn = row != undefined && row.state !== "finished";
      let url = api.recordingUrl(name, "file");
      let stateUrl = api.recordingUrl(name, "states");
      if (torn) {
        // A copy as it is now: it stays the same while the recording grows on.
        url = api.repairedUrl(name, (await api.repair(name)).job);
        stateUrl = `${url}/states`;
        expert = `${url}/expert`;
        await made(url, current, () => {});
      }
      const bytes = new HttpBytes(url);
      const states = await openStates(bytes, stateUrl, current,
        (share) => { if (current()) setText(this.message, t.reading(name, Math.round(share * 100))); });
      const track = await Track.open(await openRecording(bytes), undefined, states);
      const note = row?.state === "being recorded" ? t.growing : torn ? t.unfinished : "";
      return { track, note, server: row?.coached ?? false };
    });
    const view = this.player;
    if (view && view.name === name && at > 0) view.player.seek(at);
    if (view && view.name === name && !view.player.tracks[0]!.hasExpert) void this.addGhost(view, expert);
  }

  private async openFile(file: File): Promise<void> {
    this.close();
    await this.open(file.name, async () => {
      const track = await Track.open(await openRecording(new BlobBytes(file)));
      return { track, note: track.finished ? "" : t.unfinished, server: false };
    }, "");
    if (this.player && !this.player.player.tracks[0]!.hasExpert) this.player.ghost(t.ghostLocal);
  }

  // `address` is what #recordings/… says; empty: a file of the user's.
  private async open(name: string, read: (current: () => boolean) => Promise<{ track: Track; note: string; server: boolean }>, address = name): Promise<void> {
    const mine = ++this.opening;
    const current = (): boolean => mine === this.opening;
    setText(this.message, t.opening(name));
    try {
      const { track, note, server } = await read(current);
      if (!current()) return;
      setText(this.message, "");
      this.player = new PlayerView(address, name, new Player(track), note, server, () => this.back());
      this.element.replaceChildren(this.player.element);
      say(name);
    } catch (error) {
      if (!current()) return;
      await this.load();
      setText(this.message, t.cannot(name, (error as Error).message));
    }
  }

  private async addGhost(view: PlayerView, url: string): Promise<void> {
    try {
      await made(url, () => this.player === view, (share) => view.ghost(t.ghostMaking(Math.round(share * 100))));
      view.player.tracks[0]!.add(await openRecording(new HttpBytes(url)));
      view.player.refresh();
      view.ghost("");
    } catch (error) {
      view.ghost(t.ghostNone((error as Error).message));
    }
  }

  private back(): void {
    this.close();
    if (location.hash === "#recordings") void this.load();
    else location.hash = "#recordings";
  }

  private close(): void {
    this.opening++;
    this.player?.close();
    this.player = null;
    this.element.replaceChildren(this.listCard);
  }
}
