// The menus and forms of a plan: the mission as a whole, its waypoints, patterns, fence, obstacles and home, and how it gets aboard.
import type { Actions } from "./actions";
import * as A from "./area";
import type { Chart, Pixel } from "./chart";
import type { Field } from "./form";
import { bearing, bearing_deg, degreesIn, distance_m, duration, metres, position } from "./geo";
import type { Messages } from "./messages";
import * as M from "./mission";
import { KINDS, newPattern, patternAt, withPattern } from "./patterns";
import type { Found } from "./patterns";
import type { PlanFiles } from "./planfiles";
import type { Handle, Plans } from "./plans";
import type { Entry, Item, Popup } from "./popup";
import type { Survey } from "./survey";
import { NOBODY } from "./state";
import type { State } from "./state";
import { enteredSpeed_mps, inKnots, shownSpeed, speedUnit, speedWords } from "./units";
import type { Boat, Mission, Mode, Pattern, Place, Waypoint } from "./wire";

const AMONG_MISSION: ReadonlySet<Mode> = new Set(["play", "path", "goto"]); // modes that sail the mission aboard
export const HOLDS_THERE = "then hold: thrusters start again; or idle, if its file says so"; // control.goto.end
const NO_BOAT = "no boat has been heard";
/** Stands for the boat while none is heard, so that a mission can be planned. */
export const NONE: Boat = {
  ...{ id: NOBODY, name: "", colour: "", latitude_deg: null, longitude_deg: null, heading_deg: null, course_deg: null, speed_mps: null },
  ...{ mode: null, asked: null, modes: [], armed: false, owner: true, commander: 0, twins: [], ready: false, reason: "", failsafe: "", rpm: [null, null], thrust_pct: [null, null] },
  ...{ speed_pct: null, battery_v: null, battery_pct: null, roll_deg: null, pitch_deg: null, satellites: null, fix: null, reference: null },
  ...{ home: null, fence: [], obstacles: [], ghost: null, released: false, driver: 0 },
  age_s: { heard: null, position: null, attitude: null, rpm: null, battery: null },
  link: { kind: "", profile: "", rtt_ms: null, loss_pct: null, bytes_per_s: null, signed: false },
  mission: { name: "", count: 0, current: null, state: "none", digest: null },
};
const ASIDE: Pixel = [Infinity, 60]; // a form that changes the plan must not cover it

export class Planning {
  constructor(
    private readonly popup: Popup,
    private readonly state: State,
    private readonly actions: Actions,
    private readonly chart: Chart,
    private readonly plans: Plans,
    private readonly messages: Messages,
    private readonly edit: (boat: number, mission: Mission) => void,
    private readonly undo: () => void,
    private readonly survey: Survey,
    private readonly files: PlanFiles,
  ) {}

  /** Enter a mode. If it sails the mission aboard and the plan on the screen differs, the operator is asked which one. */
  sail(boat: Boat, mode: Mode, from?: number): void {
    const order = () => {
      if (from === undefined) void this.actions.mode(boat, mode);
      else if (mode === "path") void this.actions.command(boat.id, "mode", { mode, piece: from });
      else void this.actions.command(boat.id, "play", { leg: from });
    };
    const begin = () => (mode === "play" || mode === "path" ? void this.afford(boat, order) : order());
    const plan = this.state.plan(boat.id).mission;
    const compared = this.state.compared(boat);
    if (!AMONG_MISSION.has(mode) || !plan.waypoints.length || compared === "same") return begin();
    const verb = mode === "play" ? "play it" : mode === "path" ? "follow it" : "go to its waypoint 1";
    const { name, count } = boat.mission;
    const other = compared === "none" || !count ? "no mission is aboard" : from !== undefined && "its waypoints differ from the plan’s";
    const goesOn = isSailing(boat) && boat.mode === mode && from === undefined;
    this.popup.menu(this.chart.middle()[1], { title: boat.name, colour: boat.colour, note: "The plan is not aboard" }, [
      ...(goesOn ? [{ title: "Send changes", note: "what is ahead; the boat sails on", do: () => void this.send(boat) }] : []),
      {
        title: `${isSailing(boat) ? "Hold, send" : "Send"} the plan, then ${verb}`,
        note: `${plan.name} · ${A.counted(plan)}, the dashed line`,
        do: () => void this.replace(boat).then((well) => well && begin()),
      },
      {
        title: "Sail the mission aboard instead",
        ...(compared === "unknown" ? { note: "it has not been read yet" } : { note: `${name === M.UNNAMED ? "" : `${name} · `}${count} waypoints, the solid line` }),
        refuse: compared !== "unknown" && other,
        do: begin,
      },
      { title: "Cancel" },
    ]);
  }

