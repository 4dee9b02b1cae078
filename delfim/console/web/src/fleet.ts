// The boats on the map: symbol, name, past track, course, reference, ghost when silent, and what is aboard.
import Feature, { type FeatureLike } from "ol/Feature";
import { type Circle, LineString, MultiPoint, Point, type Polygon } from "ol/geom";
import { circular } from "ol/geom/Polygon";
import VectorLayer from "ol/layer/Vector";
import VectorImageLayer from "ol/layer/VectorImage";
import VectorSource from "ol/source/Vector";
import { Circle as Disc, Fill, Icon, RegularShape, Stroke, Style, Text } from "ol/style";
import { keptAboard } from "./aboard";
import type { Chart, Pixel } from "./chart";
import { point } from "./chart";
import { distance_m, towards } from "./geo";
import { type Hull, drawn, hull, long_px, outlined } from "./hull";
import { SIDES, type Side, drawnLeader, leader, sideFor, stand } from "./labels";
import { FACE, cased, inked, onPlate, over, palette, theme } from "./palette";
import type { State } from "./state";
import { age_s, ageWords, freshness } from "./state";
import { ahead_min } from "./units";
import type { Boat, Place } from "./wire";

const CHUNK = 500;
const CHUNKS_MOST = 72; // ten hours at a point a second, as many as the gateway keeps
const EVERY_S = 1;
const GAP_S = 15; // where nothing was heard for so long no track is drawn
const JUMP_MPS = 15; // nor where a boat would have been faster, beyond ...
const JUMP_M = 20; // ... so far: another boat, or another fix
const AHEAD_S = 60; // of a heading that it steers for
const RAD = Math.PI / 180;
const STILL_MPS = 0.1;
const STEP_PX = 1; // a smaller step is not drawn
const BOW_PX = 46;

interface Shown {
  symbol: Feature<Point>;
  ring: Feature<Point>;
  course: Feature<LineString>;
  reference: Feature<LineString>;
  ghost: Feature<Polygon>;
  ghostSymbol: Feature<Point>;
  tail: Feature<LineString>;
  points: number[][];
  closed: Feature<LineString>[];
  last_s: number;
  last: Place | null; // the last point
  icon: Icon | null;
  tick: RegularShape | null;
  name: Text | null;
  hull: Hull | null; // to scale, where its size and heading are known
  side: Side;
  leader: Feature<LineString>; // to a name that stands aside
  label: string;
  look: string;
  pixels: number[]; // as it is drawn
}

export class Fleet {
  private readonly shown = new Map<number, Shown>();
  private readonly closedTracks = new VectorSource({ useSpatialIndex: true });
  private readonly tails = new VectorSource({ useSpatialIndex: false });
  private readonly live = new VectorSource({ useSpatialIndex: false });
  private readonly ways = new VectorSource({ useSpatialIndex: true });
  private readonly waysLayer = new VectorImageLayer({ source: this.ways, imageRatio: 2 }); // on the map in a replay only
  private readonly aboard = new VectorSource({ useSpatialIndex: false });
  private readonly wholes = new Map<number, { at_s: number; place: Place }[]>();
  private aboardKey = "";

  constructor(
    private readonly chart: Chart,
    private readonly state: State,
  ) {
    const layer = (source: VectorSource) => new VectorLayer({ source, updateWhileAnimating: true, updateWhileInteracting: true });
    chart.addPicture(this.closedTracks, 2, 4);
    chart.add(layer(this.tails), 4);
    chart.add(layer(this.aboard), 2);
    chart.add(layer(this.live), 6);
    state.on(["boats"], () => {
      this.extend();
      if (this.isMoved()) this.draw();
      else this.drawAboard();
    });
    state.on(["selection", "plan"], () => this.draw());
    state.on(["theme"], () => this.repaint());
    state.on(["forgotten"], () => this.sweep());
  }

  /** The boat whose symbol is nearest to this pixel, within reach. */
  at(pixel: Pixel, reach_px: number): Boat | null {
    let [best, least] = [null as Boat | null, reach_px];
    for (const boat of this.state.boats) {
      const place = position(boat);
      const its = place && this.chart.pixelOf(place);
      const far = its ? Math.hypot(its[0] - pixel[0], its[1] - pixel[1]) : Infinity;
      if (far <= least) [best, least] = [boat, far];
    }
    return best;
  }

