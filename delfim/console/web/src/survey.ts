// Surveys: areas are drawn or loaded, and a form shows their lines on the map while it changes. The gateway makes the lines.
import Feature from "ol/Feature";
import { LineString, Point } from "ol/geom";
import VectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import { Fill, RegularShape, Stroke, Style } from "ol/style";
import { areasOf, corner, linesOf, ringsOf, square, withAreas, withHole } from "./area";
import type { Chart, Pixel } from "./chart";
import { point } from "./chart";
import type { Field } from "./form";
import { bearing, bearing_deg, duration, metres } from "./geo";
import type { Messages } from "./messages";
import { cornerPlace, understood } from "./mission";
import type { Answer, Net } from "./net";
import { cased, palette } from "./palette";
import type { Plans } from "./plans";
import type { Entry, Item, Popup } from "./popup";
import { chosen, sent } from "./sending";
import type { State } from "./state";
import { enteredSpeed_mps, inKnots, speedUnit } from "./units";
import type { Area, Boat, Heard, Mission, Place, Ring, Said } from "./wire";

type Told = Extract<Heard, { t: "survey" }>;
type Asked = Extract<Said, { t: "survey" }>;

const ASIDE: Pixel = [Infinity, 60]; // the form must not cover the area
const STARTS = ["", "nw", "ne", "se", "sw"] as const;
const SIDES = ["", "port", "starboard"] as const;
const BEGIN = [10, 0, 20, 0, 0, 0, 0, 0, 0, 0]; // of the form: spacing, swath, overlap, heading, cross lines, start, edges, side, run-in, speed
const HOLE = /^hole \d+$/; // a zone that a survey made
const CLOSE_PX = 14;
const RESTS_MS = 400; // a form that is not changed for so long gets the energy of its lines
const BOATS_MOST = 8;
const ENDINGS = ".geojson,.json,.kml,.gpx,.shp,.plan";

export class Survey {
  private readonly shown = new VectorSource({ useSpatialIndex: false });
  private drawing: Place[] | null = null; // corners of a ring so far
  private isHole = false;
  private pointer: Place | null = null;
  private told: Told | null = null;
  private beside: number | null = null; // where the form was when the map was fitted beside it, px
  private asked = ""; // what was asked last, and its answer
  private answer: Answer | null = null;
  private wanted: Asked | null = null; // while an answer is waited for: what is asked next
  private again = () => {};
  private rests = 0; // a timer

  constructor(
    private readonly chart: Chart,
    private readonly popup: Popup,
    private readonly state: State,
    private readonly plans: Plans,
    private readonly net: Net,
    private readonly messages: Messages,
    private readonly edit: (boat: number, mission: Mission) => void,
  ) {
    chart.add(new VectorLayer({ source: this.shown, updateWhileAnimating: true, updateWhileInteracting: true }), 6);
    state.on(["theme"], () => this.draw());
  }

  private get mission(): Mission {
    return this.state.plan(this.state.planning).mission;
  }

  private change(next: Mission): void {
    this.edit(this.state.planning, next);
  }

  menu(place: Place): Entry[] {
    const none = areasOf(this.mission).length ? undefined : "draw an area first, or load one";
    const side: Field = { title: "Side", unit: "m", value: 200, step: 10, least: 10, most: 5000 };
    const hole: Field = { ...side, value: 30, step: 5, least: 2 };
    return [
      { title: "Draw an area", note: "corner by corner", do: () => this.begin(false) },
      { title: "Area around here…", do: () => this.square("Area", side, place, (mission, ring) => withAreas(mission, [...areasOf(mission), [ring, []]])) },
      { title: "Load an area…", note: "GeoJSON, KML, GPX, Shapefile, .plan", do: () => chosen(ENDINGS, (file) => void this.load(file)) },
      "line",
      { title: "Draw a hole", note: "which the boat must not enter", refuse: none, do: () => this.begin(true) },
      { title: "Hole around here…", refuse: none, do: () => this.square("Hole", hole, place, (mission, ring) => withHole(mission, ring, place)) },
      "line",
      { title: "Lines…", refuse: none, do: () => this.form() },
      this.filling(),
      ...this.dividing(),
      { title: "Delete the areas", refuse: none, do: () => this.change(withAreas(this.mission, [])) },
    ];
  }