  /** A mission that takes more energy than is left is asked about, with its figure. */
  private async afford(boat: Boat, order: () => void): Promise<void> {
    const lacks = await this.actions.lacks(boat);
    if (!lacks) return order();
    this.popup.menu(this.chart.middle()[1], { title: boat.name, colour: boat.colour, note: `the ${A.named(this.state.plan(boat.id).mission)} ${lacks}` }, [
      { title: "Sail it all the same", note: "until it must go home", do: order },
      { title: "Cancel" },
    ]);
  }

  /** The boat holds its position while the mission that it sails is replaced. */
  private async replace(boat: Boat): Promise<boolean> {
    return (!isSailing(boat) || (await this.actions.command(boat.id, "mode", { mode: "hold" })).ok) && (await this.send(boat));
  }

  private async send(boat: Boat): Promise<boolean> {
    return (await this.actions.mission(boat.id, "upload")).ok;
  }

  /** The menu of a handle. False if it has none of its own. */
  handle(handle: Handle, at: Pixel): boolean {
    const boat = this.state.boat ?? NONE;
    if (handle.kind === "waypoint") this.waypoint(boat, handle.index, at);
    else if (handle.kind === "obstacle") this.obstacle(boat, handle.index, at);
    else if (handle.kind === "corner") this.corner(boat, handle.index, at);
    else if (handle.kind === "area") this.areaCorner(boat, handle.ring!, handle.index, at);
    else if (handle.kind === "home") this.home(boat, at);
    else return false;
    return true;
  }

  /** A waypoint at the end of the plan. */
  add(place: Place): void {
    this.change(this.state.boat ?? NONE, (each) => M.insertWaypoint(each, each.waypoints.length, place));
  }

  private change(boat: Boat, change: (mission: Mission) => Mission): void {
    this.edit(boat.id, change(this.state.plan(boat.id).mission));
  }

  /** A form that shows its numbers on the map at once; OK puts them into the plan. */
  private shape(boat: Boat, title: string, fields: Field[], made: (mission: Mission, values: number[]) => Mission): void {
    const before = this.state.plan(boat.id).mission;
    let next = before;
    const live = (values: number[]) => {
      const wanted = made(before, values);
      const count = wanted.waypoints.length;
      if (count > M.WAYPOINTS_MOST) return { refuse: `${count} waypoints: a mission has ${M.WAYPOINTS_MOST} at most` };
      this.plans.preview((next = wanted));
      return `${count} waypoints · ${metres(M.length_m(next))}`;
    };
    this.popup.form(ASIDE, title, fields, live, (ok) => {
      this.plans.preview(null);
      if (ok) this.edit(boat.id, next);
    });
  }

