// What the page may say about the emergency stop. Only the `stop` topic makes it true; until it answers,
// a press is a wish.
export type StopShown =
  | "ready"         // tactors may vibrate
  | "sending"       // pressed, not yet confirmed
  | "unconfirmed"   // pressed, and no answer came: somebody must switch off the board
  | "in-force"      // the topic says so
  | "offline";      // no connection: a press can not reach the tactors

export const CONFIRM_WITHIN = 1.0;  // [s]

export class StopModel {
  active = false;
  reason = "";
  private pressed: number | null = null;

  /// A press while the stop is known to be in force changes nothing.
  /// @param now  a monotonic clock [s]
  press(now: number, connected: boolean): void {
    if (!connected || !this.active) this.pressed ??= now;
  }

  /// From the topic.
  take(active: boolean, reason: string): void {
    this.active = active;
    this.reason = reason;
    if (active) this.pressed = null;
  }

  /// Whether a press waits to be sent again when the connection is back.
  get waiting(): boolean { return this.pressed != null; }

  shown(now: number, connected: boolean): StopShown {
    if (this.pressed != null) return now - this.pressed > CONFIRM_WITHIN ? "unconfirmed" : "sending";
    if (!connected) return "offline";
    return this.active ? "in-force" : "ready";
  }
}
