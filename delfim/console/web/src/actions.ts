// The operator's actions on a boat, by key or by menu. Every command names its boat.
import type { Drive, Thrusters } from "./drive";
import { spoken } from "./mission";
import type { Answer, Net } from "./net";
import type { State } from "./state";
import type { Boat, Mission, MissionDeed, Mode, Values } from "./wire";

const WANTED_MS = 2000; // for so long the page shows the value asked for; then the boat's own
const STOP_AGAIN_MS = 200;
const STOP_MOST = 150; // 30 s; then the gateway's own repetition and the boat's own failsafe remain

export type Say = (boat: number | null, severity: number, text: string) => void;

const REPLACED = "replaced by a newer command"; // of the operator's own

/** The text of a refusal. A boat names the refused command itself: "play refused: no mission loaded". */
function refusal(what: string, reason: string): string {
  return reason.includes(" refused: ") ? reason : `${what} refused: ${reason.replace(/^refused: /, "") || "no reason given"}`;
}

export class Actions {
  /** Boats that were told to stop and have not confirmed it. */
  readonly stopping = new Set<number>();
  /** The commands and the deeds of missions that somebody at this page has had done. */
  readonly did = new Set<string>();
  private readonly wantedMode = new Map<number, { mode: Mode; at: number }>();
  private readonly wanted_pct = new Map<number, { pct: number; at: number }>();
  private readonly wanted_deg = new Map<number, { deg: number; at: number }>();

  constructor(
    private readonly net: Net,
    private readonly state: State,
    private readonly drive: Drive,
    private readonly say: Say,
    private readonly changed: () => void,
  ) {
    state.on(["boats"], () => this.confirm());
  }

  async command(boat: number, command: string, more: Values = {}): Promise<Answer> {
    const answer = await this.net.ask({ t: "command", boat, command, ...more });
    if (answer.ok) this.did.add(String(more["mode"] ?? command));
    else if (answer.reason !== REPLACED) this.say(boat, 3, refusal(command.replace("_", " "), answer.reason));
    return answer;
  }

  async mode(boat: Boat, mode: Mode): Promise<void> {
    if (mode !== "idle") this.stopping.delete(boat.id); // a new order replaces the stop
    if (mode === "manual") this.drive.begin(boat.id);
    else this.drive.end(boat.id);
    this.wantedMode.set(boat.id, { mode, at: performance.now() });
    const answer = await this.command(boat.id, ...this.entering(boat, mode));
    if (answer.ok) return;
    this.wantedMode.delete(boat.id);
    if (mode === "manual") this.drive.end(boat.id);
  }

  /** The mode that was asked for and that the boat has not entered yet. */
  asked(boat: Boat): Mode | null {
    const wanted = this.wantedMode.get(boat.id);
    const mine = wanted && performance.now() - wanted.at < WANTED_MS ? wanted.mode : null;
    const asked = boat.asked ?? mine;
    return asked === boat.mode ? null : asked;
  }

  /** Stop one boat. The gateway repeats it until the boat answers; a stop that fails is sent again until the boat is idle. */
  stop(id: number): void {
    this.drive.end(id);
    void this.halt([id], id);
  }

  stopAll(): void {
    this.drive.endAll();
    void this.halt(
      this.state.boats.map((each) => each.id),
      "all",
    );
  }

  /** 0 to 80 %: of the thrust in manual, of the speed in the other modes. */
  speed(boat: Boat, which: Thrusters, pct: number): void {
    if (this.byHand(boat)) this.byPage(boat, () => this.drive.set(boat.id, which, pct));
    else if (which === "both") this.setSpeed(boat, pct);
    else this.oneOnly(boat);
  }

  faster(boat: Boat, which: Thrusters, by: number): void {
    if (this.byHand(boat)) this.byPage(boat, () => this.drive.faster(boat.id, which, by));
    else if (which === "both") this.setSpeed(boat, Math.max(0, Math.min(100, this.speed_pct(boat) + by)));
    else this.oneOnly(boat);
  }