  mission(boat: Boat): Entry[] {
    const { mission, undoable } = this.state.plan(boat.id);
    const none = mission.waypoints.length ? undefined : "the plan has no waypoints";
    const nobody = boat.id === NOBODY ? NO_BOAT : undefined;
    const others = this.state.boats.filter((each) => each.id !== boat.id);
    return [
      { title: `Send ${isSailing(boat) ? "changes" : "to the boat"}`, note: this.compared(boat), refuse: nobody ?? none, do: () => void this.send(boat) },
      { title: "Read from the boat", refuse: nobody, do: () => this.fetch(boat) },
      { title: "Dry run", refuse: none, note: "in the simulator: time and distance", do: () => void this.dryRun(boat) },
      "line",
      { title: "Save", note: mission.name, refuse: none, do: () => this.save(boat, mission.name) },
      { title: "Save under a new name…", refuse: none, do: () => this.saveAs(boat) },
      { title: "Load", sub: () => this.stored(boat) },
      { title: "Files of other programs", sub: () => this.files.menu() },
      "line",
      { title: "Undo", key: "Ctrl Z", refuse: undoable ? undefined : "nothing to undo", do: this.undo },
      { title: "All waypoints…", refuse: none, do: () => this.allForm(boat) },
      { title: "Reverse the order", refuse: none, do: () => this.change(boat, (each) => ({ ...each, waypoints: reversed(each.waypoints) })) },
      { title: "Copy to another boat", refuse: others.length ? undefined : "there is no other boat", sub: () => others.map((other) => this.copy(boat, other)) },
      { title: "New mission", note: "empty; undo brings this one back", do: () => this.edit(boat.id, M.empty(newName("Mission", this.state.names))) },
    ];
  }

  private fetch(boat: Boat): void {
    this.state.fetching.add(boat.id);
    void this.actions.mission(boat.id, "download").then((answer) => !answer.ok && this.state.fetching.delete(boat.id));
  }

  private compared(boat: Boat): string {
    const words = { same: "the boat has this plan", differs: "the boat has another mission", unknown: "the boat’s mission is not known", none: "no mission aboard" };
    const compared = this.state.compared(boat);
    return boat.id === NOBODY ? "" : words[compared === "differs" && !boat.mission.count ? "none" : compared];
  }

  private copy(from: Boat, to: Boat): Item {
    return { title: to.name, colour: to.colour, do: () => this.edit(to.id, this.state.plan(from.id).mission) };
  }

  private stored(boat: Boat): Entry[] {
    const { names } = this.state;
    if (!names.length) return [{ title: "No mission is stored", refuse: "save one first" }];
    return names.map((name) => ({ title: name, do: () => void this.actions.mission(boat.id, "load", name) }));
  }

  private saveAs(boat: Boat): void {
    const { names } = this.state;
    this.popup.name("Save under a new name", newName(this.state.plan(boat.id).mission.name, names), (name) => this.replaces(name), (name) => this.save(boat, name));
  }

  /** What a recorded boat had aboard and where it sailed, as missions to load elsewhere. */
  recorded(boat: Boat, track: Place[]): Entry[] {
    const { mission } = this.state.plan(boat.id);
    const copy = (title: string, copied: () => Mission, refuse: string | false): Item => ({
      title,
      refuse,
      do: () => this.popup.name("Save as a mission", newName(boat.name, this.state.names), (name) => this.replaces(name), (name) => void this.actions.keep({ ...copied(), name })),
    });
    return [
      copy("Copy its mission…", () => mission, !mission.waypoints.length && "no mission is known at this time"),
      copy("Copy its track as a mission…", () => ({ ...M.empty(""), waypoints: M.retraced(track) }), track.length < 2 && "no track is recorded"),
      "line",
    ];
  }

  private replaces(name: string): string {
    return this.state.names.includes(name) ? "A mission of this name exists: Save replaces it." : "";
  }

  private save(boat: Boat, name: string): void {
    if (name !== this.state.plan(boat.id).mission.name) this.change(boat, (mission) => ({ ...mission, name }));
    void this.actions.mission(boat.id, "save", name).then((answer) => {
      const without = this.state.plan(boat.id).mission.home ? "; its home is not in the file" : "";
      if (answer.ok) this.messages.say(boat.id || null, 6, `saved: ${name}${without}`);
      void this.actions.mission(boat.id, "list");
    });
  }

