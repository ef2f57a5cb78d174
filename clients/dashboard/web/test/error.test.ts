import { expect, test } from "vitest";
import { COLOURS, gradeOf, THICKNESS, worst } from "../src/model/error";
import type { Correction } from "../src/messages";

test("a grade is the error over the tolerance", () => {
  expect(gradeOf(0.05, 0.1)).toBe("inside");
  expect(gradeOf(0.11, 0.1)).toBe("outside");
  expect(gradeOf(0.21, 0.1)).toBe("far");
  expect(gradeOf(0.1, 0)).toBe("none");
  expect(gradeOf(NaN, 0.1)).toBe("none");
});

test("a grade does not flicker at its edge", () => {
  expect(gradeOf(0.095, 0.1, "outside")).toBe("outside");
  expect(gradeOf(0.095, 0.1, "inside")).toBe("inside");
  expect(gradeOf(0.085, 0.1, "outside")).toBe("inside");
  expect(gradeOf(0.19, 0.1, "far")).toBe("far");
  expect(gradeOf(0.19, 0.1, "outside")).toBe("outside");
});

test("what a colour says, thickness says too", () => {
  expect(THICKNESS.inside).toBeLessThan(THICKNESS.outside);
  expect(THICKNESS.outside).toBeLessThan(THICKNESS.far);
});

// WCAG's relative luminance; colours that differ in lightness are told apart without hue.
const luminance = (hex: string): number => {
  const [r, g, b] = [1, 3, 5].map((i) => {
    const c = parseInt(hex.slice(i, i + 2), 16) / 255;
    return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  }) as [number, number, number];
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
test("limbs stand out from the ground, AA for graphics", () => {
  for (const colour of Object.values(COLOURS)) {
    expect((luminance(colour) + 0.05) / (luminance("#0d1117") + 0.05)).toBeGreaterThan(4.5);
  }
});

const joint = (name: string, error: number, tolerance: number): Correction["joints"][number] => ({
  joint: name, error: { x: error, y: 0, z: 0 }, tolerance, target: { x: 0, y: 0, z: 0 }, benefit: 0 });
const correction = (...joints: Correction["joints"]): Correction => ({ header: { frame: 1n, stamp_ns: 0n, publish_ns: 0n }, joints });

test("labels go to the worst joints outside, by how much they count", () => {
  const message = correction(joint("a", 0.05, 0.1), joint("b", 0.3, 0.1), joint("c", 0.25, 0.1), joint("toe", 0.9, 0.1));
  const weights = new Map([["b", 0.4], ["c", 1], ["toe", 0.1]]);
  expect(worst(message, weights, 3).map((one) => one.joint)).toEqual(["c", "b"]);
  expect(worst(message, new Map(), 1).map((one) => one.joint)).toEqual(["toe"]);
});
