// What the page knows, in one place. Who shows something subscribes to a topic; only the operator changes the selection.
import { Plan, empty, same } from "./mission";
import type { Background, Boat, Heard, Mission } from "./wire";

export type Topic = "boats" | "selection" | "plan" | "online" | "hello" | "missions" | "progress" | "dryrun" | "theme";
type Hello = Extract<Heard, { t: "hello" }>;
export type DryRun = Extract<Heard, { t: "dryrun" }>;

const FRESH_S = 1.5;
const OLD_S = 3.5;
const BATTERY_FACTOR = 6; // it is told every few seconds only

export class State {
  boats: Boat[] = [];
  at_s = 0;
  selected: number | null = null;
  online = false;
  hello: Hello | null = null;
  backgrounds: Background[] = [];
  names: string[] = [];
  progress = new Map<number, { what: string; part: number }>();
  dryruns = new Map<number, DryRun>();
  readonly fetching = new Set<number>(); // boats whose mission was asked for, to become the plan
  readonly plans = new Map<number, Plan>();
  private framedAt = 0;
  private readonly listeners = new Map<Topic, (() => void)[]>();

  on(topics: Topic[], listener: () => void): void {
    for (const topic of topics) this.listeners.set(topic, [...(this.listeners.get(topic) ?? []), listener]);
  }

  tell(topic: Topic): void {
    for (const listener of this.listeners.get(topic) ?? []) listener();
  }

  get boat(): Boat | null {
    return this.boats.find((each) => each.id === this.selected) ?? null;
  }

  get replaying(): boolean {
    return this.hello?.replay != null;
  }

  byId(id: number): Boat | undefined {
    return this.boats.find((each) => each.id === id);
  }

  /** Seconds since the gateway's last word about the boats. */
  get frameAge_s(): number {
    return this.framedAt ? (performance.now() - this.framedAt) / 1000 : Infinity;
  }

  /** A boat is never dropped from the list: one that the gateway no longer names stays with what was known. */
  takeBoats(boats: Boat[], at_s: number): void {
    const known = new Set(boats.map((each) => each.id));
    this.boats = [...boats, ...this.boats.filter((each) => !known.has(each.id))].sort((a, b) => a.id - b.id);
    this.at_s = at_s;
    this.framedAt = performance.now();
    if (this.selected === null && this.boats.length) this.select(this.boats[0]!.id);
    this.tell("boats");
  }

  select(id: number): void {
    this.selected = id;
    this.tell("selection");
  }

  plan(id: number): Plan {
    let plan = this.plans.get(id);
    if (!plan) this.plans.set(id, (plan = new Plan(empty("Mission"))));
    return plan;
  }

  takeMission(id: number, mission: Mission): void {
    const plan = this.plan(id);
    if (same(plan.mission, mission)) return;
    plan.change(mission);
    this.tell("plan");
  }
}

/** The age of a group of a boat's data, seconds, counting on while nothing comes. */
export function age_s(state: State, boat: Boat, group: keyof Boat["age_s"] = "heard"): number {
  const age = boat.age_s[group];
  return age === null ? Infinity : age + Math.max(0, state.frameAge_s - 0.2);
}

export type Freshness = "fresh" | "late" | "lost";

export function freshness(age: number, group: keyof Boat["age_s"] = "heard"): Freshness {
  const its = group === "battery" ? age / BATTERY_FACTOR : age;
  return its <= FRESH_S ? "fresh" : its <= OLD_S ? "late" : "lost";
}

export function ageWords(age: number): string {
  if (!Number.isFinite(age)) return "never";
  if (age < 10) return `${age.toFixed(1)} s`;
  if (age < 100) return `${age.toFixed(0)} s`;
  return age < 6000 ? `${Math.floor(age / 60)} min` : `${Math.floor(age / 3600)} h`;
}

/** What a person should look at first, if anything: failsafe, then why the boat is not ready. */
export function trouble(boat: Boat): { words: string; grave: boolean } | null {
  if (boat.failsafe) return { words: boat.failsafe, grave: true };
  if (!boat.owner) return { words: "another console is in control", grave: false };
  if (!boat.ready) return { words: boat.reason || "not ready", grave: false };
  return null;
}
