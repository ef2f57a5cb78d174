import { expect, test } from "vitest";
import type { RecordingRow, SessionRow } from "../src/api";
import { recordingOf } from "../src/model/session_recording";

const at = (seconds: number): string => new Date(Date.UTC(2026, 0, 5, 10) + seconds * 1000).toISOString();
function session(start: number, end: number | null, subject = "learner"): SessionRow {
  return { id: 1, learner: "L-1", subject, start: at(start), end: end == null ? null : at(end), reference: "squat", plan: "", repetitions: 1, mean_total: 50, cues: 1 };
}
function recording(name: string, start: number, duration: number, more: Partial<RecordingRow> = {}): RecordingRow {
  return { name, bytes: 1, state: "finished", subject: "learner", start: at(start), duration, references: [], repetitions: 1, coached: true, ...more };
}

test("a session is found where it begins in the recording that holds it", () => {
  const all = [recording("b.mcap", 300, 60), recording("a.mcap", 0, 200)];
  expect(recordingOf(session(50.5, 90), all)).toEqual({ name: "a.mcap", at: 50.7 });
  expect(recordingOf(session(310, 340), all)).toEqual({ name: "b.mcap", at: 10.2 });
});

test("a recording that began after its session is played from its start", () => {
  expect(recordingOf(session(0, 60), [recording("a.mcap", 0.6, 60)])).toEqual({ name: "a.mcap", at: 0 });
});

test("of two recordings of a session the one that has more of it is taken", () => {
  expect(recordingOf(session(0, 100), [recording("short.mcap", 0, 20), recording("long.mcap", 20, 90)])?.name).toBe("long.mcap");
});

test("no recording of another time or subject, and none that is damaged", () => {
  expect(recordingOf(session(0, 60), [])).toBeNull();
  expect(recordingOf(session(0, 60), [recording("later.mcap", 60, 60), recording("before.mcap", -60, 60)])).toBeNull();
  expect(recordingOf(session(0, 60), [recording("other.mcap", 0, 60, { subject: "anna" })])).toBeNull();
  expect(recordingOf(session(0, 60), [recording("torn.mcap", 0, 60, { state: "damaged" })])).toBeNull();
});

test("a session whose end nobody heard is not found in a recording of much later", () => {
  expect(recordingOf(session(0, null), [recording("later.mcap", 3600, 60)])).toBeNull();
  expect(recordingOf(session(5, null), [recording("its.mcap", 0, 8)])).toEqual({ name: "its.mcap", at: 5.2 });
});