  /** A day's mission takes a minute or more: what its length says is told meanwhile. */
  private async dryRun(boat: Boat): Promise<void> {
    const { reason } = await this.actions.check(boat.id, this.state.plan(boat.id).mission);
    const about = /^about [^;]+/.exec(reason)?.[0];
    this.messages.say(boat.id || null, 6, `dry run under way${about ? `; ${about} by length and speed` : ""}`);
    void this.actions.mission(boat.id, "dryrun");
  }

  private allForm(boat: Boat): void {
    const first = this.state.plan(boat.id).mission.waypoints[0]!;
    this.shape(boat, "All waypoints", [speedField(first.speed_mps), acceptanceField(first.acceptance_m)], (mission, [speed, acceptance]) =>
      M.setAll(mission, { speed_mps: enteredSpeed_mps(speed!), acceptance_m: acceptance! }),
    );
  }

  here(boat: Boat, place: Place): Entry[] {
    const { mission, undoable } = this.state.plan(boat.id);
    const best = M.bestIndex(mission, place);
    const size = mission.waypoints.length;
    const insert = (index: number) => () => this.change(boat, (each) => M.insertWaypoint(each, index, place));
    const go: Entry[] = [{ title: `Send ${boat.name} here`, colour: boat.colour, note: HOLDS_THERE, do: () => void this.actions.command(boat.id, "goto", { ...place }) }, "line"];
    const entries: Entry[] = [
      ...(boat.id === NOBODY ? [] : go),
      { title: "Add waypoint", note: size ? `as the last, number ${size + 1}` : "the first", do: insert(size) },
    ];
    if (best < size) entries.push({ title: "Insert waypoint", note: `between ${best} and ${best + 1}`, do: insert(best) });
    entries.push(
      { title: "Survey", sub: () => this.survey.menu(place) },
      { title: "Pattern", sub: () => this.patterns(boat, place) },
      { title: "Fence, obstacle, home", sub: () => this.marks(boat, place) },
      { title: "Mission", sub: () => this.mission(boat) },
    );
    if (undoable) entries.push({ title: "Undo", key: "Ctrl Z", do: this.undo });
    return [...entries, "line"];
  }

  private patterns(boat: Boat, place: Place): Entry[] {
    const from_deg = boat.latitude_deg === null ? 0 : bearing_deg(place, boat as Place);
    const kinds = Object.keys(KINDS) as Pattern["kind"][];
    return kinds.map((kind) => ({ title: `${KINDS[kind].title}…`, do: () => this.patternForm(boat, newPattern(kind, place, from_deg, this.state.plan(boat.id).mission)) }));
  }

  private patternForm(boat: Boat, pattern: Pattern, instead?: Found): void {
    const { title, fields } = KINDS[pattern.kind];
    this.shape(boat, title, [...fields(pattern.values), ...placeFields(pattern.centre)], (mission, numbers) =>
      withPattern(mission, { ...pattern, values: numbers.slice(0, -2), centre: placeIn(numbers) }, instead),
    );
  }

  private marks(boat: Boat, place: Place): Entry[] {
    const { mission } = this.state.plan(boat.id);
    const fence: Item = mission.fence.length
      ? { title: "Fence corner here", do: () => this.change(boat, (each) => M.insertCorner(each, place)) }
      : {
          title: "Fence around here…",
          do: () =>
            this.shape(boat, "Fence", [{ title: "Side", unit: "m", value: 200, step: 10, least: 20, most: 5000 }], (each, [side]) =>
              M.squareFence(each, place, side!),
            ),
        };
    return [
      fence,
      { title: "Obstacle here…", do: () => this.obstacleForm(boat, mission.obstacles.length, place, 10) },
      { title: "Set home here", do: () => this.change(boat, (each) => ({ ...each, home: { ...place } })) },
    ];
  }