  history(id: number, start: boolean, points: [number, number, number][]): void {
    const boat = this.state.byId(id);
    if (!boat) return;
    const shown = this.of(boat);
    if (start) this.forget(shown);
    for (const [at_s, latitude_deg, longitude_deg] of points) this.append(shown, boat, at_s, { latitude_deg, longitude_deg });
    this.draw();
  }

  /** The whole track of a recorded run, under the part that was sailed up to the time shown. */
  whole(id: number, points: [number, number, number][]): void {
    const known = this.wholes.get(id) ?? [];
    const before = known.at(-1);
    this.wholes.set(id, [...known, ...points.map(([at_s, latitude_deg, longitude_deg]) => ({ at_s, place: { latitude_deg, longitude_deg } }))]);
    if (!this.ways.getFeatures().length) this.chart.add(this.waysLayer, 2);
    const line = new LineString([...(before ? [point(before.place)] : []), ...points.map(([, latitude_deg, longitude_deg]) => point({ latitude_deg, longitude_deg }))]);
    const way = new Feature(line);
    way.setStyle(() => cased(palette.soft, 1.2));
    this.ways.addFeature(way);
  }

  /** The whole track of a boat of a recorded run. */
  way(id: number): Place[] {
    return (this.wholes.get(id) ?? []).map(({ place }) => place);
  }

  /** All of them. */
  get allWays(): Place[] {
    return [...this.wholes.keys()].flatMap((id) => this.way(id));
  }

  get wayPoints(): number {
    return this.allWays.length;
  }

  forgetWays(): void {
    this.chart.map.removeLayer(this.waysLayer);
    this.ways.clear();
    this.wholes.clear();
  }

  /** How long its hull is drawn to scale, in pixels; 0: it is a symbol. */
  long(id: number): number {
    return long_px(this.shown.get(id)?.hull, this.chart.map.getView().getResolution()!);
  }

  /** How many points of a boat's track are kept. */
  points(id: number): number {
    const shown = this.shown.get(id);
    return shown ? shown.closed.reduce((sum, each) => sum + each.getGeometry()!.getCoordinates().length - 1, shown.points.length) : 0;
  }

  /** In how many pieces it is kept. */
  pieces(id: number): number {
    const shown = this.shown.get(id);
    return shown ? shown.closed.length + Math.sign(shown.points.length) : 0;
  }

  /** The names that are drawn, where they stand beside their boats, in pixels, and whether a line leads to them. */
  get names(): [name: string, x: number, y: number, lead: boolean][] {
    return [...this.shown.values()].flatMap(({ name, side, leader: line }) => (name?.getText() ? [[String(name.getText()), side.x, side.y, line.getGeometry() !== undefined]] : []));
  }

  clearTracks(): void {
    for (const shown of this.shown.values()) this.forget(shown);
    this.draw();
  }

  /** Only by new positions of the boats: what is drawn for another reason, as after a reconnection, may be older than the tracks
   * that the gateway has sent. */
  private extend(): void {
    const { boats, at_s } = this.state;
    for (const boat of boats) {
      const place = position(boat);
      if (!place || !at_s || freshness(age_s(this.state, boat)) === "lost") continue;
      const [shown, now_s] = [this.of(boat), at_s - (boat.age_s.position ?? 0)];
      // A fast replay shows a boat each few seconds: between them it went along its whole way.
      if (shown.last_s > -Infinity) for (const each of this.wholes.get(boat.id) ?? []) if (each.at_s > shown.last_s && each.at_s < now_s) this.append(shown, boat, each.at_s, each.place);
      this.append(shown, boat, now_s, place);
    }
  }

  /** Whether any boat looks otherwise than it is drawn, or stands a pixel beside that. */
  private isMoved(): boolean {
    return this.state.boats.some((boat) => {
      const { look, pixels } = this.of(boat);
      const now = this.pixels(boat);
      return look !== this.look(boat) || now.length !== pixels.length || now.some((each, i) => Math.abs(each - pixels[i]!) >= STEP_PX);
    });
  }

