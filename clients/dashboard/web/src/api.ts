// The bridge's HTTP interface.

export interface Info { subject: string; version: string; page_version?: string; history: boolean }
export interface Plan {
  name: string; description: string;
  blocks: { name: string; repetitions: number; tempo: number; schedule: string | { kind: string } }[];
}
export interface ReferenceInfo {
  name: string; description: string; duration: number;
  joints: { name: string; weight: number; tolerance_deg: number }[];
}
export interface Learner { id: string; note: string; created: string; sessions: number; last_session: string | null }
export interface SessionRow {
  id: string | number; learner: string; subject: string; start: string; end: string | null; reference: string; plan: string;
  repetitions: number; mean_total: number | null; cues: number;
}
export interface Details extends SessionRow {
  blocks: {
    index: number; name: string; tempo: number | null; schedule: string;
    repetitions: {
      number: number; total: number; cues: number;
      joints: { name: string; measured: boolean; rms_deg: number | null; in_band: number | null }[];
    }[];
  }[];
  exposure: { channel: number; segment: string; dose: number; duty: number; heat: number }[];
}
export interface ProgressPoint {
  session: string | number; start: string; block: string | number; schedule: string; tempo: number;
  cued: boolean | null;  // null: some repetitions were
  mean_total: number | null; repetitions: number; joints: Record<string, number>;
}
export interface Block { session: string | number; start: string; name: string; mean_total: number; repetitions: number }
export interface Retention {
  kind: "after_cues" | "across_days";
  practice: Block;
  retention: Block;
  pause: number;   // [s]
  change: number;
}
export interface Progress {
  points: ProgressPoint[];
  retention: Retention[];
  schedules: { schedule: string; sessions: number; first: number | null; last: number | null; retention: number | null }[];
}

export interface RecordingRow {
  name: string; bytes: number; state: "finished" | "being recorded" | "unfinished" | "damaged"; error?: string;
  subject?: string; start?: string; duration?: number; references: string[]; repetitions: number; coached: boolean;
}
export interface Rerun { reference?: string; tolerance_scale?: number; max_cues?: number; body_map?: string; plan?: string }
export interface Job {
  job: string; state: "waiting" | "running" | "done" | "failed"; progress: number; error?: string;
  result?: { frames: number; cues: number; totals: number[]; remarks: string[] };
}

// ---- takes and references: docs/references.md
export interface TakePart { start: number; end: number; chosen: boolean }
export interface TakeInfo {
  id: string; recorded: string; source: string; faults: string[]; duration: number; rate_hz: number;
  found: number; difference: number; parts: TakePart[];
}
export interface RecorderState {
  phase: "idle" | "countdown" | "recording"; remaining: number; elapsed: number; most: number;
  alive: boolean; source: string; rate_hz: number; lost: number; paused: boolean; trouble: string; recorded: number;
}
export interface Takes { state: RecorderState; takes: TakeInfo[] }
export interface DrawnMotion {
  rate_hz: number;
  skeleton: { name: string; parent: number; offset: number[]; end: number[] }[];
  poses: number[][];  // root x y z, then x y z w of each joint
}
export interface ChosenPart { take: string; start: number; end: number }
export interface ProposedJoint {
  name: string; measured: boolean; range_deg: number; spread_deg: number; weight: number; tolerance_deg: number; of_interest: boolean;
}
export interface Draft {
  experts: number; duration: number; standing: boolean; mean: DrawnMotion; when: number[][]; joints: ProposedJoint[];
  curves: { joint: string; movement: string; mean: number[]; spread: number[]; parts: number[][] }[];
}
export interface NewReference {
  name: string; description: string; standing: boolean; parts: ChosenPart[];
  joints: Record<string, { weight: number; tolerance_deg: number }>;
}
export interface KnownReference { name: string; description: string; duration: number; performances: number; own: boolean }

