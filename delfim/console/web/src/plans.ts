// The plans on the map: waypoints, legs, fence, obstacles, and the handles by which one pointing button moves them.
import Feature from "ol/Feature";
import type MapBrowserEvent from "ol/MapBrowserEvent";
import { LineString, Point, Polygon } from "ol/geom";
import PointerInteraction from "ol/interaction/Pointer";
import VectorLayer from "ol/layer/Vector";
import VectorImageLayer from "ol/layer/VectorImage";
import VectorSource from "ol/source/Vector";
import { Circle as Disc, Fill, RegularShape, Stroke, Style, Text } from "ol/style";
import type { Chart, Pixel } from "./chart";
import { placeOf, point } from "./chart";
import { keptAboard } from "./aboard";
import { bearing, bearing_deg, distance_m, metres } from "./geo";
import { areasOf, insertRingCorner, isSurvey, moveRingCorner, ringsOf } from "./area";
import { alike, cornerPlace, insertCorner, insertWaypoint, leg, moveCorner, moveWaypoint, path as pathOf, setObstacle } from "./mission";
import { FACE, cased, inked, palette } from "./palette";
import type { State } from "./state";
import type { Boat, Mission, Place, Ring, Station, Waypoint } from "./wire";

const REACH_PX = 14;
const REACH_TOUCH_PX = 26;
const LEG_FOR_MIDDLE_PX = 80;
const NUMBER_PX = 24; // between two discs with numbers
const ASIDE_PX = 25; // between two discs that stand side by side
const DRAFT = [8, 6];
const TURNS = 90; // an arrow's courses, of which each has a picture
const SHARED_MOST = 2000; // pictures
const MANY = 200; // waypoints, of which the map keeps a picture while it moves
const STATES: Record<Station["state"], "steer" | "done" | "bad"> = { waiting: "steer", sampled: "done", failed: "bad" }; // colours of a station's frame

export interface Handle {
  kind: "waypoint" | "middle" | "corner" | "edge" | "obstacle" | "home" | "area" | "side";
  index: number;
  ring?: number; // of the areas
  place: Place;
}

interface Look {
  colour: string;
  lineDash?: number[];
  small?: boolean; // it has no handles
}

type Changed = (mission: Mission) => void;

export class Plans {
  private readonly others = new VectorSource();
  private readonly legs = new VectorSource(); // of a thousand waypoints most are out of sight when near
  private readonly marks = new VectorSource();
  private readonly shapes = new VectorSource(); // areas, fence, and the legs of a waypoint that is dragged
  private readonly corners = new VectorSource(); // of these, and that waypoint
  private readonly over = new VectorSource({ useSpatialIndex: false });
  private readonly pictures: VectorImageLayer[]; // of legs and marks
  private readonly drawn: VectorLayer[]; // the same
  private draft: Mission | null = null; // while something is dragged or a form is open
  private held: Handle | null = null; // what is dragged
  private frame = 0; // in which that is drawn
  private rendered: number | undefined; // resolution of the map on the screen
  private resolution: number | undefined; // for which numbers and handles were chosen
  stand = false; // handles stay where they are, because clicks are something else now
  private rulers: [Place, Place][] = [];
  private ruler: Place | null = null;

  constructor(
    private readonly chart: Chart,
    private readonly state: State,
    changed: Changed,
  ) {
    const layer = (source: VectorSource) => new VectorLayer({ source, updateWhileAnimating: true, updateWhileInteracting: true });
    const picture = (source: VectorSource) => new VectorImageLayer({ source, imageRatio: 1.5, visible: false });
    [this.drawn, this.pictures] = [[layer(this.legs), layer(this.marks)], [picture(this.legs), picture(this.marks)]];
    chart.addPicture(this.others, 1.5, 3);
    chart.add(layer(this.shapes), 3);
    for (const each of [this.drawn[0]!, this.pictures[0]!]) chart.add(each, 3);
    for (const each of [this.drawn[1]!, this.pictures[1]!]) chart.add(each, 5);
    chart.add(layer(this.corners), 5);
    chart.add(layer(this.over), 7);
    state.on(["plan", "selection", "theme", "hello"], () => this.draw());
    state.on(["dryrun", "theme"], () => this.drawOver());
    let current = "";
    state.on(["boats"], () => {
      const now = state.boats.map(({ id, mode, mission, reference, lines_done, stations }) => `${id}:${mode}:${mission.current}:${mission.state}:${reference?.line}:${lines_done?.length}:${JSON.stringify(stations)}`).join();
      if (now !== current) this.draw();
      current = now;
    });
    chart.map.on("postrender", ({ frameState }) => (this.rendered = frameState?.viewState.resolution));
    chart.map.on("moveend", ({ frameState }) => {
      this.rendered = frameState?.viewState.resolution;
      if (this.rendered !== this.resolution) this.draw();
    });
    chart.map.addInteraction(new Dragging(this, state, changed));
  }