  private waypoint(boat: Boat, index: number, at: Pixel): void {
    const { mission } = this.state.plan(boat.id);
    const [its, last] = [mission.waypoints[index]!, mission.waypoints.length - 1];
    const before = mission.waypoints[index - 1];
    const found = patternAt(mission, index);
    const middle = (a: Place, b: Place): Place => ({ latitude_deg: (a.latitude_deg + b.latitude_deg) / 2, longitude_deg: (a.longitude_deg + b.longitude_deg) / 2 });
    const shift = (by: -1 | 1, refuse: boolean): Item => ({
      title: by < 0 ? "Earlier in the order" : "Later in the order",
      refuse: refuse ? (by < 0 ? "it is the first" : "it is the last") : undefined,
      do: () => this.change(boat, (each) => M.reorderWaypoint(each, index, by)),
    });
    const note = before ? `${bearing(bearing_deg(before, its))}  ${metres(distance_m(before, its))}` : position(its);
    this.popup.menu(at, { title: `Waypoint ${index + 1}`, colour: boat.colour, note }, [
      { title: "Speed, acceptance, stay…", note: waypointWords(its), do: () => this.waypointForm(boat, index) },
      { title: "Sample, action…", note: stationWords(its, boat.stations?.[index + 1]?.words), do: () => this.stationForm(boat, index) },
      this.position(boat, `Waypoint ${index + 1}`, its, (each, to) => M.moveWaypoint(each, index, to)),
      ...(A.areasOf(mission).length && mission.survey!.values.length ? [{ title: "Change the survey…", note: "its lines anew", do: () => this.survey.form() }] : []),
      ...(this.survey.hasLines ? [this.survey.filling()] : []),
      ...(found ? [{ title: `Change the ${KINDS[found.pattern.kind].title.toLowerCase()}…`, note: `waypoints ${found.first + 1} to ${found.first + found.count}`, do: () => this.patternForm(boat, found.pattern, found) }] : []),
      { title: "Leg to it", refuse: before ? undefined : "it is the first", note: "as path following sails it", sub: () => this.legs(boat, index) },
      "line",
      { title: "Insert before", refuse: before ? undefined : "it is the first", do: () => this.change(boat, (each) => M.insertWaypoint(each, index, middle(before!, its))) },
      {
        title: "Insert after",
        refuse: index < last ? undefined : "it is the last",
        do: () => this.change(boat, (each) => M.insertWaypoint(each, index + 1, middle(its, each.waypoints[index + 1]!))),
      },
      shift(-1, index === 0),
      shift(1, index === last),
      { title: "Delete", do: () => this.change(boat, (each) => M.deleteWaypoint(each, index)) },
      "line",
      { title: "Play from here", refuse: boat.id === NOBODY && NO_BOAT, do: () => this.sail(boat, "play", index) },
      { title: "Follow the path from here", refuse: this.noPiece(boat, index), do: () => this.sail(boat, "path", index) },
      { title: "Go to this point", note: HOLDS_THERE, refuse: boat.id === NOBODY && NO_BOAT, do: () => void this.actions.command(boat.id, "goto", { latitude_deg: its.latitude_deg, longitude_deg: its.longitude_deg }) },
    ]);
  }

  /** Why no piece of the path begins at a waypoint. */
  private noPiece(boat: Boat, index: number): string | false {
    const { path, waypoints } = this.state.plan(boat.id).mission;
    if (boat.id === NOBODY) return NO_BOAT;
    if (path?.length) return "the mission has a path of its own";
    return index === waypoints.length - 1 && "the path ends here";
  }

  /** Where something is, as numbers. */
  private position(boat: Boat, title: string, its: Place, moved: (mission: Mission, to: Place) => Mission): Item {
    return { title: "Position…", note: position(its), do: () => this.shape(boat, title, placeFields(its), (mission, numbers) => moved(mission, placeIn(numbers))) };
  }