  turn(boat: Boat, which: Thrusters, by: number): void {
    if (this.byHand(boat)) this.byPage(boat, () => this.drive.turn(boat.id, which, by));
    else if (which !== "both") this.oneOnly(boat);
    else if (this.inMode(boat, "heading") || this.inMode(boat, "course")) this.headTo(boat, (this.heading_deg(boat) + by + 360) % 360);
    else this.say(boat.id, 6, "Left and Right work in manual, heading and course mode only");
  }

  /** In course mode it is a course over ground. */
  headTo(boat: Boat, deg: number): void {
    this.wanted_deg.set(boat.id, { deg, at: performance.now() });
    if (this.inMode(boat, "course")) void this.command(boat.id, "course", { course_deg: deg });
    else void this.command(boat.id, "heading", { heading_deg: deg });
  }

  setSpeed(boat: Boat, speed_pct: number): void {
    this.wanted_pct.set(boat.id, { pct: speed_pct, at: performance.now() });
    void this.command(boat.id, "speed", { speed_pct });
  }

  /** The speed asked for, %, as far as this page knows it. */
  speed_pct(boat: Boat): number {
    const wanted = this.wanted_pct.get(boat.id);
    return wanted && performance.now() - wanted.at < WANTED_MS ? wanted.pct : Math.round(boat.speed_pct ?? 0);
  }

  heading_deg(boat: Boat): number {
    const wanted = this.wanted_deg.get(boat.id);
    if (wanted && performance.now() - wanted.at < WANTED_MS) return wanted.deg;
    const course = this.inMode(boat, "course") ? (boat.reference?.course_deg ?? boat.course_deg) : null;
    return Math.round(course ?? boat.reference?.heading_deg ?? boat.heading_deg ?? 0);
  }

  /** Ask the gateway to do something with a boat's plan; the plan is sent along where it is needed. */
  async mission(boat: number, deed: MissionDeed, name?: string): Promise<Answer> {
    const carries = deed !== "list" && deed !== "load" && deed !== "download";
    const more = { ...(carries ? { mission: spoken(this.state.plan(boat).mission) } : {}), ...(name === undefined ? {} : { name }) };
    const answer = await this.net.ask({ t: "mission", boat, do: deed, ...more });
    const what = deed === "put" ? "plan" : deed === "dryrun" ? "dry run" : deed;
    if (answer.ok) this.did.add(deed);
    else this.say(boat || null, 3, refusal(what, answer.reason));
    return answer;
  }

  /** What the energy lacks for the mission aboard, in words; "": nothing, or it is not known. The boat reckons it. */
  async lacks(boat: Boat): Promise<string> {
    if (boat.energy?.left_wh == null) return "";
    const { ok, reason } = await this.net.ask({ t: "afford", boat: boat.id });
    return !ok && reason.startsWith("takes ") ? reason : "";
  }

  /** Whether the boat would take a plan. Nobody is told but the caller. */
  check(boat: number, mission: Mission): Promise<Answer> {
    return this.net.ask({ t: "mission", boat, do: "check", mission: spoken(mission) });
  }

  /** Save a mission that is nobody's plan. */
  async keep(mission: Mission): Promise<void> {
    const answer = await this.net.ask({ t: "mission", boat: 0, do: "save", mission: spoken(mission), name: mission.name });
    if (answer.ok) this.say(null, 6, `saved: ${mission.name}. A console without --replay loads it`);
    else this.say(null, 3, refusal("save", answer.reason));
  }

  async profile(boat: number, profile: string): Promise<void> {
    const answer = await this.net.ask({ t: "profile", boat, profile });
    if (!answer.ok) this.say(boat, 4, refusal("link profile", answer.reason));
  }

