// Feeds the live views from recordings: a Track is one recording with its ghost, seen through a Live of its
// own; the Player moves all its tracks to the same time.
import { decode } from "./decode";
import { Live } from "./live";
import type { Correction, RepetitionScore, States, Streams } from "./messages";
import { STREAMS } from "./messages";
import { degrees, norm } from "./model/error";
import { Playback } from "./model/playback";
import type { Recorded, Recording } from "./model/recording";

const WINDOW = 2;     // read at once [s]
const WINDOWS = 24;   // kept
const SECOND = 1_000_000_000;
const KEPT_STATES = ["skeleton", "references", "session_state", "stop", "repetition"] as const;
const FROM_THE_START = ["skeleton", "references", "session_state"] as const;
type KeptState = (typeof KEPT_STATES)[number];
const streams = new Set<string>(STREAMS);

/// What a recording says of the time of the play head, in the place of what came just now.
export class RecordedLive extends Live {
  head = 0;
  override connected = true;
  override everConnected = true;
  override isLive(name: keyof Streams, _now: number, within: number): boolean {
    const came = this.came[name];
    return came != undefined && this.head - came < within;
  }
}

interface Window { messages: { name: string; time: number; message: Recorded }[] }
interface TimedState { name: KeptState; time: number; message: unknown }
export interface Errors { time: number[]; joints: ReadonlyMap<string, { error: number[]; tolerance: number[] }> }

export class Track {
  readonly live = new RecordedLive();
  readonly states: TimedState[] = [];
  /// Before states are told anew because time went backwards.
  onRewind: () => void = () => {};
  private readonly windows = new Map<number, { data?: Window; failed?: Error; errors?: Errors }>();
  private told = 0;  // of states
  private readonly parts: Recording[];

  private constructor(recording: Recording, readonly base: bigint) { this.parts = [recording]; }

  /// @param base    the time that is 0
  /// @param states  the recording's, where they are a file of their own
  static async open(recording: Recording, base = recording.start, states: Recording | null = null): Promise<Track> {
    const track = new Track(recording, base);
    for (const one of await (states ?? recording).all(KEPT_STATES)) {
      try {
        track.states.push({ name: one.name as KeptState, time: track.at(one.time), message: decode(one.schema, one.data) });
      } catch {
        // One that cannot be read is left out, as the bridge does.
      }
    }
    return track;
  }

  get duration(): number { return this.at(this.parts[0]!.end); }
  get hasExpert(): boolean { return this.parts.some((part) => part.has("expert")); }
  get finished(): boolean { return this.parts[0]!.finished; }

  add(part: Recording): void {
    this.parts.push(part);
    this.windows.clear();
  }

  repetitions(): RepetitionScore[] {
    return this.states.filter(({ name }) => name === "repetition").map(({ message }) => message as RepetitionScore);
  }
  at(ns: bigint): number { return Number(ns - this.base) / SECOND; }

  /// Whether what is needed at this time is read; else it is being read.
  ready(t: number): boolean {
    const i = Math.floor(t / WINDOW);
    void this.load(i + 1);
    return [i - 1, i].every((k) => this.load(k).data != undefined);
  }

  failure(t: number): Error | undefined { return this.windows.get(Math.floor(t / WINDOW))?.failed; }

  /// Plays on: everything after one time, up to another.
  advance(from: number, to: number): void {
    this.live.head = to;
    for (let i = Math.floor(from / WINDOW); i <= Math.floor(to / WINDOW); i++) {
      for (const one of this.windows.get(i)?.data?.messages ?? []) if (one.time > from && one.time <= to) this.offer(one);
    }
    this.tell(to);
  }

  /// As if all had come up to this time.
  seek(t: number): void {
    const { live } = this;
    live.disconnect();
    live.connected = true;
    live.head = t;
    this.onRewind();
    for (const name of KEPT_STATES) delete live.states[name];
    this.told = 0;
    const newest = new Map<string, TimedState>();
    // Body and session are known from the first moment on, or nothing could be drawn before they were told.
    for (const name of FROM_THE_START) {
      const first = this.states.find((state) => state.name === name);
      if (first) newest.set(name, first);
    }
    for (; this.told < this.states.length && this.states[this.told]!.time <= t; this.told++) {
      const state = this.states[this.told]!;
      if (state.name === "repetition") live.take(state.name, state.message as never);
      else newest.set(state.name, state);
    }
    for (const { name, message } of newest.values()) live.take(name, message as never);
    const last = Math.floor(t / WINDOW);
    for (const i of [last - 1, last]) {
      for (const one of this.windows.get(i)?.data?.messages ?? []) if (one.time <= t) this.offer(one);
    }
  }

  /// The time of the frame after this one, or before it; where it is when there is none near.
  step(t: number, by: 1 | -1): number {
    const i = Math.floor(t / WINDOW);
    const times = [i - 1, i, i + 1].flatMap((k) => this.windows.get(k)?.data?.messages ?? [])
      .filter(({ name }) => name === "pose").map(({ time }) => time);
    return (by > 0 ? times.find((time) => time > t + 1e-6) : times.findLast((time) => time < t - 1e-6)) ?? t;
  }

