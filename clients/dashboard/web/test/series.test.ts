import { expect, test } from "vitest";
import { Series } from "../src/model/series";

test("keeps its span and no more", () => {
  const series = new Series(["a"], 10);
  for (let t = 0; t <= 25; t++) series.push(t, [t * 2]);
  expect(series.time[0]).toBe(15);
  expect(series.lines[0]).toEqual(series.time.map((t) => t * 2));
});

test("never grows beyond its bound, however fast data come", () => {
  const series = new Series(["a", "b"], 1000, 50);
  for (let i = 0; i < 500; i++) series.push(i / 1000, [i, null]);
  expect(series.time).toHaveLength(50);
  expect(series.lines.every((line) => line.length === 50)).toBe(true);
  expect(series.lines[0]!.at(-1)).toBe(499);
});

test("the same time twice counts once, an earlier time begins anew", () => {
  const series = new Series(["a"], 10);
  series.push(5, [1]);
  series.push(5, [2]);
  expect(series.lines[0]).toEqual([1]);
  series.push(1, [3]);
  expect([series.time, series.lines[0]]).toEqual([[1], [3]]);
});

test("a gap parts two stretches", () => {
  const series = new Series(["a"], 10);
  series.push(1, [1]);
  series.gap();
  series.push(2, [2]);
  expect(series.lines[0]).toEqual([1, null, 2]);
});
