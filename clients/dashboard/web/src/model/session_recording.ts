// Which recording a session of the history is in, and where: by its subject and time, as a recording is a file
// that may be moved, deleted or brought here at any time.
import type { RecordingRow, SessionRow } from "../api";

const UNHEARD = 10;  // of a session whose end nobody heard, so much counts [s]
const BEGUN = 0.2;   // after its start the session's first messages are there [s]

/// `at` is where the session has just begun in it [s]; null: none of these recordings was made during the session.
export function recordingOf(session: SessionRow, recordings: readonly RecordingRow[]): { name: string; at: number } | null {
  const begin = Date.parse(session.start) / 1000;
  const end = session.end == null ? begin + UNHEARD : Date.parse(session.end) / 1000;
  let best: { name: string; at: number; overlap: number } | null = null;
  for (const { name, state, subject, start, duration } of recordings) {
    if (state === "damaged" || subject !== session.subject || start == undefined || duration == undefined) continue;
    const from = Date.parse(start) / 1000;
    const overlap = Math.min(end, from + duration) - Math.max(begin, from);
    if (overlap > (best?.overlap ?? 0)) best = { name, at: Math.max(0, begin - from + BEGUN), overlap };
  }
  return best && { name: best.name, at: best.at };
}

/// The address of a recording at a time [s].
export function recordingHash(name: string, at = 0): string {
  return `#recordings/${encodeURIComponent(name)}${at > 0 ? `/${at.toFixed(2)}` : ""}`;
}
