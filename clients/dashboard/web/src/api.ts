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
  id: string | number; learner: string; start: string; end: string | null; reference: string; plan: string;
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

async function call<T>(method: string, path: string, body?: object): Promise<T> {
  const response = await fetch(path, {
    method, cache: "no-store",
    ...(body && { headers: { "content-type": "application/json" }, body: JSON.stringify(body) }),
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

export const api = {
  info: () => call<Info>("GET", "api/info"),
  plans: () => call<Plan[]>("GET", "api/plans"),
  reference: (name: string) => call<ReferenceInfo>("GET", `api/references/${part(name)}`),
  learners: () => call<Learner[]>("GET", `${history}/learners`),
  addLearner: (note = "") => call<{ id: string }>("POST", `${history}/learners`, { note }),
  setNote: (id: string, note: string) => call<unknown>("PATCH", `${history}/learners/${part(id)}`, { note }),
  removeLearner: (id: string) => call<unknown>("DELETE", `${history}/learners/${part(id)}`),
  sessions: (learner: string) => call<SessionRow[]>("GET", `${history}/sessions?learner=${part(learner)}`),
  session: (id: string | number) => call<Details>("GET", `${history}/sessions/${part(String(id))}`),
  progress: (learner: string, reference: string) =>
    call<Progress>("GET", `${history}/progress?learner=${part(learner)}&reference=${part(reference)}`),
  reportUrl: (learner: string, format: "html" | "pdf") => `${history}/report?learner=${part(learner)}&format=${format}`,
  exportUrl: (learner: string, format: "csv" | "json") => `${history}/export?learner=${part(learner)}&format=${format}`,
};