  /** Where the parts of a boat are on the screen: itself, its bow, the ends of its course and of its way, its ghost and how large that is. */
  private pixels(boat: Boat): number[] {
    const place = position(boat);
    const here = place && this.chart.pixelOf(place);
    const ghost = boat.ghost && [boat.ghost, towards(boat.ghost, 90, boat.ghost.radius_m)];
    const far_m = boat.speed_mps !== null && boat.speed_mps > STILL_MPS ? boat.speed_mps * 60 * ahead_min : 0;
    const { latitude_deg = null, longitude_deg = null, heading_deg = null } = boat.reference ?? {};
    const ends = place && [towards(place, boat.course_deg ?? 0, far_m), towards(place, heading_deg ?? 0, AHEAD_S)];
    if (latitude_deg !== null && longitude_deg !== null) ends?.push({ latitude_deg, longitude_deg });
    const turned = (boat.heading_deg ?? boat.course_deg ?? 0) * RAD;
    const bow = here ? [here[0] + BOW_PX * Math.sin(turned), here[1] - BOW_PX * Math.cos(turned)] : [];
    return [...(here ?? []), ...bow, ...[...(ends ?? []), ...(ghost ?? [])].flatMap((each) => this.chart.pixelOf(each) ?? [])];
  }

  private draw(): void {
    const marks = this.marks();
    for (const boat of this.state.boats) {
      this.of(boat).pixels = this.pixels(boat);
      this.drawBoat(boat);
      this.placeName(this.of(boat), boat, marks);
    }
    this.drawAboard();
  }

  /** Pixels that a name must not cover: the numbers of the waypoints, and boats. */
  private marks(): Pixel[] {
    const { boats, selected } = this.state;
    const chosen = this.state.boat;
    const aboard = (chosen && this.state.aboardOf(chosen)?.waypoints) ?? [];
    const waypoints = selected === null ? [] : [...this.state.plan(selected).mission.waypoints, ...aboard];
    return [...waypoints, ...boats.flatMap((boat) => position(boat) ?? [])].flatMap((place) => {
      const pixel = this.chart.pixelOf(place);
      return pixel ? [pixel] : [];
    });
  }

  /** A name moves only when a mark comes into its place, so that it does not hop about. */
  private placeName(shown: Shown, boat: Boat, marks: Pixel[]): void {
    const place = position(boat);
    const its = place && this.chart.pixelOf(place);
    const side = its && sideFor(its, shown.label, shown.side.lead ? SIDES : [shown.side, ...SIDES], marks);
    shown.side = side ?? shown.side;
    shown.name?.setText(side || boat.id === this.state.selected || !its ? shown.label : ""); // the number on the hull stays
    if (shown.name) stand(shown.name, shown.side);
    put(shown.leader, side?.lead ? leader(this.chart, its!, side) : null);
  }

  private drawBoat(boat: Boat): void {
    const shown = this.of(boat);
    const place = position(boat);
    const lost = freshness(age_s(this.state, boat)) === "lost";
    this.dress(shown, boat, lost);
    const here = place && point(place);
    shown.hull = place && boat.heading_deg !== null && boat.size?.length_m ? hull(place, boat.heading_deg, boat.size) : null;
    put(shown.symbol, here && new Point(here));
    put(shown.ring, here && boat.id === this.state.selected ? new Point(here) : null);
    put(shown.tail, here && shown.points.length ? new LineString([...shown.points, here]) : null);
    shown.icon?.setRotation((boat.heading_deg ?? boat.course_deg ?? 0) * RAD);
    shown.tick?.setRotation((boat.course_deg ?? 0) * RAD);
    const course = !lost && place && boat.course_deg !== null && boat.speed_mps !== null && boat.speed_mps > STILL_MPS;
    put(shown.course, course ? new LineString([here!, point(towards(place, boat.course_deg!, boat.speed_mps! * 60 * ahead_min))]) : null);
    put(shown.reference, !lost && here ? reference(boat, place!, here) : null);
    const { ghost } = boat;
    put(shown.ghost, ghost ? (circular([ghost.longitude_deg, ghost.latitude_deg], ghost.radius_m, 48).transform("EPSG:4326", "EPSG:3857") as Polygon) : null);
    put(shown.ghostSymbol, ghost ? new Point(point(ghost)) : null);
  }

  /** Boats that were forgotten leave nothing on the map. */
  private sweep(): void {
    for (const [id, shown] of this.shown) {
      if (this.state.byId(id)) continue;
      this.forget(shown);
      this.tails.removeFeatures([shown.tail, shown.reference, shown.course]);
      this.live.removeFeatures([shown.ghost, shown.ghostSymbol, shown.leader, shown.ring, shown.symbol]);
      this.shown.delete(id);
    }
    this.draw();
  }

