// Where a tactor is drawn on the flat figure: front and back, limbs away from the trunk so that rings
// have room. The figure is drawn as we see a person who faces us: its left is on our right.
import type { TactorSite } from "../messages";

export interface Limb {
  x: number; y: number;      // proximal end
  x2: number; y2: number;    // distal end
  r: number; r2: number;     // half width at both ends
}
export const FIGURE = { width: 200, height: 330 };

// The left half and the middle; the right is its mirror image. By the upper joint, as in body maps.
const HALF: Record<string, Limb> = {
  left_shoulder: { x: 137, y: 78, x2: 158, y2: 134, r: 15, r2: 14 },
  left_elbow: { x: 158, y: 134, x2: 177, y2: 190, r: 14, r2: 13 },
  left_wrist: { x: 177, y: 193, x2: 183, y2: 210, r: 10, r2: 7 },
  left_hip: { x: 120, y: 172, x2: 124, y2: 238, r: 19, r2: 16 },
  left_knee: { x: 124, y: 238, x2: 127, y2: 302, r: 16, r2: 11 },
  left_ankle: { x: 127, y: 306, x2: 131, y2: 316, r: 9, r2: 8 },
};
const MIDDLE: Record<string, Limb> = {
  pelvis: { x: 100, y: 166, x2: 100, y2: 150, r: 33, r2: 31 },
  spine_lower: { x: 100, y: 150, x2: 100, y2: 126, r: 31, r2: 31 },
  spine_middle: { x: 100, y: 126, x2: 100, y2: 102, r: 31, r2: 33 },
  spine_upper: { x: 100, y: 102, x2: 100, y2: 74, r: 33, r2: 33 },
  neck: { x: 100, y: 66, x2: 100, y2: 52, r: 10, r2: 10 },
  head: { x: 100, y: 38, x2: 100, y2: 24, r: 18, r2: 18 },
};

function mirror(limb: Limb): Limb {
  return { ...limb, x: FIGURE.width - limb.x, x2: FIGURE.width - limb.x2 };
}

/// Every segment as we see it from the front.
export const LIMBS: ReadonlyMap<string, Limb> = new Map([
  ...Object.entries(MIDDLE),
  ...Object.entries(HALF),
  ...Object.entries(HALF).map(([name, limb]): [string, Limb] => [name.replace("left_", "right_"), mirror(limb)]),
]);

export interface Place { side: "front" | "back"; x: number; y: number }

/// One place, or two for a tactor at the very side: it is seen from the front and from the back.
export function placesOf(site: TactorSite): Place[] {
  const limb = LIMBS.get(site.segment);
  if (limb == undefined) return [];
  const along = Math.min(1, Math.max(0, site.along));
  const r = (limb.r + (limb.r2 - limb.r) * along) * 0.92;
  // angle 90 degrees: the person's left, which a person who faces us has on our right.
  const aside = Math.sin(site.angle) * r;
  const ahead = Math.cos(site.angle);
  const length = Math.hypot(limb.x2 - limb.x, limb.y2 - limb.y) || 1;
  // Across the limb: its direction turned, so that it points to our right.
  let nx = (limb.y2 - limb.y) / length;
  let ny = -(limb.x2 - limb.x) / length;
  if (nx < 0) { nx = -nx; ny = -ny; }
  const x = limb.x + (limb.x2 - limb.x) * along + nx * aside;
  const y = limb.y + (limb.y2 - limb.y) * along + ny * aside;
  const places: Place[] = [];
  if (ahead > -0.2) places.push({ side: "front", x, y });
  if (ahead < 0.2) places.push({ side: "back", x: FIGURE.width - x, y });
  return places;
}

export type Side = "front" | "back" | "left" | "right" | "front-left" | "front-right" | "back-left" | "back-right";

/// Which side of the segment it is on, in eighths.
export function sideOf(angle: number): Side {
  const sides: Side[] = ["front", "front-left", "left", "back-left", "back", "back-right", "right", "front-right"];
  const eighth = Math.round(angle / (Math.PI / 4));
  return sides[((eighth % 8) + 8) % 8]!;
}