  /** What is drawn of the lines of a survey: which is done, and which is sailed now. */
  get progress(): string[] {
    return this.legs.getFeatures().flatMap((each) => (each.get("line") as string | undefined) ?? []);
  }

  /** What is drawn of the stations. */
  get stations(): string[] {
    return this.marks.getFeatures().flatMap((each) => (each.get("station") as string) || []);
  }

  /** How many numbers of waypoints are drawn. */
  get numbers(): number {
    return [...this.marks.getFeatures(), ...this.corners.getFeatures()].filter((each) => (each.getStyle() as Style).getText()).length;
  }

  /** Show another mission in place of the plan, with the next frame; null shows the plan again. While one of many waypoints is dragged by
   * a handle the picture of the plan stays, and what moves is drawn over it. */
  preview(mission: Mission | null, handle: Handle | null = null): void {
    this.draft = mission;
    this.held = mission && mission.waypoints.length > MANY ? handle : null;
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => (this.held ? this.drawMoving() : this.draw()));
  }

  /** The handle at this pixel; points go before the middles of legs. */
  at(pixel: Pixel, touch: boolean): Handle | null {
    if (this.state.replaying) return null;
    let [best, least] = [null as Handle | null, touch ? REACH_TOUCH_PX : REACH_PX];
    const aside = besideTheFirst(this.chart, this.mission().waypoints);
    for (const handle of this.handles()) {
      const its = this.chart.pixelOf(handle.place);
      if (its && aside && handle.kind === "waypoint" && handle.index === this.mission().waypoints.length - 1) its[0] += ASIDE_PX;
      const far = its ? Math.hypot(its[0] - pixel[0], its[1] - pixel[1]) : Infinity;
      const behind = ["middle", "edge", "side"].includes(handle.kind) ? 3 : 0;
      if (far + behind < least) [best, least] = [handle, far + behind];
    }
    return best;
  }

  get measuring(): boolean {
    return this.ruler !== null;
  }

  get measured(): boolean {
    return this.rulers.length > 0;
  }

  measure(from: Place | null): void {
    this.ruler = from;
    this.drawOver();
  }

  measureTo(place: Place, done: boolean): void {
    if (!this.ruler) return;
    if (done) {
      this.rulers.push([this.ruler, place]);
      this.ruler = null;
    }
    this.drawOver(done ? undefined : place);
  }

  clearRulers(): void {
    this.rulers = [];
    this.measure(null);
  }

  private mission(): Mission {
    return this.draft ?? this.state.plan(this.state.planning).mission;
  }

  private handles(): Handle[] {
    const mission = this.mission();
    const made: Handle[] = mission.waypoints.map((place, index) => ({ kind: "waypoint", index, place }));
    mission.fence.forEach((each, index) => made.push({ kind: "corner", index, place: cornerPlace(each) }));
    ringsOf(mission).forEach(({ corners }, ring) => corners.forEach((each, index) => made.push({ kind: "area", ring, index, place: cornerPlace(each) })));
    mission.obstacles.forEach((place, index) => made.push({ kind: "obstacle", index, place }));
    if (mission.home) made.push({ kind: "home", index: 0, place: mission.home });
    return [...made, ...this.middles(mission)];
  }

  private middles(mission: Mission): Handle[] {
    const made: Handle[] = [];
    const add = (kind: "middle" | "edge" | "side", index: number, a: Place, b: Place, ring?: number) => {
      const [from, to] = [this.chart.pixelOf(a), this.chart.pixelOf(b)];
      if (!from || !to || Math.hypot(from[0] - to[0], from[1] - to[1]) < LEG_FOR_MIDDLE_PX) return;
      const place = { latitude_deg: (a.latitude_deg + b.latitude_deg) / 2, longitude_deg: (a.longitude_deg + b.longitude_deg) / 2 };
      made.push({ kind, index, place, ...(ring === undefined ? {} : { ring }) });
    };
    if (!isSurvey(mission)) mission.waypoints.forEach((to, i) => i && !to.turn && add("middle", i, mission.waypoints[i - 1]!, to));
    const corners = mission.fence.map(cornerPlace);
    corners.forEach((each, i) => add("edge", i + 1, each, corners[(i + 1) % corners.length]!));
    ringsOf(mission).forEach(({ corners: round }, ring) => round.forEach((each, i) => add("side", i + 1, cornerPlace(each), cornerPlace(round[(i + 1) % round.length]!), ring)));
    return made;
  }

  private draw(): void {
    cancelAnimationFrame(this.frame);
    this.others.clear();
    for (const boat of this.state.boats) {
      const [aboard, planned] = [this.state.aboardOf(boat), this.state.plans.get(boat.id)?.mission];
      const shown = aboard ?? planned;
      if (shown && boat.id !== this.state.selected) this.others.addFeatures(drawnLegs(shown, inked(boat.colour, 0.6), 1.3, aboard ? undefined : DRAFT));
    }
    this.legs.clear();
    this.marks.clear();
    this.resolution = this.rendered;
    const [mission, boat] = [this.mission(), this.state.boat];
    const many = mission.waypoints.length > MANY;
    for (const each of this.pictures) each.setVisible(many);
    for (const each of this.drawn) each.setVisible(!many);
    const aboard = boat && this.state.aboardOf(boat);
    if (aboard && !this.isAboard) this.drawMission(aboard, boat!, { colour: palette.plan, small: mission.waypoints.length > 0 }, [this.legs, this.marks], () => true);
    this.drawMission(mission, boat, this.look, [this.legs, this.marks], () => true);
    this.drawMoving();
  }

  /** What a drag changes, and all that is not waypoints. */
  private drawMoving(): void {
    this.shapes.clear();
    this.corners.clear();
    const [mission, boat] = [this.mission(), this.state.boat];
    this.shapes.addFeatures([...drawnAreas(mission), ...keptAboard(mission, true)]);
    const [path, look] = [pathOf(mission).map(point), this.look];
    if (path.length > 1 && boat?.mode === "path") this.shapes.addFeature(styled(new LineString(path), ribbon(look)));
    const { kind, index = 0 } = this.held ?? {};
    if (kind === "waypoint" || kind === "middle") this.drawMission(mission, boat, look, [this.shapes, this.corners], (i, after) => i === index || i === index + after);
    mission.fence.forEach((each) => this.corners.addFeature(drawnCorner(cornerPlace(each), palette.limit, 5.5)));
    ringsOf(mission).forEach(({ corners }) => corners.forEach((each) => this.corners.addFeature(drawnCorner(cornerPlace(each), palette.survey, 5.5))));
    const tints: Record<string, string> = { edge: palette.limit, side: palette.survey };
    for (const { kind, place } of this.middles(mission)) if (kind !== "middle") this.corners.addFeature(drawnCorner(place, tints[kind]!, 4, 0.65));
  }

  private get isAboard(): boolean {
    const aboard = this.state.boat && this.state.aboardOf(this.state.boat);
    return aboard !== null && alike(this.mission(), aboard);
  }

  /** Solid: the mission aboard. Dashed: a plan that is on the screen only. */
  private get look(): Look {
    return this.isAboard ? { colour: palette.plan } : { colour: palette.draft, lineDash: DRAFT };
  }

  /** Some waypoints of a mission, and legs that lead to them or, `after` being 1, from the one before. */
  private drawMission(mission: Mission, boat: Boat | null, look: Look, [legs, marks]: [VectorSource, VectorSource], isIn: (index: number, after: number) => boolean): void {
    const leads = (to: number) => isIn(to, 1);
    legs.addFeatures(drawnLegs(mission, look.colour, 2.2, look.lineDash, leads));
    if (boat && !look.lineDash) legs.addFeatures(drawnProgress(mission, boat, leads));
    const sails = !look.lineDash && (boat?.mode === "play" || boat?.mode === "goto");
    const [current, last] = [sails ? boat!.mission.current : null, mission.waypoints.length - 1];
    const drawn = marks === this.marks ? numbered(this.chart, mission.waypoints, current) : null;
    const aside = besideTheFirst(this.chart, mission.waypoints);
    const hasLines = isSurvey(mission);
    const made = mission.waypoints.map((each, i) => {
      if (!isIn(i, 0)) return null;
      if (hasLines && i && i < last && i !== current && !each.tries) return drawnCorner(each, look.colour, 3);
      if (drawn && !drawn.has(i) && !each.tries) return null;
      return drawnWaypoint(each, i, i === current, look, aside && i === last ? ASIDE_PX : 0, look.lineDash ? undefined : boat?.stations?.[i + 1]);
    });
    const middles = mission !== this.mission() ? [] : this.middles(mission).filter(({ kind, index }) => kind === "middle" && leads(index));
    marks.addFeatures([...made.filter((each) => each !== null), ...middles.map(({ place }) => drawnCorner(place, look.colour, 4, 0.65))]);
  }

  private drawOver(to?: Place): void {
    this.over.clear();
    for (const [id, run] of this.state.dryruns) {
      if (id !== this.state.selected || run.track.length < 2) continue;
      const track = new LineString(run.track.map((each) => point(cornerPlace(each))));
      this.over.addFeature(styled(track, cased(palette.soft, 2, [2, 5])));
    }
    const crossed = this.state.crossed.get(this.state.planning);
    if (crossed) this.over.addFeature(drawnCrossing(cornerPlace(crossed)));
    const pending: [Place, Place][] = this.ruler ? [[this.ruler, to ?? this.ruler]] : [];
    for (const [from, end] of [...this.rulers, ...pending]) this.over.addFeatures(drawnRuler(from, end));
  }
}