  private legs(boat: Boat, index: number): Entry[] {
    const turn = this.state.plan(boat.id).mission.waypoints[index]!.turn;
    return [
      { title: "Straight", tick: !turn, do: () => this.change(boat, (each) => M.setWaypoint(each, index, { turn: null })) },
      { title: "Half circle to starboard", tick: turn?.clockwise === true, do: () => this.change(boat, (each) => M.halfCircle(each, index, true)) },
      { title: "Half circle to port", tick: turn?.clockwise === false, do: () => this.change(boat, (each) => M.halfCircle(each, index, false)) },
    ];
  }

  private waypointForm(boat: Boat, index: number): void {
    const its = this.state.plan(boat.id).mission.waypoints[index]!;
    const fields = [speedField(its.speed_mps), acceptanceField(its.acceptance_m), stayField(its.hold_s)];
    this.shape(boat, `Waypoint ${index + 1}`, fields, (mission, [speed, acceptance, stay]) =>
      M.setWaypoint(mission, index, { speed_mps: enteredSpeed_mps(speed!), acceptance_m: acceptance!, hold_s: stay! }),
    );
  }

  /** A station: play waits there for a payload program's answer. */
  private stationForm(boat: Boat, index: number): void {
    const { hold_s, tries = 0, actions: [action, ...more] = [] } = this.state.plan(boat.id).mission.waypoints[index]!;
    const fields: Field[] = [
      { title: "Sample tries", unit: "", value: tries, step: 1, least: 0, most: 9, zero: "none" },
      { title: "Each waits", unit: "s", value: tries ? hold_s : hold_s || 60, step: 10, least: 1, most: 86400 },
      { title: "Then action", unit: "", value: action?.command ?? 0, step: 1, least: 0, most: 65535, zero: "none", show: actionWords },
      ...[0, 1, 2, 3].map((i): Field => ({ title: `number ${i + 1}`, unit: "", value: Number(action?.params[i] ?? 0) || 0, step: 1, least: -1e6, most: 1e6 })),
    ];
    this.shape(boat, `Waypoint ${index + 1}`, fields, (mission, [tries, wait, command, ...params]) =>
      M.setWaypoint(mission, index, { tries: tries!, hold_s: tries ? wait! : hold_s, actions: command ? [{ ...action, command, params }, ...more] : more }),
    );
  }

  private obstacle(boat: Boat, index: number, at: Pixel): void {
    const its = this.state.plan(boat.id).mission.obstacles[index]!;
    this.popup.menu(at, { title: "Obstacle", note: `radius ${metres(its.radius_m)}` }, [
      { title: "Radius…", do: () => this.obstacleForm(boat, index, its, its.radius_m) },
      this.position(boat, "Obstacle", its, (each, to) => M.setObstacle(each, index, { ...to, radius_m: its.radius_m })),
      { title: "Delete", do: () => this.change(boat, (each) => M.deleteObstacle(each, index)) },
    ]);
  }

  private obstacleForm(boat: Boat, index: number, place: Place, radius_m: number): void {
    const field: Field = { title: "Radius", unit: "m", value: radius_m, step: 1, least: 1, most: 1000 };
    this.shape(boat, "Obstacle", [field], (mission, [radius]) =>
      M.setObstacle(mission, index, { latitude_deg: place.latitude_deg, longitude_deg: place.longitude_deg, radius_m: radius! }),
    );
  }

  private corner(boat: Boat, index: number, at: Pixel): void {
    const its = M.cornerPlace(this.state.plan(boat.id).mission.fence[index]!);
    this.popup.menu(at, { title: `Fence corner ${index + 1}` }, [
      this.position(boat, `Fence corner ${index + 1}`, its, (each, to) => M.moveCorner(each, index, to)),
      { title: "Delete the corner", do: () => this.change(boat, (each) => M.deleteCorner(each, index)) },
      { title: "Delete the fence", do: () => this.change(boat, (each) => ({ ...each, fence: [] })) },
    ]);
  }

