import { expect, test } from "vitest";
import { decodeSlots, levelOf, TACTORS } from "../src/model/slots";

const board = (slots: Record<number, number>): number[] => Array.from({ length: 40 }, (_, i) => slots[i] ?? 0);

test("levels are those of docs/tactors.md's table", () => {
  const table: [number, number][] = [[54, 0.3], [80, 0.35], [105, 0.41], [130, 0.47], [155, 0.55], [180, 0.64], [205, 0.74], [230, 0.86], [255, 1]];
  for (const [intensity, level] of table) expect(levelOf(intensity)).toBeCloseTo(level, 2);
  for (const intensity of [0, 1, 53]) expect(levelOf(intensity)).toBe(0);
});

test("an empty board is off", () => {
  expect(decodeSlots(board({})).every(({ level, mode }) => level === 0 && mode == null)).toBe(true);
});

test("each tactor has its continuous and its pulsed slot", () => {
  for (let tactor = 0; tactor < TACTORS; tactor++) {
    const first = tactor < 8 ? 0 : 20;
    for (const [slot, mode] of [[first + tactor % 8, "continuous"], [first + 8 + tactor % 8, "pulsed"]] as const) {
      const drives = decodeSlots(board({ [slot]: 200 }));
      expect(drives[tactor]).toEqual({ level: levelOf(200), mode });
      expect(drives.filter(({ level }) => level > 0)).toHaveLength(1);
    }
  }
});

test("saltation drives its group of four, forward or reverse", () => {
  const groups: [number, number, string][] = [
    [16, 0, "saltation"], [17, 0, "saltation-reverse"], [18, 4, "saltation"], [19, 4, "saltation-reverse"],
    [36, 8, "saltation"], [37, 8, "saltation-reverse"], [38, 12, "saltation"], [39, 12, "saltation-reverse"]];
  for (const [slot, first, mode] of groups) {
    const on = decodeSlots(board({ [slot]: 255 })).flatMap((drive, i) => (drive.level > 0 ? [[i, drive.mode]] : []));
    expect(on).toEqual([0, 1, 2, 3].map((i) => [first + i, mode]));
  }
});

test("of several modes on one tactor the strongest drives it", () => {
  expect(decodeSlots(board({ 2: 100, 10: 220 }))[2]).toEqual({ level: levelOf(220), mode: "pulsed" });
  expect(decodeSlots(board({ 2: 230, 10: 220 }))[2]).toEqual({ level: levelOf(230), mode: "continuous" });
});
