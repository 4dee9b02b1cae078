// Manual thrust: the set points of every boat that this page drives by hand, streamed while the page is seen and has the focus.
// Coming back, from another tab or a lost link, never resumes motion: the set points are 0 and silent until the operator acts.
import type { Net } from "./net";
import type { State } from "./state";

const STREAM_MS = 200;
const ASLEEP_MS = 1000; // a timer that stands still for so long means that the page, or the laptop, slept
const MOST_PCT = 100;
const TAKE_MS = 1000; // for the gateway to know that this page drives now
const CONFIRM_MS = 3000; // a boat that is not in manual so long after the request is not driven

export type Thrusters = "both" | "port" | "starboard";

export interface Hand {
  port_pct: number;
  starboard_pct: number;
  n: number;
  silent: boolean;
  released: boolean; // as the gateway said last
  begun: number; // when this page took it
  since: number; // when manual mode was asked for; -Infinity once the boat was seen in it
}

const limited = (pct: number): number => Math.max(-MOST_PCT, Math.min(MOST_PCT, pct));

export class Drive {
  private readonly hands = new Map<number, Hand>();
  private streamed = Date.now();

  constructor(
    private readonly net: Net,
    private readonly state: State,
    private readonly changed: () => void,
  ) {
    setInterval(() => this.stream(), STREAM_MS);
    state.on(["boats"], () => this.confirm());
    window.addEventListener("blur", () => this.release("another window is in front"));
    window.addEventListener("pagehide", () => this.release("the page was closed"));
    document.addEventListener("visibilitychange", () => document.hidden && this.release("the page is hidden"));
    document.addEventListener("freeze", () => this.release("the browser paused the page"));
  }

  hand(id: number): Readonly<Hand> | undefined {
    return this.hands.get(id);
  }

  /** Whether this page drives any boat. */
  get busy(): boolean {
    return this.hands.size > 0;
  }

  /** The operator asked for manual mode: start from zero. */
  begin(id: number): void {
    const [n, released] = [this.hands.get(id)?.n ?? 0, this.state.byId(id)?.released ?? false];
    const now = performance.now();
    this.hands.set(id, { port_pct: 0, starboard_pct: 0, n, silent: false, released, begun: now, since: now });
    this.changed();
  }

  end(id: number): void {
    this.hands.delete(id);
    this.changed();
  }

  endAll(): void {
    this.hands.clear();
    this.changed();
  }

  set(id: number, which: Thrusters, pct: number): void {
    const hand = this.taken(id);
    if (which !== "starboard") hand.port_pct = limited(pct);
    if (which !== "port") hand.starboard_pct = limited(pct);
    this.send(id, hand);
  }

  setBoth(id: number, port_pct: number, starboard_pct: number): void {
    const hand = this.taken(id);
    [hand.port_pct, hand.starboard_pct] = [limited(port_pct), limited(starboard_pct)];
    this.send(id, hand);
  }

  /** Add to the common speed, %. */
  faster(id: number, which: Thrusters, by: number): void {
    const hand = this.taken(id);
    if (which !== "starboard") hand.port_pct = limited(hand.port_pct + by);
    if (which !== "port") hand.starboard_pct = limited(hand.starboard_pct + by);
    this.send(id, hand);
  }

  /** Add to the differential speed, %: positive turns to starboard. */
  turn(id: number, which: Thrusters, by: number): void {
    const hand = this.taken(id);
    if (which !== "starboard") hand.port_pct = limited(hand.port_pct + by);
    if (which !== "port") hand.starboard_pct = limited(hand.starboard_pct - by);
    this.send(id, hand);
  }

  /** Let go of one boat, or of all. */
  release(why: string, only?: number): void {
    for (const [boat, hand] of this.hands) {
      if (only !== undefined && boat !== only) continue;
      if (!hand.silent) this.net.stream({ t: "release", boat, why });
      this.fall(hand);
    }
  }

  private taken(id: number): Hand {
    if (!this.hands.has(id)) this.begin(id);
    const hand = this.hands.get(id)!;
    hand.silent = false;
    return hand;
  }

  private confirm(): void {
    for (const [id, hand] of [...this.hands]) {
      const boat = this.state.byId(id);
      if (boat?.mode === "manual") hand.since = -Infinity;
      else if (boat?.asked !== "manual" && performance.now() - hand.since > CONFIRM_MS) this.end(id);
      if (boat && this.state.drivenElsewhere(boat) && performance.now() - hand.begun > TAKE_MS) this.end(id);
      if (boat?.released && !hand.released) this.fall(hand);
      hand.released = boat?.released ?? false;
    }
  }

  /** The gateway has put the thrust to 0 for a reason of its own: wait for the operator. */
  private fall(hand: Hand): void {
    Object.assign(hand, { port_pct: 0, starboard_pct: 0, silent: true });
    this.changed();
  }

  private stream(): void {
    const slept_ms = Date.now() - this.streamed;
    this.streamed = Date.now();
    if (slept_ms > ASLEEP_MS) this.release("the page slept");
    for (const [id, hand] of this.hands) if (!hand.silent) this.send(id, hand);
  }

  private send(boat: number, hand: Hand): void {
    const seen = document.visibilityState === "visible" && document.hasFocus();
    if (seen && this.state.byId(boat)?.mode === "manual") {
      this.net.stream({ t: "input", boat, n: ++hand.n, port_pct: hand.port_pct, starboard_pct: hand.starboard_pct });
    }
    this.changed();
  }
}