/** Drags a handle; a press without a drag is a click, which the menus take. */
class Dragging extends PointerInteraction {
  private handle: Handle | null = null;
  private before: Mission | null = null;
  private now: Mission | null = null;

  constructor(
    private readonly plans: Plans,
    private readonly state: State,
    private readonly edited: Changed,
  ) {
    super();
  }

  override handleDownEvent(event: MapBrowserEvent): boolean {
    const pointer = event.originalEvent as PointerEvent;
    if (pointer.button !== 0 || this.plans.measuring || this.plans.stand) return false;
    this.handle = this.plans.at(event.pixel as Pixel, pointer.pointerType === "touch");
    this.before = this.handle && this.state.plan(this.state.planning).mission;
    this.now = null;
    return this.handle !== null;
  }

  override handleDragEvent(event: MapBrowserEvent): void {
    if (!this.handle || !this.before) return;
    this.now = dragged(this.before, this.handle, placeOf(event.coordinate));
    this.plans.preview(this.now, this.handle);
  }

  override handleUpEvent(): boolean {
    this.plans.preview(null);
    if (this.now) this.edited(this.now);
    [this.handle, this.before, this.now] = [null, null, null];
    return false;
  }
}

function dragged(mission: Mission, { kind, index, ring = 0 }: Handle, to: Place): Mission {
  switch (kind) {
    case "area":
      return moveRingCorner(mission, ring, index, to);
    case "side":
      return insertRingCorner(mission, ring, index, to);
    case "waypoint":
      return moveWaypoint(mission, index, to);
    case "middle":
      return insertWaypoint(mission, index, to);
    case "corner":
      return moveCorner(mission, index, to);
    case "edge":
      return insertCorner(mission, to, index);
    case "obstacle":
      return setObstacle(mission, index, { ...to, radius_m: mission.obstacles[index]!.radius_m });
    case "home":
      return { ...mission, home: to };
  }
}

