// Where a recording is played: head, speed, loop. Pure: fed with the time that went by.

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4] as const;
export interface Stretch { from: number; to: number }

export class Playback {
  head = 0;             // [s] from the recording's beginning
  playing = false;
  private rate = 1;
  private stretch: Stretch | null = null;

  constructor(public duration: number) {}

  get speed(): number { return this.rate; }
  set speed(to: number) { this.rate = Math.min(SPEEDS.at(-1)!, Math.max(SPEEDS[0], to)); }

  get loop(): Stretch | null { return this.stretch; }

  /// Plays the stretch over and over; null: to the end, once. An empty one is none.
  setLoop(stretch: Stretch | null): void {
    const from = this.within(stretch?.from ?? 0);
    const to = this.within(stretch?.to ?? 0);
    this.stretch = stretch != null && to > from ? { from, to } : null;
    if (this.stretch && (this.head < from || this.head > to)) this.head = from;
  }

  /// From the beginning when the end was reached.
  toggle(): void {
    this.playing = !this.playing;
    if (this.playing && this.head >= this.duration) this.head = this.stretch?.from ?? 0;
  }

  seek(to: number): void { this.head = this.within(to); }

  /// @param elapsed  by the wall's clock [s]
  /// @returns whether the head jumped back to the loop's beginning
  advance(elapsed: number): boolean {
    if (!this.playing) return false;
    const next = this.head + elapsed * this.rate;
    const loop = this.stretch;
    // One that the user left by seeking behind it is not jumped into.
    if (loop && this.head <= loop.to && next > loop.to) {
      this.head = loop.from + ((next - loop.to) % (loop.to - loop.from));
      return true;
    }
    this.head = this.within(next);
    if (next >= this.duration) this.playing = false;
    return false;
  }

  private within(t: number): number { return Math.min(this.duration, Math.max(0, Number.isFinite(t) ? t : 0)); }
}

/// 75.25 is "1:15.2".
export function clock(seconds: number): string {
  const tenths = Math.floor(seconds * 10 + 1e-6);
  const minutes = Math.floor(tenths / 600);
  return `${minutes}:${String(Math.floor((tenths % 600) / 10)).padStart(2, "0")}.${tenths % 10}`;
}
