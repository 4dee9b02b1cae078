// The state of the page, in one place. Views subscribe to topics; only the operator changes the selection.
import { Plan, UNNAMED, alike, empty, same } from "./mission";
import type { Background, Boat, Heard, Mission, Vessel } from "./wire";

export type Topic = "boats" | "selection" | "plan" | "online" | "hello" | "missions" | "progress" | "dryrun" | "theme" | "vessels" | "forgotten";
type Hello = Extract<Heard, { t: "hello" }>;
export type DryRun = Extract<Heard, { t: "dryrun" }>;

export const NOBODY = 0; // stands for the boat of the plan that is made before one is heard

const SILENT_S = 0.7; // longer than between two showings at rest (calm.ts)
const FRESH_S = 1.5;
const OLD_S = 3.5;
const SAID_S = 2; // an older message is shown with its age
const BATTERY_FACTOR = 6; // it is sent every few seconds only

export class State {
  boats: Boat[] = [];
  at_s = 0;
  selected: number | null = null;
  online = false;
  hello: Hello | null = null;
  backgrounds: Background[] = [];
  operator = ""; // whose page this is, where operators have names
  names: string[] = [];
  progress = new Map<number, { what: string; part: number }>();
  dryruns = new Map<number, DryRun>();
  crossed = new Map<number, [number, number]>(); // where the chart forbids a plan
  readonly fetching = new Set<number>(); // boats whose mission is being read, to become the plan
  readonly plans = new Map<number, Plan>(); // NOBODY's before a boat is heard
  private readonly aboard = new Map<number, Mission>(); // as they were read from the boats
  private framedAt = 0;
  vessels: Vessel[] = []; // those that a boat meets first stand first
  private reported: number | null = null; // when any of them was heard last, by this page's clock
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

  /** The boat whose plan is edited. */
  get planning(): number {
    return this.selected ?? NOBODY;
  }

  /** Why there is nothing to command. */
  get nobody(): string {
    return `No boat heard on ${this.hello?.heard_on?.join(" or ") || "any link"} yet`;
  }

  /** Where the console looks for charts when it starts. */
  get chartFolder(): string {
    return `the folder ${this.hello?.charts ?? "charts"} of the console’s computer`;
  }

  get replaying(): boolean {
    return this.hello?.replay != null;
  }

  /** Whether another page of this console drives the boat by hand. */
  drivenElsewhere(boat: Boat): boolean {
    return boat.mode === "manual" && boat.driver > 0 && boat.driver !== this.hello?.page;
  }

  byId(id: number): Boat | undefined {
    return this.boats.find((each) => each.id === id);
  }

  /** Seconds since the gateway's last word about the boats. */
  get frameAge_s(): number {
    return this.framedAt ? (performance.now() - this.framedAt) / 1000 : Infinity;
  }

  /** Ages grow by this page's own clock then. */
  get nothingArrives(): boolean {
    return this.frameAge_s > SILENT_S;
  }

  /** A boat is never dropped from the list: one that the gateway no longer names keeps its last values. */
  takeBoats(boats: Boat[], at_s: number, came = performance.now()): void {
    const known = new Set(boats.map((each) => each.id));
    this.boats = [...boats, ...this.boats.filter((each) => !known.has(each.id))].sort((a, b) => a.id - b.id);
    this.at_s = at_s;
    this.framedAt = came;
    if (this.selected === null && this.boats.length) this.select(this.boats[0]!.id);
    this.tell("boats");
  }

  /** A silent boat that the operator no longer wants to see, until it is heard again. */
  forget(id: number): void {
    this.boats = this.boats.filter((each) => each.id !== id);
    for (const kept of [this.plans, this.aboard, this.progress, this.dryruns, this.crossed]) kept.delete(id);
    this.tell("forgotten");
    if (this.selected === id) this.select(this.boats[0]?.id ?? null);
    this.tell("boats");
  }

  takeVessels(vessels: Vessel[], heard_s: number | null): void {
    this.vessels = vessels;
    this.reported = heard_s === null ? null : performance.now() - 1000 * heard_s;
    this.tell("vessels");
  }

  /** Seconds since the last report of any other vessel; null: nobody was heard. */
  get heard_s(): number | null {
    return this.reported === null ? null : (performance.now() - this.reported) / 1000;
  }

  /** Gives this boat the plan that was made before a boat was heard. True if there was one. */
  inherit(id: number): boolean {
    const early = this.plans.get(NOBODY);
    this.plans.delete(NOBODY);
    if (!early?.undoable) return false;
    this.plan(id).change(early.mission);
    return true;
  }

  select(id: number | null): void {
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

  /** Takes the mission that a boat has aboard. If nobody has planned anything, it becomes the plan, too. */
  takeAboard(id: number, mission: Mission): void {
    this.aboard.set(id, mission);
    const plan = this.plan(id);
    if (plan.untouched || this.replaying) plan.mission = { ...mission, name: mission.name === UNNAMED ? "Mission" : mission.name };
    this.tell("plan");
  }

  /** The mission aboard, if it was read and has not changed since. */
  aboardOf(boat: Boat): Mission | null {
    return boat.mission.state === "unknown" ? null : (this.aboard.get(boat.id) ?? null);
  }

  /** Compares the plan on the screen with the mission aboard at once, before the gateway does. */
  compared(boat: Boat): Boat["mission"]["state"] {
    const aboard = this.aboardOf(boat);
    return aboard ? (alike(this.plan(boat.id).mission, aboard) ? "same" : "differs") : boat.mission.state;
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

/** The most urgent trouble, if any: a number used twice, failsafe, then the reason why the boat is not ready. */
export function trouble(boat: Boat): { words: string; grave: boolean } | null {
  if (boat.twins.length) return { words: `number ${boat.id} is used twice: ${boat.twins.join(" and ")}`, grave: true };
  if (boat.failsafe) return { words: boat.failsafe === boat.reason ? saidWords(boat) : boat.failsafe, grave: true };
  if (boat.forced) return { words: `${boat.mode === "idle" ? "stopped" : boat.mode}: ${boat.forced}`, grave: true };
  if (!boat.owner) return { words: inControl(boat), grave: false };
  if (!boat.ready) return { words: saidWords(boat) || "not ready", grave: false };
  return null;
}

/** A boat that is commanded by its own number is in the hands of its hand-set. */
function inControl({ id, commander }: Boat): string {
  return commander === id ? "the hand-set is in control" : `console ${commander} is in control`;
}

/** The boat says its reason once: add how long ago that was. */
function saidWords({ reason, reason_age_s: age }: Boat): string {
  return reason && age && age >= SAID_S ? `${reason} · ${ageWords(age)} ago` : reason;
}