async function call<T>(method: string, path: string, body?: object | File): Promise<T> {
  const response = await fetch(path, {
    method, cache: "no-store",
    ...(body instanceof File ? { body }
      : body && { headers: { "content-type": "application/json" }, body: JSON.stringify(body) }),
  });
  const text = await response.text();
  if (!response.ok) {
    let why = `${response.status} ${response.statusText}`;
    try {
      why = (JSON.parse(text) as { error?: string }).error ?? why;
    } catch {
      // No JSON: the status says enough.
    }
    throw new Error(why);
  }
  return (text === "" ? undefined : JSON.parse(text)) as T;
}

const part = encodeURIComponent;
const history = "api/history";
const recordings = "api/recordings";

export const api = {
  info: () => call<Info>("GET", "api/info"),
  plans: () => call<Plan[]>("GET", "api/plans"),
  bodyMaps: () => call<string[]>("GET", "api/body_maps"),
  reference: (name: string) => call<ReferenceInfo>("GET", `api/references/${part(name)}`),
  learners: () => call<Learner[]>("GET", `${history}/learners`),
  addLearner: (note = "") => call<{ id: string }>("POST", `${history}/learners`, { note }),
  setNote: (id: string, note: string) => call<unknown>("PATCH", `${history}/learners/${part(id)}`, { note }),
  removeLearner: (id: string) => call<unknown>("DELETE", `${history}/learners/${part(id)}`),
  sessions: (learner: string) => call<SessionRow[]>("GET", `${history}/sessions?learner=${part(learner)}`),
  session: (id: string | number) => call<Details>("GET", `${history}/sessions/${part(String(id))}`),
  progress: (learner: string, reference: string) =>
    call<Progress>("GET", `${history}/progress?learner=${part(learner)}&reference=${part(reference)}`),
  /// Begins it; its job says when it is done.
  removeRecordings: (learner: string) => call<Job>("DELETE", `${recordings}?learner=${part(learner)}`),
  removal: (job: string) =>
    call<{ state: Job["state"]; error?: string; result?: { removed: string[]; kept: { name: string; why: string }[] } }>("GET", `${recordings}/removals/${part(job)}`),
  recordings: () => call<RecordingRow[]>("GET", recordings),
  recordingUrl: (name: string, what: "file" | "states" | "expert") => `${recordings}/${part(name)}/${what}`,
  repair: (name: string) => call<Job>("POST", `${recordings}/${part(name)}/repaired`),
  repairedUrl: (name: string, job: string) => `${recordings}/${part(name)}/repaired/${part(job)}`,
  rerun: (name: string, settings: Rerun) => call<Job>("POST", `${recordings}/${part(name)}/rerun`, settings),
  rerunState: (name: string, job: string) => call<Job>("GET", `${recordings}/${part(name)}/reruns/${part(job)}`),
  rerunUrl: (name: string, job: string, what: "file" | "states") => `${recordings}/${part(name)}/reruns/${part(job)}/${what}`,
  reportUrl: (learner: string, format: "html" | "pdf") => `${history}/report?learner=${part(learner)}&format=${format}`,
  exportUrl: (learner: string, format: "csv" | "json") => `${history}/export?learner=${part(learner)}&format=${format}`,
  takes: () => call<Takes>("GET", "api/takes"),
  record: (countdown: number, most_seconds: number) => call<Takes>("POST", "api/takes/record", { countdown, most_seconds }),
  stopRecording: () => call<Takes>("POST", "api/takes/stop", {}),
  removeTake: (id: string) => call<unknown>("DELETE", `api/takes/${part(id)}`),
  setParts: (id: string, parts: TakePart[]) => call<TakeInfo>("PUT", `api/takes/${part(id)}`, { parts }),
  takeMotion: (id: string) => call<DrawnMotion>("GET", `api/takes/${part(id)}/motion`),
  importTake: (file: File) => call<TakeInfo>("POST", `api/takes/import?name=${part(file.name)}`, file),
  draft: (parts: ChosenPart[]) => call<Draft>("POST", "api/takes/draft", { parts }),
  saveReference: (reference: NewReference) => call<{ name: string }>("POST", "api/takes/save", reference),
  references: () => call<KnownReference[]>("GET", "api/references"),
  exportReferenceUrl: (name: string, format: string) => `api/references/${part(name)}/export?format=${format}`,
};
