// A gamepad, by the browser's own interface: its left stick drives the selected boat, in manual by thrust, in heading mode by heading
// and speed. What it does ends as all thrust by hand does (drive.ts), and when it is unplugged. It drives again only after the stick
// was at rest: nothing moves because a boat, a mode or a tab was chosen while somebody leans on the stick.
import type { Actions, Say } from "./actions";
import type { Drive } from "./drive";
import type { State } from "./state";
import type { Boat } from "./wire";

const LOOK_MS = 100;
const SEARCH_MS = 1000; // while there is none
const REST = 0.12; // of the way: sticks do not come back to exactly 0
const STOP_BUTTON = 1; // B, or the circle
const TURN_DEG = 2; // a look: 20 degrees a second
const FASTER_PCT = 2;

export class Pad {
  private present = false;
  private rested = false; // the stick was at rest since the boat and its mode were chosen, and since it last let go
  private chosen = ""; // boat and mode
  private hand: object | undefined; // on the boat's thrust; a stop ends it, and manual mode begins another
  private driven: number | null = null; // boat whose thrust is the stick's
  private stopped = false;
  private timer = 0;

  constructor(
    private readonly state: State,
    private readonly actions: Actions,
    private readonly drive: Drive,
    private readonly say: Say,
  ) {
    window.addEventListener("gamepadconnected", () => this.again());
    this.again();
  }

  private again(): void {
    clearTimeout(this.timer);
    try {
      this.look();
    } finally {
      this.timer = window.setTimeout(() => this.again(), this.present ? LOOK_MS : SEARCH_MS);
    }
  }

  private look(): void {
    // Browsers have it on this computer and over HTTPS only.
    const pad = [...(navigator.getGamepads?.() ?? [])].find((each) => each?.connected && each.axes.length > 1);
    if (!pad) return this.gone();
    if (!this.present) this.say(null, 6, "gamepad: the left stick drives the selected boat in manual and heading mode; B stops it");
    this.present = true;
    const boat = this.state.boat;
    const pressed = pad.buttons[STOP_BUTTON]?.pressed ?? false;
    if (pressed && !this.stopped && boat) this.actions.stop(boat.id);
    this.stopped = pressed;
    const [right, ahead] = [way(pad.axes[0]!), -way(pad.axes[1]!)];
    if (this.isFree(boat)) this.steer(boat, right, ahead);
    else this.letGo("the gamepad let go");
  }

  /** Whether the stick may drive this boat. Another boat or mode, a stop, a hidden page or a release of the thrust let go. */
  private isFree(boat: Boat | null): boat is Boat {
    const chosen = boat ? `${boat.id} ${this.actions.byHand(boat) ? "manual" : (this.actions.asked(boat) ?? boat.mode)}` : "";
    const hand = boat ? this.drive.hand(boat.id) : undefined;
    const same = chosen === this.chosen && hand === this.hand;
    [this.chosen, this.hand] = [chosen, hand];
    if (!boat || !same || !document.hasFocus() || this.actions.stopping.has(boat.id)) return false;
    return this.driven === null || !hand?.silent;
  }

  private steer(boat: Boat, right: number, ahead: number): void {
    const still = !right && !ahead;
    if (still) this.rested = true;
    if (!this.rested || (still && this.driven === null)) return;
    if (this.actions.byHand(boat)) this.thrust(boat, [ahead + right, ahead - right], still);
    else if (boat.mode === "heading") {
      if (right) this.actions.turn(boat, "both", Math.round(right * TURN_DEG));
      if (ahead) this.actions.faster(boat, "both", Math.round(ahead * FASTER_PCT));
    }
  }

  private thrust(boat: Boat, sides: number[], still: boolean): void {
    const [port, starboard] = sides.map((each) => Math.round(100 * Math.max(-1, Math.min(1, each)))) as [number, number];
    const hand = this.drive.hand(boat.id);
    if (hand?.port_pct !== port || hand.starboard_pct !== starboard) this.actions.setThrust(boat, port, starboard);
    this.hand = this.drive.hand(boat.id);
    this.driven = still ? null : boat.id;
  }

  private gone(): void {
    if (this.present) this.say(null, 4, "gamepad unplugged");
    this.present = false;
    this.letGo("the gamepad was unplugged");
  }

  private letGo(why: string): void {
    if (this.driven !== null) this.drive.release(why, this.driven);
    this.driven = null;
    this.rested = false;
  }
}

/** The way of an axis, -1 to 1, 0 at rest. */
function way(axis: number): number {
  return Math.abs(axis) < REST ? 0 : (axis - Math.sign(axis) * REST) / (1 - REST);
}
