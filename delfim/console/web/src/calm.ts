// Nobody looks closer at a page than somebody who touches it. While nobody does, what the boats tell is shown twice a second and
// not with each message, unless it is what an operator waits for: a command that was taken, a trouble, a boat that has gone far.
import type { Chart, Pixel } from "./chart";
import type { Drive } from "./drive";
import { position } from "./fleet";
import { freshness } from "./state";
import type { Boat } from "./wire";

const TOUCHED_MS = 2000; // so long after a touch everything is shown at once
const SHOWN_MS = 500; // between two showings at rest
const FAR_PX = 3;
const SELDOM_S = 0.5; // what is told no oftener is shown at once: a replay that runs, a link that is thin
const TOUCHES = ["pointerdown", "pointermove", "pointerup", "wheel", "keydown"];

interface Told {
  boats: Boat[];
  at_s: number;
  came: number; // by this page's clock
}

export class Calm {
  private touched = -Infinity;
  private showed = -Infinity;
  private shown_s = -Infinity; // of the boats' time
  private waiting: Told | null = null;
  private looks = "";
  private pixels: (Pixel | null)[] = [];
  private timer = 0;

  constructor(
    private readonly chart: Chart,
    private readonly drive: Drive,
    private readonly show: (told: Told) => void,
  ) {
    for (const each of TOUCHES) window.addEventListener(each, () => this.touch(), { capture: true, passive: true });
  }

  take(boats: Boat[], at_s: number): void {
    this.waiting = { boats, at_s, came: performance.now() };
    const since_ms = this.waiting.came - this.showed;
    if (!this.isResting || since_ms >= SHOWN_MS || this.isUrgent(this.waiting)) this.tell();
    else this.timer ||= window.setTimeout(() => this.tell(), SHOWN_MS - since_ms);
  }

  /** What waits is shown now: the next message counts on it. */
  tell(): void {
    const told = this.waiting;
    clearTimeout(this.timer);
    [this.timer, this.waiting] = [0, null];
    if (!told) return;
    [this.showed, this.shown_s] = [performance.now(), told.at_s];
    this.show(told);
    [this.looks, this.pixels] = [looksOf(told.boats), told.boats.map((each) => this.pixelOf(each))];
  }

  private touch(): void {
    this.touched = performance.now();
    this.tell();
  }

  private get isResting(): boolean {
    return performance.now() - this.touched > TOUCHED_MS && !this.drive.busy;
  }

  private isUrgent({ boats, at_s }: Told): boolean {
    if (Math.abs(at_s - this.shown_s) > SELDOM_S || looksOf(boats) !== this.looks) return true;
    return boats.some((boat, i) => {
      const [now, was] = [this.pixelOf(boat), this.pixels[i]];
      return now && was ? Math.hypot(now[0] - was[0], now[1] - was[1]) >= FAR_PX : Boolean(now) !== Boolean(was);
    });
  }

  private pixelOf(boat: Boat): Pixel | null {
    const place = position(boat);
    return place && this.chart.pixelOf(place);
  }
}

/** What of the boats cannot wait. */
function looksOf(boats: Boat[]): string {
  return boats
    .map(({ id, mode, asked, armed, owner, commander, twins, ready, reason, failsafe, forced, released, driver, order, guard, mission, speed_pct, age_s }) =>
      [id, mode, asked, armed, owner, commander, twins, ready, reason, failsafe, forced, released, driver, order?.words, guard, mission.count, mission.current, mission.state, speed_pct, freshness(age_s.heard ?? Infinity)].join("|"),
    )
    .join("\n");
}