  private square(title: string, field: Field, place: Place, made: (mission: Mission, ring: Ring) => Mission): void {
    const before = this.mission;
    let next = before;
    const live = ([side]: number[]) => {
      this.plans.preview((next = made(before, square(place, side!))));
      return "drag its corners afterwards";
    };
    this.popup.form(ASIDE, title, [field], live, (ok) => {
      this.plans.preview(null);
      if (!ok) return;
      this.change(next);
      if (this.hasLines) this.form();
    });
  }

  // Corner by corner.

  get isDrawing(): boolean {
    return this.drawing !== null;
  }

  private begin(isHole: boolean): void {
    [this.drawing, this.isHole, this.plans.stand] = [[], isHole, true];
    this.messages.say(null, 6, `click the corners of the ${isHole ? "hole" : "area"}; the first one again, or Enter, closes it; Esc gives it up`);
  }

  /** A corner; the first one again closes the ring. */
  add(place: Place): void {
    if (!this.drawing) return;
    const [first, here] = [this.drawing[0] && this.chart.pixelOf(this.drawing[0]), this.chart.pixelOf(place)];
    if (first && here && this.drawing.length > 2 && Math.hypot(first[0] - here[0], first[1] - here[1]) < CLOSE_PX) return this.close();
    this.drawing.push(place);
    this.draw();
  }

  point(place: Place): void {
    this.pointer = place;
    this.draw();
  }

  close(): void {
    const corners = this.drawing ?? [];
    if (corners.length < 3) return;
    const ring = corners.map(corner);
    this.giveUp();
    this.change(this.isHole ? withHole(this.mission, ring, corners[0]!) : withAreas(this.mission, [...areasOf(this.mission), [ring, []]]));
    this.form(); // after a hole, too: lines that were made before would cross it
  }

  giveUp(): void {
    this.drawing = this.pointer = null;
    this.plans.stand = false;
    this.draw();
  }

  // From a file.

  /** Takes the areas of a file. Returns why it is refused, in words. */
  async load(file: File): Promise<string> {
    const told = await sent<{ areas: Area[] }>("area", file);
    if (!told.areas) {
      this.messages.say(null, 3, `area refused: ${told.refused}`);
      return told.refused ?? "";
    }
    const areas = joined(told.areas);
    this.change(withAreas(this.mission, [...areasOf(this.mission), ...areas]));
    this.chart.fit(areas.flatMap(([outline]) => outline.map(cornerPlace)), 250);
    this.form();
    return "";
  }

  // Lines.

  /** The form of the lines, with the lines on the map. */
  form(): void {
    const before = this.mission;
    const kept = before.survey?.values ?? [];
    const fields = formFields(kept.length === BEGIN.length ? kept : BEGIN);
    const here = this.from(this.state.boat);
    let values: number[] = [];
    const ask = (now: number[]) => ({ ...asked(before, (values = [...now])), ...here });
    this.shape("Survey lines", fields, before, ask, (told) => {
      const { across } = told;
      this.change(planned(before, told.mission, { areas: areasOf(before), values, lines: told.lines, across }));
    });
  }

  /** The entry of a menu that plans what is left. */
  filling(): Item {
    return { title: "Fill the gaps…", note: "lines of what is left", refuse: linesOf(this.mission).length ? undefined : "the plan has no lines", do: () => this.fill() };
  }

  get hasLines(): boolean {
    return linesOf(this.mission).length > 0;
  }

  /** The form of the lines that are left, by what this console heard: from where the boat is now. */
  fill(): void {
    const before = this.mission;
    const { left, speed_mps } = rest(before);
    const here = this.from(this.state.boat);
    const ask = ([speed]: number[]) => ({ ...left(speed!), ...here });
    this.shape("Fill the gaps", [speedField(speed_mps)], before, ask, (told) => this.change(planned(before, told.mission, known(before, told))));
  }

  /** The entry of a menu that divides what is left among several boats. */
  dividing(): Item[] {
    const note = "what is left, among those that go on";
    return this.hasLines && this.state.boats.length > 1 ? [{ title: "Divide among the boats…", note, do: () => this.divide() }] : [];
  }

