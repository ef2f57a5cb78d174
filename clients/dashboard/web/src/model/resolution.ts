// How finely a picture is drawn: coarser where animation frames come too slowly and it helps, as on a machine
// without a graphics card, where each pixel costs time.

const ENOUGH = 57;       // frames a second that need no help
const STEP = 0.8;        // of the pixel ratio
const COARSEST = 0.6;    // drawn pixels by CSS pixels: limbs and colours are still clear
const SPAN = 2;          // frames are counted over [s]; the first span, of a page that loads, is passed over
const HELPED = 1.06;     // times as many frames, or it was not the pixels

export class Resolution {
  ratio: number;
  private before = 0;    // frames a second before the last step; 0: no step is on trial
  private settled = false;
  private start = 0;     // of the span [s]
  private frames = -1;   // of it; -1: none is under way
  private first = true;

  constructor(private readonly finest: number) { this.ratio = finest; }

  /// Anew, where the picture's size changed.
  reset(): void {
    this.ratio = this.finest;
    this.before = 0;
    this.frames = -1;
    this.settled = false;
    this.first = true;
  }

  /// Once an animation frame. @returns whether the ratio changed.
  frame(now: number): boolean {
    if (this.settled) return false;
    const passed = now - this.start;
    // A longer pause is a page in the background.
    if (this.frames < 0 || passed > 2 * SPAN) {
      this.start = now;
      this.frames = 0;
      return false;
    }
    this.frames++;
    if (passed < SPAN) return false;
    const rate = this.frames / passed;
    this.frames = -1;
    if (!this.first) return this.judge(rate);
    this.first = false;
    return false;
  }

  private judge(rate: number): boolean {
    if (this.before > 0 && rate < this.before * HELPED) {
      this.ratio = Math.min(this.finest, this.ratio / STEP);
      this.settled = true;
      return true;
    }
    this.before = 0;
    if (rate >= ENOUGH) return false;
    if (this.ratio * STEP < COARSEST) {
      this.settled = true;
      return false;
    }
    this.before = rate;
    this.ratio *= STEP;
    return true;
  }
}
