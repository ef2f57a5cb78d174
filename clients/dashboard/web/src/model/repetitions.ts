// The repetitions of the present session, by block. The bridge tells a new page all that there were.
import type { RepetitionScore, SessionState } from "../messages";

export class Repetitions {
  private all: RepetitionScore[] = [];

  add(score: RepetitionScore): void {
    if (this.all.some((known) => known.end_ns === score.end_ns)) return;
    this.all.push(score);
    this.all.sort((a, b) => (a.end_ns < b.end_ns ? -1 : a.end_ns > b.end_ns ? 1 : 0));
  }

  clear(): void { this.all = []; }

  ofSession(state: SessionState): RepetitionScore[] {
    return this.all.filter((score) => score.end_ns >= state.session_start_ns);
  }

  /// Those of the block under way; it began at block_start_ns.
  ofBlock(state: SessionState): RepetitionScore[] {
    return this.all.filter((score) => score.end_ns >= state.block_start_ns);
  }

  /// A block counts from 1, so a number that does not grow begins the next one.
  byBlock(state: SessionState): RepetitionScore[][] {
    const blocks: RepetitionScore[][] = [];
    let last = Infinity;
    for (const score of this.ofSession(state)) {
      if (score.repetition <= last) blocks.push([]);
      last = score.repetition;
      blocks.at(-1)!.push(score);
    }
    return blocks;
  }
}