  /** As `fill`, for several boats: each gets lines side by side, from where it is now, as its plan. */
  private divide(): void {
    const before = this.mission;
    const { left, speed_mps } = rest(before);
    const boats = this.state.boats.slice(0, BOATS_MOST);
    const fields = boats.map((each): Field => ({ title: each.name, unit: "", value: goesOn(each) ? 0 : 1, step: 1, least: 0, most: 1, zero: "takes part", show: () => "stays out" }));
    const places = new Map(boats.map((each) => [each, whereIs(each)] as const));
    let who: Boat[] = [];
    const ask = ([speed, ...out]: number[]) => {
      who = boats.filter((_, i) => !out[i]);
      const [first, ...others] = who;
      return first ? { ...left(speed!), at: places.get(first)!, boat: this.state.planning, others: others.map((each) => places.get(each)!) } : null;
    };
    this.shape("Divide among the boats", [speedField(speed_mps), ...fields], before, ask, (told) => {
      const shares = told.shares.length ? told.shares : [told];
      who.forEach(({ id }, i) => {
        const its = shares[i];
        const home = this.state.plan(id).mission.home;
        if (its) this.edit(id, planned({ ...before, home }, its.mission, known(before, told)));
      });
    }, () => who);
  }

  /** Where the boat is as the form opens: with each step of a boat that drifts the lines would be others, and never be there. */
  private from(boat: Boat | null) {
    return { at: boat && whereIs(boat), boat: this.state.planning };
  }

  /** A form that shows its lines on the map; OK makes them plans. `who`: the boats of its shares. */
  private shape(title: string, fields: Field[], before: Mission, ask: (values: number[]) => Asked | null, done: (told: Told) => void, who = (): Boat[] => []): void {
    const live = (values: number[]) => {
      const next = ask(values);
      if (!next) return { refuse: "no boat takes part" };
      this.ask(next);
      return this.words(before, who());
    };
    this.beside = null;
    this.plans.preview({ ...before, waypoints: [], path: [] });
    this.again = this.popup.form(ASIDE, title, fields, live, (ok) => {
      const { told } = this;
      clearTimeout(this.rests);
      [this.told, this.asked, this.wanted, this.again] = [null, "", null, () => {}];
      this.plans.preview(null);
      this.draw();
      if (ok && told) done(told);
    });
  }

  /** How many lines are on the map while they are planned. */
  get lines(): number {
    return this.told?.lines.length ?? 0;
  }

  take(told: Told): void {
    if (this.asked) this.told = told; // the form may be closed by now
  }

  private ask(next: Asked): void {
    const words = JSON.stringify(next);
    if (words === this.asked) return;
    if (this.asked && !this.answer) {
      this.wanted = next; // one question at a time
      return;
    }
    clearTimeout(this.rests);
    [this.asked, this.answer] = [words, null];
    void this.net.ask(next).then((answer) => {
      if (words !== this.asked) return; // the form is another one by now
      this.answer = answer;
      if (!answer.ok) this.told = null;
      const { wanted } = this;
      this.wanted = null;
      if (wanted) this.ask(wanted);
      else if (this.told) this.rests = window.setTimeout(() => void this.sail(next, words), RESTS_MS);
      this.draw();
      this.again();
      if (this.told && this.popup.covers.left !== this.beside) this.fit(this.told);
    });
  }

  /** Time and energy of these lines, as the simulated boat takes them for a few. */
  private async sail(next: Asked, words: string): Promise<void> {
    const { ok } = await this.net.ask({ ...next, sailed: true });
    if (ok && words === this.asked && !this.wanted) this.again();
  }

  /** Lines and areas beside the form, once it has its words and so its size, and again where it had to move. */
  private fit(told: Told): void {
    this.beside = this.popup.covers.left;
    this.chart.fitBeside([...surveyed(this.mission), ...told.way.map(cornerPlace)], this.popup.covers, document.getElementById("strips")!.offsetWidth);
  }

