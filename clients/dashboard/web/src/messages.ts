// The topics' messages as the page sees them: idl/secondskin_msgs.idl, decoded. Only the fields that
// the page uses are named. 64-bit integers are bigint, enumerations numbers.

export interface Vec3 { x: number; y: number; z: number }
export interface Quat extends Vec3 { w: number }
export interface Header { frame: bigint; stamp_ns: bigint; publish_ns: bigint }

export interface SkeletonDefinition {
  skeleton_id: number;
  source: string;
  rate_hz: number;
  joints: { name: string; parent: number; offset: Vec3; end: Vec3 }[];
}

export interface SkeletonPose {
  header: Header;
  skeleton_id: number;
  root_position: Vec3;
  orientations: Quat[];
  confidences: ArrayLike<number>;
}

export interface MarkerCloud {
  header: Header;
  markers: { name: string; position: Vec3; residual: number; valid: boolean }[];
}

export interface ProjectorValues {
  header: Header;
  detectors: number;
  projectors: number;
  values: ArrayLike<number>;
}

export const SERVICE_STATES = ["starting", "running", "waiting", "fault", "ended"] as const;
export interface ServiceHealth {
  publish_ns: bigint;
  service: string;
  instance: string;
  state: number;
  message: string;
  rate_hz: number;
  samples: bigint;
  lost: bigint;
  latency_p50: number;
  latency_p99: number;
  confidence: number;
  sensors: { name: string; rate_hz: number; loss: number; confidence: number }[];
}

export interface ReferenceMotionList {
  references: { name: string; description: string; duration: number; rate_hz: number }[];
}

export interface TactorSite { channel: number; segment: string; along: number; angle: number }

export const SESSION_PHASES = ["idle", "running", "paused", "ended"] as const;
export interface SessionState {
  session_start_ns: bigint;
  phase: number;
  stopped: boolean;
  reference: string;
  body_map: string;
  tolerance_scale: number;
  max_cues: number;
  repetitions: number;
  tactors: TactorSite[];
  plan: string;
  blocks: number;
  block: number;
  block_name: string;
  block_start_ns: bigint;
  block_tempo: number;
  block_repetitions: number;
  block_planned: number;
  resting: boolean;
  cued_joints: number;
  cue_band: number;
  yoked: boolean;
  learner: string;
}

export const ALIGNMENT_PHASES = ["waiting", "moving", "paused", "finished", "lost"] as const;
export interface Alignment {
  header: Header;
  reference_time: number;
  tempo: number;
  confidence: number;
  phase: number;
  repetition: number;
}

export interface Correction {
  header: Header;
  joints: { joint: string; error: Vec3; tolerance: number; target: Vec3; benefit: number }[];
}

export interface TactorCommand { header: Header; valid_for_ns: bigint; intensities: ArrayLike<number> }

export interface EmergencyStop { publish_ns: bigint; active: boolean; reason: string }

export interface RepetitionScore {
  repetition: number;
  start_ns: bigint;
  end_ns: bigint;
  total: number;
  cues: number;
  joints: {
    joint: string; measured: boolean; rms: number; peak: number; in_band: number;
    timing_error: number; smoothness: number; range: number; reference_range: number;
  }[];
}

/// Streams: only the newest message counts. What is not listed here is state: each message counts.
export interface Streams {
  pose: SkeletonPose;
  expert: SkeletonPose;
  points: MarkerCloud;
  raw: ProjectorValues;
  alignment: Alignment;
  correction: Correction;
  tactors: TactorCommand;
}
export const STREAMS = ["pose", "expert", "points", "raw", "alignment", "correction", "tactors"] as const;

export interface States {
  skeleton: SkeletonDefinition;
  health: ServiceHealth;
  references: ReferenceMotionList;
  session_state: SessionState;
  stop: EmergencyStop;
  repetition: RepetitionScore;
}
export const STATES = ["skeleton", "health", "references", "session_state", "stop", "repetition"] as const;

export interface SessionCommand {
  action: "start" | "pause" | "resume" | "stop";
  reference?: string;
  tolerance_scale?: number;
  max_cues?: number;
  plan?: string;
  learner?: string;
}
