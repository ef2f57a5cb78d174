// The board's forty slots (docs/tactors.md): which tactor is driven how.

export const TACTORS = 16;
export type Mode = "continuous" | "pulsed" | "saltation" | "saltation-reverse";
export interface Drive {
  level: number;  // share of full voltage, 0 or 0.30 to 1
  mode: Mode | null;
}

const FAINTEST = 54;

export function levelOf(intensity: number): number {
  return intensity < FAINTEST ? 0 : Math.pow(0.3, (255 - intensity) / 201);
}

// A controller's slots: 8 continuous, 8 pulsed, 2 + 2 saltation. Of several on one tactor the strongest
// drives it.
export function decodeSlots(intensities: ArrayLike<number>): Drive[] {
  const drives: Drive[] = Array.from({ length: TACTORS }, () => ({ level: 0, mode: null }));
  const put = (tactor: number, level: number, mode: Mode): void => {
    const drive = drives[tactor];
    if (drive != undefined && level > drive.level) drives[tactor] = { level, mode };
  };
  for (let slot = 0; slot < 40; slot++) {
    const level = levelOf(intensities[slot] ?? 0);
    if (level === 0) continue;
    const first = slot < 20 ? 0 : 8;
    const place = slot % 20;
    if (place < 8) put(first + place, level, "continuous");
    else if (place < 16) put(first + place - 8, level, "pulsed");
    else {
      const group = first + (place < 18 ? 0 : 4);
      const mode = place % 2 === 0 ? "saltation" : "saltation-reverse";
      for (let i = 0; i < 4; i++) put(group + i, level, mode);
    }
  }
  return drives;
}