  private words(before: Mission, who: Boat[]) {
    const { answer, told, wanted } = this;
    if (!answer || wanted) return { refuse: "the lines are being made" };
    if (!answer.ok || !told) return { refuse: answer.reason };
    const [free, area] = told.covered.map((part) => `${(100 * part).toFixed(1)} %`);
    const left = free === area ? "" : `, which is ${area} of the area: ${told.room_m} m about holes and fences are left`;
    const old = before.waypoints.length ? `\nThey take the place of the plan’s ${before.waypoints.length} waypoints.` : "";
    const across = told.across ? `, ${told.across} across` : "";
    const shares = told.shares.map((its, i) => `\n${who[i]?.name}: ${its ? `${its.lines.length} lines, ${duration(its.time_s)}` : "no line is left for it"}`).join("");
    const filled = told.counts && `${told.counts} heard here. What was not heard, because a link was lost, is a gap.\n`;
    const rough = told.rough ? `\n${told.rough > 1 ? `${told.rough} lines begin` : "A line begins"} at a hole, without room to settle: up to 3 m off at first` : "";
    return (
      `${filled}${told.lines.length} lines${across}, ${metres(told.spacing_m)} apart, ${bearing(told.heading_deg)}\n` +
      `${metres(told.line_m)} of lines, ${metres(told.way_m)} in all, ${duration(told.time_s)}${this.energy(told)}\n` +
      `covered${filled && ", all together"}: ${free} of what may be sailed${left}${rough}${old}${shares}`
    );
  }

  private energy({ energy_wh }: Told): string {
    const left_wh = this.state.boat?.energy?.left_wh;
    return energy_wh === null ? "" : ` and ${energy_wh.toFixed(0)} Wh${left_wh == null ? "" : ` of the ${left_wh.toFixed(0)} Wh left`}`;
  }

  // On the map.

  private draw(): void {
    this.shown.clear();
    if (this.told && !this.drawing) this.shown.addFeatures(drawnLines(this.told));
    if (!this.drawing) return;
    const points = [...this.drawing, ...(this.pointer ? [this.pointer] : [])].map(point);
    const line = new Feature(new LineString(points));
    line.setStyle(cased(palette.survey, 2, [6, 5]));
    this.shown.addFeatures([...(points.length > 1 ? [line] : []), ...this.drawing.map((each) => handle(point(each)))]);
  }
}

/** The plan with these lines as its waypoints. Its fence, obstacles and home stay; holes of an earlier survey go. */
function planned(before: Mission, mission: Mission, survey: Mission["survey"]): Mission {
  const made = understood(mission);
  const zones = [...(before.zones ?? []).filter(({ name }) => !HOLE.test(name)), ...(made.zones ?? [])];
  const { patterns: _, ...rest } = before;
  const name = rest.name === "Mission" ? "Survey" : rest.name;
  return { ...rest, name, waypoints: made.waypoints, path: made.path ?? [], zones, ...(survey && { survey }) };
}

/** What is asked of the lines that are left, by the speed, and that of the survey. */
function rest(mission: Mission) {
  const { values: kept = [], across = 0, areas = [] } = mission.survey ?? {};
  const begin = kept.length === BEGIN.length ? kept : areas.length ? BEGIN : BEGIN.map(() => 0);
  const left = (speed: number): Asked => ({ ...asked(mission, begin.with(-1, speed)), lines: linesOf(mission), across });
  return { left, speed_mps: begin.at(-1)! };
}

const known = ({ survey }: Mission, told: Told) => ({ areas: survey?.areas ?? [], values: survey?.values ?? [], lines: told.known, across: told.known_across });

const whereIs = (boat: Boat) => (boat.latitude_deg == null ? null : corner(boat as Place));

/** Whether a boat takes part unless it is told otherwise: one that is heard, and neither on its way home nor there. */
const goesOn = ({ mode, reason, ghost, failsafe }: Boat): boolean => mode !== "home" && !reason.endsWith("home done") && !ghost && !failsafe;

function asked(mission: Mission, [spacing, swath, overlap, heading, cross, start, edges, side, run_in, speed]: number[]): Asked {
  return {
    t: "survey",
    boat: 0,
    areas: areasOf(mission),
    ...{ spacing_m: spacing!, swath_m: swath!, overlap_pct: overlap!, heading_deg: heading || null, cross_m: cross!, start: STARTS[start!]! },
    ...{ inside: edges === 1, side: SIDES[side!]!, run_in_m: run_in!, speed_mps: enteredSpeed_mps(speed!) },
    fence: mission.fence,
    obstacles: mission.obstacles,
    closed: (mission.zones ?? []).filter(({ kind, name, polygon }) => kind === "keep_out" && polygon.length && !HOLE.test(name)).map(({ polygon }) => polygon),
    name: mission.name,
  };
}

