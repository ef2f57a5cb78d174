// A rolling record for plots: one time axis, several named lines, bounded.

export class Series {
  readonly time: number[] = [];
  readonly lines: (number | null)[][];

  /// @param span  how much to keep [s]
  constructor(readonly names: readonly string[], private readonly span: number,
              private readonly most = 4000) {
    this.lines = names.map(() => []);
  }

  /// A time that is not after the last one begins anew: the source was restarted.
  push(time: number, values: readonly (number | null)[]): void {
    const last = this.time.at(-1);
    if (last != undefined && time < last) this.clear();
    if (last === time) return;
    this.time.push(time);
    this.lines.forEach((line, i) => line.push(values[i] ?? null));
    let old = 0;
    while (this.time[old]! < time - this.span) old++;
    old = Math.max(old, this.time.length - this.most);
    if (old > 0) {
      this.time.splice(0, old);
      for (const line of this.lines) line.splice(0, old);
    }
  }

  /// A line's gap: what was before is not joined with what comes.
  gap(): void {
    const last = this.time.at(-1);
    if (last != undefined) this.push(last + 1e-6, this.names.map(() => null));
  }

  clear(): void {
    this.time.length = 0;
    for (const line of this.lines) line.length = 0;
  }
}
