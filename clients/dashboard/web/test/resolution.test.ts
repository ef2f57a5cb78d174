import { expect, test } from "vitest";
import { Resolution } from "../src/model/resolution";

/// Frames for so long on a machine that needs so much for a frame and for each drawn pixel of one by one.
function run(resolution: Resolution, seconds: number, frame: number, pixels: number, from = 0): number {
  let now = from;
  while (now < from + seconds) {
    now += Math.max(1 / 60, frame + pixels * resolution.ratio ** 2);
    resolution.frame(now);
  }
  return now;
}

test("stays fine where there is time", () => {
  const resolution = new Resolution(1.5);
  run(resolution, 30, 0.002, 0.005);
  expect(resolution.ratio).toBe(1.5);
});

test("is coarser where pixels cost too much, as little as it takes", () => {
  const resolution = new Resolution(1);
  run(resolution, 30, 0.002, 0.02);  // 45 frames a second
  expect(resolution.ratio).toBeCloseTo(0.8);
});

test("has an end, where limbs are still clear", () => {
  const resolution = new Resolution(1);
  run(resolution, 60, 0.002, 0.2);
  expect(resolution.ratio).toBeCloseTo(0.64);
});

test("is fine again where it was not the pixels", () => {
  const resolution = new Resolution(1);
  run(resolution, 30, 0.033, 0.0001);
  expect(resolution.ratio).toBe(1);
});

test("a page that loads, or was in the background, says nothing", () => {
  const resolution = new Resolution(1);
  let now = run(resolution, 2, 0.1, 0);
  now = run(resolution, 10, 0.002, 0.005, now);
  for (let i = 0; i < 5; i++) now = run(resolution, 1, 0.002, 0.005, now + 60);
  expect(resolution.ratio).toBe(1);
});

test("begins anew with another size", () => {
  const resolution = new Resolution(1);
  run(resolution, 30, 0.002, 0.02);
  resolution.reset();
  expect(resolution.ratio).toBe(1);
  run(resolution, 30, 0.002, 0.01);
  expect(resolution.ratio).toBe(1);
});