const kept = new Map<string, unknown>();

/** Made once for all that look alike: a map that shares its pictures draws a thousand marks quickly. */
function shared<T>(look: string, make: () => T): T {
  if (kept.size > SHARED_MOST) kept.clear();
  if (!kept.has(look)) kept.set(look, make());
  return kept.get(look) as T;
}

function styled(geometry: LineString | Point, style: Style | Style[]): Feature {
  const feature = new Feature(geometry);
  feature.setStyle(style);
  return feature;
}

function drawnLegs(mission: Mission, colour: string, width: number, lineDash?: number[], isIn = (_to: number): boolean => true): Feature[] {
  const look = cased(colour, width, lineDash);
  return mission.waypoints.slice(1).flatMap((_, i) => {
    if (!isIn(i + 1)) return [];
    const points = leg(mission, i + 1).map(point);
    const line = styled(new LineString(points), look);
    const [a, b] = [points[Math.floor((points.length - 1) / 2)]!, points[Math.floor((points.length - 1) / 2) + 1]!];
    const arrow = new Feature(new Point([a[0]! + (b[0]! - a[0]!) * 0.62, a[1]! + (b[1]! - a[1]!) * 0.62]));
    const turned = Math.round(TURNS * (Math.atan2(b[0]! - a[0]!, b[1]! - a[1]!) / (2 * Math.PI)));
    const rotation = (2 * Math.PI * turned) / TURNS;
    const fill = () => new Fill({ color: colour });
    arrow.setStyle(shared(`arrow ${colour} ${width} ${turned}`, () => new Style({ image: new RegularShape({ points: 3, radius: 2.6 * width, rotation, rotateWithView: true, scale: [0.75, 1], fill: fill() }) })));
    return [line, arrow];
  });
}