  private of(boat: Boat): Shown {
    let shown = this.shown.get(boat.id);
    if (shown) return shown;
    shown = {
      symbol: new Feature<Point>(),
      ring: new Feature<Point>(),
      course: new Feature<LineString>(),
      reference: new Feature<LineString>(),
      ghost: new Feature<Polygon>(),
      ghostSymbol: new Feature<Point>(),
      tail: new Feature<LineString>(),
      points: [],
      closed: [],
      last_s: -Infinity,
      last: null,
      icon: null,
      tick: null,
      name: null,
      hull: null,
      side: SIDES[0],
      leader: drawnLeader(),
      label: "",
      look: "",
      pixels: [],
    };
    this.shown.set(boat.id, shown);
    const { tail, ghost, ghostSymbol, reference: to, course, ring, symbol, leader: line } = shown;
    this.tails.addFeatures([tail, to, course]);
    this.live.addFeatures([ghost, ghostSymbol, line, ring, symbol]);
    return shown;
  }

  private label(boat: Boat): string {
    const age = age_s(this.state, boat);
    return freshness(age) === "fresh" ? boat.name : `${boat.name}  ${ageWords(age)}`;
  }

  private look(boat: Boat): string {
    const { colour, heading_deg, mode, reference: to } = boat;
    const refers = to && mode !== "idle" && mode !== "manual" && [to.latitude_deg !== null, to.heading_deg !== null];
    return [theme, colour, freshness(age_s(this.state, boat)), this.label(boat), boat.id === this.state.selected, refers, heading_deg !== null, this.chart.charted].join("|");
  }

  private dress(shown: Shown, boat: Boat, lost: boolean): void {
    const look = this.look(boat);
    if (look === shown.look) return;
    const chosen = boat.id === this.state.selected;
    const isPlace = boat.reference?.latitude_deg != null;
    const turned = boat.heading_deg !== null && !lost;
    const plate = this.chart.charted;
    const label = this.label(boat);
    [shown.look, shown.label] = [look, label];
    shown.icon = new Icon({ img: symbol(boat.colour, lost, turned), rotateWithView: true, scale: 0.5 });
    shown.tick = new RegularShape({ points: 2, radius: 5, angle: Math.PI / 2, rotateWithView: true, stroke: new Stroke({ color: inked(boat.colour), width: 1.6 }) });
    shown.name = new Text({
      text: label,
      font: `${chosen ? 650 : 500} 14px ${FACE}`,
      fill: new Fill({ color: lost ? palette.bad : palette.ink }),
      ...onPlate(plate, 4),
    });
    const number = new Text({ text: String(boat.id), font: `700 11px ${FACE}`, offsetY: 1, fill: new Fill({ color: lost ? inked(boat.colour) : over(boat.colour) }) });
    const zIndex = chosen ? 9 : 8;
    const [ink, fill] = lost ? [inked(boat.colour), palette.sea] : [palette.hull, boat.colour];
    const styles = [new Style({ image: shown.icon, text: shown.name, zIndex }), new Style({ text: number, zIndex })];
    shown.symbol.setStyle(drawn(() => shown.hull, styles, outlined(fill, ink, zIndex)));
    shown.ring.setStyle(new Style({ image: new Disc({ radius: 23, stroke: new Stroke({ color: palette.accent, width: 2 }) }), zIndex: 7 }));
    shown.course.setStyle([...cased(inked(boat.colour), 1.6), new Style({ image: shown.tick, geometry: ticks })]);
    shown.reference.setStyle(isPlace ? [...steering(), target()] : steering());
    shown.tail.setStyle(track(boat));
    shown.ghost.setStyle(
      new Style({ fill: new Fill({ color: inked(boat.colour, 0.12) }), stroke: new Stroke({ color: inked(boat.colour), width: 1.5, lineDash: [4, 5] }) }),
    );
    shown.ghostSymbol.setStyle(new Style({ image: new Icon({ img: symbol(boat.colour, true, false), rotation: (boat.course_deg ?? 0) * RAD, rotateWithView: true, scale: 0.5, opacity: 0.7 }) }));
  }

  private append(shown: Shown, boat: Boat, at_s: number, place: Place): void {
    if (at_s < shown.last_s - 5) this.forget(shown); // a replay went back
    if (at_s - shown.last_s < EVERY_S) return;
    if (this.isApart(shown, at_s, place)) this.close(shown, boat);
    [shown.last_s, shown.last] = [at_s, place];
    shown.points.push(point(place));
    if (shown.points.length >= CHUNK) this.close(shown, boat, [point(place)]);
  }

  private isApart({ last, last_s }: Shown, at_s: number, place: Place): boolean {
    if (!last) return false;
    return (!this.state.replaying && at_s - last_s > GAP_S) || distance_m(last, place) > JUMP_M + JUMP_MPS * (at_s - last_s);
  }

