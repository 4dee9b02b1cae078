// The watch for other vessels: which of them are grave, the sound until somebody has taken note, and the guard zone of this page.
import { distance_m } from "./geo";
import { position } from "./fleet";
import type { Sound } from "./sound";
import type { State } from "./state";
import type { Gravity, Nearness, Vessel } from "./wire";

const KEPT = "delfim.zone";
const AGAIN_MS = 4000; // the alarm sounds again, until it is acknowledged
const LEAVES = 1.1; // a vessel is out of the zone when it is so many times as far away

export const ZONES_M = [0, 50, 100, 200, 500, 1000];
const GRAVITY: Record<Gravity, number> = { none: 0, near: 1, danger: 2 };

export const graver = (a: Gravity, b: Gravity): Gravity => (GRAVITY[a] >= GRAVITY[b] ? a : b);

/** The boat that a vessel meets first, and how. */
export const worst = (vessel: Vessel): Nearness | undefined => vessel.boats[0];

export class Watch {
  zone_m = Number(localStorage.getItem(KEPT) ?? 0);
  private readonly inside = new Set<string>();
  private readonly told = new Map<string, Gravity>(); // by vessel: what was sounded
  private readonly noted = new Map<string, Gravity>(); // by vessel: what was acknowledged

  constructor(
    private readonly state: State,
    private readonly sound: Sound,
  ) {
    state.on(["vessels"], () => this.look());
    setInterval(() => this.alarming.length && sound.alarm(), AGAIN_MS);
  }

  setZone(m: number): void {
    this.zone_m = m;
    localStorage.setItem(KEPT, String(m));
    this.inside.clear();
    this.look();
    this.state.tell("vessels");
  }

  /** To whichever boat it is gravest; in the guard zone it is near at least. */
  gravity(vessel: Vessel): Gravity {
    const known = vessel.boats.reduce((most, each) => graver(most, each.danger), "none" as Gravity);
    return this.inside.has(vessel.key) ? graver(known, "near") : known;
  }

  /** Vessels in danger of which nobody has taken note; none in a replay. */
  get alarming(): Vessel[] {
    if (this.state.replaying) return [];
    return this.state.vessels.filter((each) => this.gravity(each) === "danger" && this.noted.get(each.key) !== "danger");
  }

  acknowledge(): void {
    for (const vessel of this.state.vessels) this.noted.set(vessel.key, this.gravity(vessel));
    this.state.tell("vessels");
  }

  /** A sound where a vessel has become graver; what is over is forgotten. */
  private look(): void {
    const known = new Set(this.state.vessels.map(({ key }) => key));
    for (const kept of [this.told, this.noted]) for (const key of kept.keys()) if (!known.has(key)) kept.delete(key);
    for (const key of this.inside) if (!known.has(key)) this.inside.delete(key);
    let loud: Gravity = "none";
    for (const vessel of this.state.vessels) {
      this.enter(vessel);
      const [now, was] = [this.gravity(vessel), this.told.get(vessel.key) ?? "none"];
      if (GRAVITY[now] > GRAVITY[was]) loud = graver(loud, now);
      this.told.set(vessel.key, now);
      if (GRAVITY[now] < GRAVITY[this.noted.get(vessel.key) ?? "none"]) this.noted.set(vessel.key, now);
    }
    if (this.state.replaying) return;
    if (loud === "danger") this.sound.alarm();
    else if (loud === "near") this.sound.warn();
  }

  private enter(vessel: Vessel): void {
    const far = Math.min(...this.state.boats.flatMap((boat) => position(boat) ?? []).map((place) => distance_m(place, vessel)));
    const most = this.zone_m * (this.inside.has(vessel.key) ? LEAVES : 1);
    if (this.zone_m && !vessel.lost && far < most) this.inside.add(vessel.key);
    else this.inside.delete(vessel.key);
  }
}