  private areaCorner(boat: Boat, ring: number, index: number, at: Pixel): void {
    const { corners, hole } = A.ringsOf(this.state.plan(boat.id).mission)[ring]!;
    const its = M.cornerPlace(corners[index]!);
    const words = hole < 0 ? "area" : "hole";
    this.popup.menu(at, { title: `Corner ${index + 1} of the ${words}` }, [
      { title: "Lines…", do: () => this.survey.form() },
      ...(this.survey.hasLines ? [this.survey.filling()] : []),
      this.position(boat, `Corner ${index + 1}`, its, (each, to) => A.moveRingCorner(each, ring, index, to)),
      { title: "Delete the corner", do: () => this.change(boat, (each) => A.deleteRingCorner(each, ring, index)) },
      { title: `Delete the ${words}`, do: () => this.change(boat, (each) => A.deleteRing(each, ring)) },
    ]);
  }

  private home(boat: Boat, at: Pixel): void {
    const its = this.state.plan(boat.id).mission.home!;
    this.popup.menu(at, { title: "Home", colour: boat.colour }, [
      { title: "Go home", do: () => void this.actions.mode(boat, "home") },
      this.position(boat, "Home", its, (each, home) => ({ ...each, home })),
      { title: "Delete", do: () => this.change(boat, (each) => ({ ...each, home: null })) },
    ]);
  }
}

const degreesField = (title: string, value: number, letters: string, most: number): Field => ({
  ...{ title, unit: "°", value, step: 1e-5, least: -most, most },
  show: (deg) => `${deg.toFixed(6)}°`,
  read: (words) => degreesIn(words, letters),
});
const placeFields = ({ latitude_deg, longitude_deg }: Place): Field[] => [degreesField("Latitude", latitude_deg, "NS", 89), degreesField("Longitude", longitude_deg, "EW", 180)];
const placeIn = (numbers: number[]): Place => ({ latitude_deg: numbers.at(-2)!, longitude_deg: numbers.at(-1)! });
export const isSailing = ({ mode }: Boat): boolean => mode === "play" || mode === "path";
const speedField = (value: number): Field => ({ title: "Speed", unit: speedUnit(), value: shownSpeed(value), step: 0.1, least: 0, most: inKnots ? 20 : 10, zero: "the boat’s own" });
const acceptanceField = (value: number): Field => ({ title: "Acceptance", unit: "m", value, step: 0.5, least: 0, most: 100, zero: "the boat’s own" });
const stayField = (value: number): Field => ({ title: "Stay", unit: "s", value, step: 10, least: 0, most: 86400, zero: "go on at once" });

function waypointWords({ speed_mps, acceptance_m, hold_s }: Waypoint): string {
  const words = [speed_mps && speedWords(speed_mps), acceptance_m && `within ${metres(acceptance_m)}`, hold_s && `stay ${duration(hold_s)}`];
  return words.filter(Boolean).join(" · ") || "as the boat’s file says";
}

const ACTIONS: Record<number, string> = { 181: "relay", 183: "servo", 203: "picture", 206: "pictures, each m", 211: "gripper", 42600: "winch" };
const actionWords = (command: number): string => (ACTIONS[command] ? `${command} ${ACTIONS[command]}` : String(command));

function stationWords({ tries, hold_s, actions: [action] = [] }: Waypoint, told?: string): string {
  const words = [tries && `${tries} ${tries > 1 ? "tries" : "try"} of ${duration(hold_s)}`, action && `action ${actionWords(action.command)}`, told];
  return words.filter(Boolean).join(" · ") || "none";
}

function reversed(waypoints: Waypoint[]): Waypoint[] {
  const turns = waypoints.slice(1).map(({ turn }) => turn && { ...turn, clockwise: !turn.clockwise });
  return waypoints.toReversed().map((each, i) => ({ ...each, turn: i ? turns.at(-i)! : null }));
}

/** "Survey", "Survey 2", "Survey 3" … */
function newName(name: string, taken: string[]): string {
  const stem = name.replace(/ \d+$/, "");
  let number = 2;
  while (taken.includes(`${stem} ${number}`)) number++;
  return taken.includes(stem) || stem === name ? `${stem} ${number}` : stem;
}