  /** The track goes on from these points. */
  private close(shown: Shown, boat: Boat, onwards: number[][] = []): void {
    const closed = new Feature(new LineString(shown.points));
    closed.setStyle(track(boat));
    this.closedTracks.addFeature(closed);
    shown.closed.push(closed);
    if (shown.closed.length > CHUNKS_MOST) this.closedTracks.removeFeature(shown.closed.shift()!);
    shown.points = onwards;
  }

  private forget(shown: Shown): void {
    this.closedTracks.removeFeatures(shown.closed);
    Object.assign(shown, { points: [], closed: [], last_s: -Infinity, last: null });
  }

  private repaint(): void {
    for (const boat of this.state.boats) {
      for (const closed of this.shown.get(boat.id)?.closed ?? []) closed.setStyle(track(boat));
    }
    this.aboardKey = "";
    this.draw();
  }

  /** Fence, obstacles and home aboard: redrawn only when they change. */
  private drawAboard(): void {
    const key = JSON.stringify(this.state.boats.map(({ id, fence, obstacles, zones, home }) => [id, fence, obstacles, zones, home]));
    if (key === this.aboardKey) return;
    this.aboardKey = key;
    this.aboard.clear();
    for (const boat of this.state.boats) this.aboard.addFeatures(keptAboard(boat));
  }
}

function track(boat: Boat): Style {
  return new Style({ stroke: new Stroke({ color: inked(boat.colour, 0.6), width: 4.5 }) });
}

export function position(boat: Boat): Place | null {
  if (boat.latitude_deg === null || boat.longitude_deg === null) return null;
  return { latitude_deg: boat.latitude_deg, longitude_deg: boat.longitude_deg };
}

function reference(boat: Boat, place: Place, here: number[]): LineString | null {
  const to = boat.reference;
  if (!to || boat.mode === "idle" || boat.mode === "manual") return null;
  if (to.latitude_deg !== null && to.longitude_deg !== null) {
    return new LineString([here, point({ latitude_deg: to.latitude_deg, longitude_deg: to.longitude_deg })]);
  }
  if (to.heading_deg === null) return null;
  return new LineString([here, point(towards(place, to.heading_deg, Math.max(20, (boat.speed_mps ?? 0) * AHEAD_S)))]);
}

const steering = (): Style[] => cased(palette.steer, 2.2, [2, 5]);

/** A ring around the place that the boat steers for. */
function target(): Style {
  return new Style({
    geometry: (feature) => {
      const line = feature.getGeometry() as LineString | undefined; // a boat that is lost has none
      return line && new Point(line.getLastCoordinate());
    },
    image: new Disc({ radius: 17, stroke: new Stroke({ color: palette.steer, width: 2.2 }) }),
  });
}

function put<G extends Point | LineString | Polygon | Circle>(feature: Feature<G>, geometry: G | null): void {
  feature.setGeometry(geometry ?? undefined);
}

const symbols = new Map<string, HTMLCanvasElement>();

/** Where a course has its ticks: at each minute. */
function ticks(feature: FeatureLike): MultiPoint | undefined {
  const course = feature.getGeometry() as LineString | undefined;
  return course && new MultiPoint(Array.from({ length: ahead_min }, (_, i) => course.getCoordinateAt((i + 1) / ahead_min)));
}

/** A hull from above with its bow, twice as large as it is shown, and a line ahead where the heading is known; hollow when the link is lost. */
function symbol(colour: string, hollow: boolean, ahead: boolean): HTMLCanvasElement {
  const key = `${colour}|${hollow}|${ahead}|${theme}`;
  const known = symbols.get(key);
  if (known) return known;
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [60, 184];
  const pen = canvas.getContext("2d")!;
  pen.translate(30, 92);
  pen.lineJoin = "round";
  const hull = new Path2D("M0 -38 C11 -26 18 -10 18 6 L15 35 L-15 35 L-18 6 C-18 -10 -11 -26 0 -38 Z");
  const bow = new Path2D(ahead ? "M0 -38 V-86" : "");
  const stroke = (tint: string, width: number) => {
    [pen.strokeStyle, pen.lineWidth] = [tint, width];
    pen.stroke(hull);
    pen.lineWidth = width / 1.6;
    pen.stroke(bow);
  };
  stroke(palette.halo, 11);
  stroke(hollow ? inked(colour) : palette.hull, 5.5);
  pen.fillStyle = hollow ? palette.sea : colour;
  pen.fill(hull);
  symbols.set(key, canvas);
  return canvas;
}
