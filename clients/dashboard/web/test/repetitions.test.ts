import { expect, test } from "vitest";
import type { RepetitionScore, SessionState } from "../src/messages";
import { Repetitions } from "../src/model/repetitions";

const score = (repetition: number, end: number): RepetitionScore =>
  ({ repetition, start_ns: BigInt(end - 1), end_ns: BigInt(end), total: 50, cues: 0, joints: [] });
const state = (session: number, block: number): SessionState =>
  ({ session_start_ns: BigInt(session), block_start_ns: BigInt(block) }) as SessionState;

test("what came twice, as after a reload of the bridge, counts once and in order", () => {
  const all = new Repetitions();
  for (const one of [score(2, 30), score(1, 20), score(2, 30)]) all.add(one);
  expect(all.ofSession(state(10, 10)).map((one) => one.repetition)).toEqual([1, 2]);
});

test("an earlier session's do not count", () => {
  const all = new Repetitions();
  for (const one of [score(1, 20), score(2, 30), score(1, 50)]) all.add(one);
  expect(all.ofSession(state(40, 40)).map(({ end_ns }) => end_ns)).toEqual([50n]);
});

test("blocks are told apart, also by a page that came late", () => {
  const all = new Repetitions();
  for (const one of [score(1, 20), score(2, 30), score(1, 50), score(2, 60), score(3, 70)]) all.add(one);
  expect(all.byBlock(state(10, 45)).map((block) => block.length)).toEqual([2, 3]);
  expect(all.ofBlock(state(10, 45))).toHaveLength(3);
});