  /// Joint errors between two times, as far as they are read; reading goes on.
  errors(from: number, to: number): Errors[] {
    const out: Errors[] = [];
    for (let i = Math.max(0, Math.floor(from / WINDOW)); i <= Math.floor(Math.min(to, this.duration) / WINDOW); i++) {
      const window = this.load(i);
      if (window.data) out.push(window.errors ??= errorsOf(window.data, (ns) => this.at(ns)));
    }
    return out;
  }

  private offer(one: Window["messages"][number]): void {
    this.live.offer(one.name as keyof Streams, () => decode(one.message.schema, one.message.data), one.time);
  }

  private tell(t: number): void {
    for (; this.told < this.states.length && this.states[this.told]!.time <= t; this.told++) {
      const { name, message } = this.states[this.told]!;
      this.live.take(name as keyof States, message as never);
    }
  }

  private load(i: number): { data?: Window; failed?: Error; errors?: Errors } {
    const known = this.windows.get(i);
    if (known) {
      this.windows.delete(i);
      this.windows.set(i, known);  // the last used stands last
      return known;
    }
    const window: { data?: Window; failed?: Error } = {};
    this.windows.set(i, window);
    if (this.windows.size > WINDOWS) this.windows.delete(this.windows.keys().next().value!);
    if (i < 0 || i * WINDOW > this.duration) window.data = { messages: [] };
    else void this.read(i, window);
    return window;
  }

  private async read(i: number, into: { data?: Window; failed?: Error }): Promise<void> {
    const from = this.base + BigInt(i * WINDOW * SECOND);
    try {
      const read = await Promise.all(this.parts.map((part) => part.between([...streams], from, from + BigInt(WINDOW * SECOND))));
      into.data = { messages: read.flat().map((message) => ({ name: message.name, time: this.at(message.time), message }))
        .sort((a, b) => a.time - b.time) };
    } catch (error) {
      into.failed = error as Error;
    }
  }
}

// By the time of measurement: the same in a recording and its re-run.
function errorsOf(window: Window, at: (ns: bigint) => number): Errors {
  const time: number[] = [];
  const joints = new Map<string, { error: number[]; tolerance: number[] }>();
  for (const { name, message } of window.messages) {
    if (name !== "correction") continue;
    const correction = decode(message.schema, message.data) as Correction;
    time.push(at(correction.header.stamp_ns));
    for (const one of correction.joints) {
      let line = joints.get(one.joint);
      if (!line) joints.set(one.joint, (line = { error: [], tolerance: [] }));
      line.error.push(degrees(norm(one.error)));
      line.tolerance.push(degrees(one.tolerance));
    }
  }
  return { time, joints };
}

export class Player {
  readonly tracks: Track[];
  readonly playback: Playback;
  private shown = -1;   // to where the tracks are moved
  private jump = true;
  private last: number | null = null;
  private opened = false;

  constructor(track: Track) {
    this.tracks = [track];
    this.playback = new Playback(track.duration);
  }

  add(track: Track): void {
    this.tracks.splice(1, 1, track);
    this.jump = true;
  }

  seek(t: number): void {
    this.playback.seek(t);
    this.jump = true;
  }
  loop(stretch: { from: number; to: number } | null): void {
    this.playback.setLoop(stretch);
    if (stretch) this.seek(stretch.from);
  }
  step(by: 1 | -1): void {
    this.playback.playing = false;
    this.seek(this.tracks[0]!.step(this.playback.head, by));
  }
  /// Something was added to a track.
  refresh(): void { this.jump = true; }

  /// What cannot be read where the head is.
  get failure(): Error | undefined {
    return this.tracks.map((track) => track.failure(this.playback.head)).find((error) => error != undefined);
  }

  // A recorder hears the session before it hears the body: what is seen first is the first pose.
  private open(): void {
    if (this.opened) return;
    this.opened = true;
    if (this.playback.head === 0 && this.tracks[0]!.live.newest.pose == undefined) this.seek(this.tracks[0]!.step(0, 1));
  }

  /// Once an animation frame. @param now  by the page's clock [s]
  /// @returns whether it waits for what is being read
  frame(now: number): boolean {
    const elapsed = this.last == null ? 0 : Math.min(0.25, now - this.last);
    this.last = now;
    const { playback } = this;
    const ready = this.tracks.every((track) => track.ready(playback.head));
    if (ready) {
      const before = playback.head;
      if (playback.advance(this.jump ? 0 : elapsed)) this.jump = true;
      if (this.tracks.every((track) => track.ready(playback.head))) {
        for (const track of this.tracks) {
          if (this.jump) track.seek(playback.head);
          else if (playback.head > this.shown) track.advance(this.shown, playback.head);
        }
        this.jump = false;
        this.shown = playback.head;
        this.open();
      } else if (!this.jump) {
        playback.head = before;
      }
    }
    for (const track of this.tracks) track.live.frame();
    return !ready;
  }
}