function formFields([spacing, swath, overlap, heading, cross, start, edges, side, run_in, speed]: number[]): Field[] {
  const m = (title: string, value: number, step: number, zero: string): Field => ({ title, unit: "m", value, step, least: 0, most: 1000, zero });
  const corners = ["anywhere", ...STARTS.slice(1).map((each) => each.toUpperCase())];
  const cornerIn = (words: string) => corners.findIndex((each) => each.toLowerCase() === words.trim().toLowerCase());
  return [
    m("Spacing", spacing!, 1, "by swath"),
    m("Swath", swath!, 1, "the spacing"),
    { title: "Overlap", unit: "%", value: overlap!, step: 5, least: 0, most: 90 },
    { title: "Along", unit: "°", value: heading!, step: 5, least: 0, most: 180, zero: "the quickest", show: bearing },
    m("Cross lines", cross!, 5, "none"),
    { title: "Begin", unit: "", value: start!, step: 1, least: 0, most: 4, show: (value) => corners[value]!, read: (words) => (cornerIn(words) < 0 ? null : cornerIn(words)), zero: corners[0]! },
    { title: "Cover", unit: "", value: edges!, step: 1, least: 0, most: 1, zero: "to the edge", show: () => "inside" },
    { title: "Looks", unit: "", value: side!, step: 1, least: 0, most: 2, zero: "to both sides", show: (value) => `to ${SIDES[value]}`, read: (words) => Math.max(0, SIDES.findIndex((each) => each && words.includes(each))) },
    m("Run-in", run_in!, 1, "its own"),
    speedField(speed!),
  ];
}

const speedField = (value: number): Field => ({ title: "Speed", unit: speedUnit(), value, step: 0.1, least: 0, most: inKnots ? 20 : 10, zero: "its own" });

/** Holes that a file has beside its outlines belong to the first area. */
function joined(areas: Area[]): Area[] {
  const loose = areas.filter(([outline]) => !outline.length).flatMap(([, holes]) => holes);
  return areas.filter(([outline]) => outline.length).map(([outline, holes], i) => [outline, i ? holes : [...holes, ...loose]]);
}

function drawnLines({ lines, across, way, done, shares }: Told): Feature[] {
  const ways = shares.length ? shares.flatMap((its) => (its ? [its.way] : [])) : [way];
  const thin = ways.map((its) => {
    const line = new Feature(new LineString(its.map((each) => point(cornerPlace(each)))));
    line.setStyle(cased(palette.draft, 1.1));
    return line;
  });
  const past = done.map((ends) => {
    const line = new Feature(new LineString(ends.map((each) => point(cornerPlace(each)))));
    line.setStyle(cased(palette.done, 3.2));
    return line;
  });
  return [...thin, ...past, ...lines.flatMap(([from, to], i) => directed(cornerPlace(from), cornerPlace(to), i < lines.length - across ? palette.survey : palette.steer))];
}

/** A line, its direction at its middle. */
export function directed(from: Place, to: Place, colour: string, width = 2.4): Feature[] {
  const [a, b] = [point(from), point(to)];
  const line = new Feature(new LineString([a, b]));
  line.setStyle(cased(colour, width));
  const arrow = new Feature(new Point([(a[0]! + b[0]!) / 2, (a[1]! + b[1]!) / 2]));
  const rotation = (bearing_deg(from, to) * Math.PI) / 180;
  arrow.setStyle(new Style({ image: new RegularShape({ points: 3, radius: 6.5, rotation, rotateWithView: true, scale: [0.75, 1], fill: new Fill({ color: colour }) }) }));
  return [line, arrow];
}

function handle(at: number[]): Feature {
  const mark = new Feature(new Point(at));
  mark.setStyle(new Style({ image: new RegularShape({ points: 4, angle: Math.PI / 4, radius: 7, fill: new Fill({ color: palette.handle }), stroke: new Stroke({ color: palette.survey, width: 2 }) }) }));
  return mark;
}

/** All corners of a plan's areas. */
export const surveyed = (mission: Mission): Place[] => ringsOf(mission).flatMap(({ corners }) => corners.map(cornerPlace));