  /** Take a silent boat off all pages, until it is heard again. */
  async forget(boat: number): Promise<void> {
    const answer = await this.net.ask({ t: "forget", boat });
    if (!answer.ok) this.say(boat, 4, refusal("forget", answer.reason));
  }

  /** Answered when they are here; the strip says how far it is. */
  async logs(boat: number, what: "state" | "all" | "end"): Promise<void> {
    const answer = await this.net.ask({ t: "logs", boat, do: what });
    if (!answer.ok) this.say(boat, 4, refusal("fetch logs", answer.reason));
  }

  /** Sends a chart of the console, or asks whether that is possible; returns why not. */
  async sendChart(boat: number, chart: string, what: "chart" | "unsent"): Promise<string> {
    const answer = await this.net.ask({ t: "logs", boat, do: what, chart });
    if (!answer.ok && what === "chart") this.say(boat, 4, refusal("send the chart", answer.reason));
    return answer.ok ? "" : answer.reason;
  }

  async note(boat: number, words: string, at_s: number): Promise<void> {
    const answer = await this.net.ask({ t: "note", boat, text: words, at_s });
    if (answer.ok) this.say(boat || null, 6, `noted: ${words}`);
    else this.say(boat || null, 4, refusal("note", answer.reason));
  }

  async forgetDepths(): Promise<void> {
    const answer = await this.net.ask({ t: "depths", do: "forget" });
    if (!answer.ok) this.say(null, 4, refusal("forget the depths", answer.reason));
  }

  replay(to: { at_s?: number; rate?: number }): void {
    void this.net.ask({ t: "replay", ...to });
  }

  /** The thrust set by hand, port and starboard, %. */
  thrust_pct(boat: Boat): [number, number] {
    const hand = this.drive.hand(boat.id);
    return hand ? [hand.port_pct, hand.starboard_pct] : [0, 0];
  }

  setThrust(boat: Boat, port_pct: number, starboard_pct: number): void {
    this.byPage(boat, () => this.drive.setBoth(boat.id, port_pct, starboard_pct));
  }

  byHand(boat: Boat): boolean {
    return this.inMode(boat, "manual");
  }

  /** Thrust is this page's to set, unless another page drives. */
  private byPage(boat: Boat, set: () => void): void {
    if (this.state.drivenElsewhere(boat) && !this.drive.hand(boat.id)) this.say(boat.id, 4, "driven from another page: press M here to take over");
    else set();
  }

  private inMode(boat: Boat, mode: Mode): boolean {
    return (this.asked(boat) ?? boat.mode) === mode || (mode === "manual" && this.drive.hand(boat.id) !== undefined);
  }

  /** The order for a mode: the present heading, the first waypoint, the whole mission, or a payload program. */
  private entering(boat: Boat, mode: Mode): [string, Values] {
    if (mode === "heading" && boat.heading_deg !== null) return [mode, { heading_deg: Math.round(boat.heading_deg) % 360 }];
    if (mode === "goto" || mode === "play") return [mode, {}];
    return mode.startsWith("payload ") ? ["payload", { name: mode.slice(8) }] : ["mode", { mode }];
  }

  private oneOnly(boat: Boat): void {
    this.say(boat.id, 6, "Alt and Ctrl work in manual mode only");
  }

  private async halt(ids: number[], boat: number | "all"): Promise<void> {
    for (const id of ids) {
      this.wantedMode.delete(id);
      this.stopping.add(id);
    }
    this.did.add("stop");
    this.changed();
    for (let left = STOP_MOST; left > 0 && ids.some((id) => this.stopping.has(id)); left--) {
      if ((await this.net.ask({ t: "command", boat, command: "stop" })).ok) return;
      await new Promise((resolve) => setTimeout(resolve, STOP_AGAIN_MS));
    }
  }

  /** Boats that say that they are idle are no longer stopping. */
  private confirm(): void {
    for (const id of this.stopping) if (this.state.byId(id)?.mode === "idle") this.stopping.delete(id);
    this.changed();
  }
}
