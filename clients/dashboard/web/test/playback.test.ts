import { expect, test } from "vitest";
import { clock, Playback } from "../src/model/playback";

function at(head: number, duration = 10): Playback {
  const playback = new Playback(duration);
  playback.seek(head);
  playback.toggle();
  return playback;
}

test("plays at its speed and ends at the end", () => {
  const playback = at(1);
  playback.speed = 0.5;
  playback.advance(2);
  expect(playback.head).toBeCloseTo(2);
  playback.speed = 4;
  playback.advance(5);
  expect(playback.head).toBe(10);
  expect(playback.playing).toBe(false);
  playback.toggle();
  expect(playback.head).toBe(0);
});

test("speeds stay from a tenth to four times", () => {
  const playback = new Playback(10);
  playback.speed = 100;
  expect(playback.speed).toBe(4);
  playback.speed = 0;
  expect(playback.speed).toBe(0.1);
});

test("does not move while it rests", () => {
  const playback = new Playback(10);
  playback.advance(3);
  expect(playback.head).toBe(0);
});

test("a loop begins again by what it overshot", () => {
  const playback = at(3.5);
  playback.setLoop({ from: 2, to: 4 });
  expect(playback.advance(1)).toBe(true);
  expect(playback.head).toBeCloseTo(2.5);
  // Also by more than its length.
  expect(playback.advance(4.25)).toBe(true);
  expect(playback.head).toBeGreaterThanOrEqual(2);
  expect(playback.head).toBeLessThanOrEqual(4);
});

test("a loop is entered when it is set, and left by seeking behind it", () => {
  const playback = at(9);
  playback.setLoop({ from: 2, to: 4 });
  expect(playback.head).toBe(2);
  playback.seek(6);
  expect(playback.advance(1)).toBe(false);
  expect(playback.head).toBeCloseTo(7);
});

test("an empty or reversed loop is none, one too long is cut", () => {
  const playback = new Playback(10);
  playback.setLoop({ from: 4, to: 4 });
  expect(playback.loop).toBeNull();
  playback.setLoop({ from: 5, to: 4 });
  expect(playback.loop).toBeNull();
  playback.setLoop({ from: -3, to: 30 });
  expect(playback.loop).toEqual({ from: 0, to: 10 });
});

test("seeking stays within the recording", () => {
  const playback = new Playback(10);
  playback.seek(-1);
  expect(playback.head).toBe(0);
  playback.seek(99);
  expect(playback.head).toBe(10);
  playback.seek(Number.NaN);
  expect(playback.head).toBe(0);
});

test("the clock says minutes, seconds and tenths", () => {
  expect(clock(0)).toBe("0:00.0");
  expect(clock(75.25)).toBe("1:15.2");
  expect(clock(3599.96)).toBe("59:59.9");
});
