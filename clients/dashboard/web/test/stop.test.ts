import { expect, test } from "vitest";
import { CONFIRM_WITHIN, StopModel } from "../src/model/stop";

test("only the topic makes a stop true", () => {
  const stop = new StopModel();
  expect(stop.shown(0, true)).toBe("ready");
  stop.press(1, true);
  expect(stop.shown(1.1, true)).toBe("sending");
  stop.take(true, "dashboard");
  expect(stop.shown(1.2, true)).toBe("in-force");
  stop.take(false, "");
  expect(stop.shown(9, true)).toBe("ready");
});

test("a press without an answer is said to be unconfirmed, for as long as it is", () => {
  const stop = new StopModel();
  stop.press(1, true);
  expect(stop.shown(1 + CONFIRM_WITHIN + 0.1, true)).toBe("unconfirmed");
  stop.take(false, "");  // somebody else's lift is no answer to it
  expect(stop.shown(3, true)).toBe("unconfirmed");
  expect(stop.waiting).toBe(true);
  stop.take(true, "dashboard");
  expect(stop.waiting).toBe(false);
});

test("without a connection nothing is claimed, and a press waits", () => {
  const stop = new StopModel();
  stop.take(true, "earlier");
  expect(stop.shown(0, false)).toBe("offline");
  stop.press(1, false);
  expect(stop.waiting).toBe(true);
  expect(stop.shown(5, false)).toBe("unconfirmed");
});

test("pressing again while it is in force asks for nothing new", () => {
  const stop = new StopModel();
  stop.take(true, "dashboard");
  stop.press(1, true);
  expect(stop.shown(9, true)).toBe("in-force");
});