/** The lines of a survey that were sailed, and the one that is. */
function drawnProgress({ waypoints }: Mission, { lines_done: done = [], reference, mode }: Boat, isIn: (to: number) => boolean): Feature[] {
  const now = mode === "play" || mode === "path" ? reference?.line : 0;
  return waypoints.slice(1).flatMap((to, i) => {
    const its = !to.line ? "" : to.line === now ? "now" : done.includes(to.line) ? "done" : "";
    if (!its || !isIn(i + 1)) return [];
    const line = styled(new LineString([waypoints[i]!, to].map(point)), its === "now" ? cased(palette.steer, 4.5) : cased(palette.done, 3.2));
    line.set("line", its);
    return [line];
  });
}

/** The waypoints that show their number: the first, the last, the one under way; then of the others, each tenth before the rest,
 * those that lie upon none of them. */
function numbered(chart: Chart, waypoints: Waypoint[], current: number | null): Set<number> {
  const [always, shown, cells] = [[0, waypoints.length - 1, current ?? 0], new Set<number>(), new Map<string, Pixel[]>()];
  const order = waypoints.map((_, i) => i).sort((a, b) => Number((b + 1) % 10 === 0) - Number((a + 1) % 10 === 0));
  for (const i of waypoints.length ? [...always, ...order] : []) {
    const pixel = shown.has(i) ? null : chart.pixelOf(waypoints[i]!);
    if (!pixel) continue;
    const [x, y] = [Math.floor(pixel[0] / NUMBER_PX), Math.floor(pixel[1] / NUMBER_PX)];
    const near = [-1, 0, 1].flatMap((right) => [-1, 0, 1].flatMap((down) => cells.get(`${x + right} ${y + down}`) ?? []));
    if (!always.includes(i) && near.some((its) => Math.hypot(its[0] - pixel[0], its[1] - pixel[1]) < NUMBER_PX)) continue;
    shown.add(i);
    cells.set(`${x} ${y}`, [...(cells.get(`${x} ${y}`) ?? []), pixel]);
  }
  return shown;
}

