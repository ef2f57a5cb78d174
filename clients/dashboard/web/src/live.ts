// The newest of everything. Streams wait as bytes until a frame is drawn, so a page never decodes more
// than it shows; states are decoded as they come, because each counts.
import type { States, Streams } from "./messages";
import { STREAMS } from "./messages";

type Listener<M> = (message: M) => void;

export class Live {
  connected = false;
  everConnected = false;
  readonly newest: { [K in keyof Streams]?: Streams[K] } = {};
  readonly states: { [K in keyof States]?: States[K] } = {};
  /// When the newest of a stream came, by the page's clock [s].
  readonly came: Partial<Record<keyof Streams, number>> = {};
  readonly counts: Partial<Record<keyof Streams, number>> = {};
  private readonly waiting = new Map<keyof Streams, () => unknown>();
  private readonly listeners = new Map<keyof States, Listener<never>[]>();
  private fresh = new Set<keyof Streams>();

  on<K extends keyof States>(name: K, listener: Listener<States[K]>): void {
    const list = this.listeners.get(name) ?? [];
    list.push(listener as Listener<never>);
    this.listeners.set(name, list);
  }

  offer(name: keyof Streams, read: () => unknown, now: number): void {
    this.waiting.set(name, read);
    this.came[name] = now;
    this.counts[name] = (this.counts[name] ?? 0) + 1;
  }

  take<K extends keyof States>(name: K, message: States[K]): void {
    this.states[name] = message;
    for (const listener of this.listeners.get(name) ?? []) (listener as Listener<States[K]>)(message);
  }

  /// Decodes what waits. Once a drawn frame, before the views look.
  frame(): void {
    this.fresh = new Set(this.waiting.keys());
    for (const [name, read] of this.waiting) (this.newest as Record<string, unknown>)[name] = read();
    this.waiting.clear();
  }

  /// Whether this frame brought a new message.
  isFresh(name: keyof Streams): boolean { return this.fresh.has(name); }

  /// Whether the newest message is from just now: nothing older may be shown as if it were live.
  isLive(name: keyof Streams, now: number, within: number): boolean {
    const came = this.came[name];
    return this.connected && came != undefined && now - came < within;
  }

  /// The connection is gone: what streamed is forgotten, what it was stays until a new one says.
  disconnect(): void {
    this.connected = false;
    this.waiting.clear();
    for (const name of STREAMS) {
      delete this.newest[name];
      delete this.came[name];
    }
  }
}