/** Whether the last waypoint would hide the first one, as when a mission ends where it began. */
function besideTheFirst(chart: Chart, waypoints: Waypoint[]): boolean {
  if (waypoints.length < 2) return false;
  const [first, last] = [chart.pixelOf(waypoints[0]!), chart.pixelOf(waypoints.at(-1)!)];
  return first !== null && last !== null && Math.hypot(first[0] - last[0], first[1] - last[1]) < ASIDE_PX;
}

/** The path of path following: a band that legs, fences and tracks are seen on. */
function ribbon({ colour, lineDash }: Look): Style {
  return new Style({ stroke: new Stroke({ color: `${colour}55`, width: 9, lineCap: "butt", ...(lineDash ? { lineDash: [14, 8] } : {}) }) });
}

function drawnWaypoint(place: Waypoint, index: number, current: boolean, { colour, small }: Look, aside_px: number, station?: Station): Feature {
  const feature = new Feature(new Point(point(place)));
  const [radius, inside, frame] = [small ? 10 : 12, current ? colour : palette.handle, station ? palette[STATES[station.state]] : colour];
  const width = station ? 4 : small ? 1.4 : 2.2;
  const image = shared(`${place.tries ? "station" : "disc"} ${radius} ${inside} ${frame} ${width} ${aside_px}`, () => {
    const its = { radius, fill: new Fill({ color: inside }), stroke: new Stroke({ color: frame, width }), displacement: [aside_px, 0] };
    return place.tries ? new RegularShape({ ...its, points: 4, angle: Math.PI / 4, radius: 1.35 * radius }) : new Disc(its);
  });
  feature.set("station", place.tries ? (station?.state ?? "ahead") : "");
  feature.setStyle(
    new Style({
      image,
      text: new Text({
        text: String(index + 1),
        font: `650 12px ${FACE}`,
        fill: new Fill({ color: current ? palette.handle : palette.ink }),
        offsetX: aside_px,
        offsetY: 1,
      }),
    }),
  );
  return feature;
}

function drawnCorner(place: Place, colour: string, radius: number, opacity = 1): Feature {
  const feature = new Feature(new Point(point(place)));
  const image = shared(`corner ${radius} ${opacity} ${palette.handle} ${colour}`, () => {
    const drawn = new Disc({ radius, fill: new Fill({ color: palette.handle }), stroke: new Stroke({ color: colour, width: 2 }) });
    drawn.setOpacity(opacity);
    return drawn;
  });
  feature.setStyle(new Style({ image }));
  return feature;
}

/** Where a chart forbids the plan. */
function drawnCrossing(place: Place): Feature {
  const feature = new Feature(new Point(point(place)));
  const ring = (color: string, width: number) => new Style({ image: new Disc({ radius: 12, stroke: new Stroke({ color, width }) }) });
  feature.setStyle([ring(palette.halo, 6), ring(palette.limit, 3)]);
  return feature;
}

function drawnRuler(from: Place, to: Place): Feature[] {
  const line = new Feature(new LineString([point(from), point(to)]));
  const words = `${metres(distance_m(from, to))}  ${bearing(bearing_deg(from, to))}`;
  const text = new Text({
    text: words,
    font: `600 14px ${FACE}`,
    fill: new Fill({ color: palette.ink }),
    stroke: new Stroke({ color: palette.halo, width: 4 }),
    offsetY: -14,
  });
  line.setStyle(cased(palette.ink, 1.6));
  const end = drawnCorner(to, palette.ink, 4);
  (end.getStyle() as Style).setText(text);
  return [line, drawnCorner(from, palette.ink, 4), end];
}

/** The areas of a plan. */
function drawnAreas(mission: Mission): Feature[] {
  const shade = new Style({ fill: new Fill({ color: `${palette.survey}1f` }), stroke: new Stroke({ color: palette.survey, width: 1.6 }) });
  return areasOf(mission).map(([outline, holes]) => {
    const ring = (corners: Ring) => [...corners, corners[0]!].map((each) => point(cornerPlace(each)));
    const area = new Feature(new Polygon([outline, ...holes].map(ring)));
    area.setStyle(shade);
    return area;
  });
}
