// Other vessels on the map: symbols after IMO's SN.1/Circ.243, what they will do, and the order of a boat that keeps clear of one.
import Feature from "ol/Feature";
import { type Geometry, LineString, Point } from "ol/geom";
import Polygon, { circular } from "ol/geom/Polygon";
import VectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import { Fill, Icon, Stroke, Style, Text } from "ol/style";
import type { Chart, Pixel } from "./chart";
import { point } from "./chart";
import { position } from "./fleet";
import { beside, towards } from "./geo";
import { drawn, hull, outlined } from "./hull";
import { SIDES, type Side, drawnLeader, leader, sideFor, stand } from "./labels";
import { FACE, cased, onPlate, palette, theme } from "./palette";
import type { State } from "./state";
import { ahead_min, speedWords } from "./units";
import { worst } from "./watch";
import type { Watch } from "./watch";
import type { Vessel } from "./wire";

const RAD = Math.PI / 180;
const HEADING_PX = 26;
const NAMES_FROM_ZOOM = 12;
const NAMED = 40; // those that are met first; two hundred names take long to draw and cannot be read
const BELOW: Side = { x: 16, y: 12, align: "left" }; // its course does not run through the name
const ORDER_M = 60; // the line of an order is at least so long
const ORDER_S = 60;

export class Others {
  private readonly source = new VectorSource({ useSpatialIndex: false });
  private readonly own = new VectorSource({ useSpatialIndex: false }); // orders and guard zones, which move with the boats
  private zoom = 0;
  private looks: string[] = []; // as they are drawn
  private pixels: Pixel[] = [];
  private marks: Pixel[] = []; // what a name must not cover

  constructor(
    private readonly chart: Chart,
    private readonly state: State,
    private readonly watch: Watch,
  ) {
    chart.addPicture(this.source, 1.5, 5);
    chart.add(new VectorLayer({ source: this.own, updateWhileAnimating: true, updateWhileInteracting: true }), 5);
    chart.onZoom((zoom) => {
      const named = this.zoom >= NAMES_FROM_ZOOM;
      this.zoom = zoom;
      if (named !== zoom >= NAMES_FROM_ZOOM) this.draw();
    });
    state.on(["vessels"], () => this.isMoved() && this.draw());
    state.on(["theme"], () => this.draw());
    state.on(["boats", "vessels"], () => this.drawOwn());
  }

  /** The vessel whose symbol is nearest to this pixel, within reach. */
  at(pixel: Pixel, reach_px: number): Vessel | null {
    let [best, least] = [null as Vessel | null, reach_px];
    for (const vessel of this.state.vessels) {
      const its = this.chart.pixelOf(vessel);
      const far = its ? Math.hypot(its[0] - pixel[0], its[1] - pixel[1]) : Infinity;
      if (far <= least) [best, least] = [vessel, far];
    }
    return best;
  }

  /** Whether any vessel looks otherwise than it is drawn, or has moved by a pixel. */
  private isMoved(): boolean {
    const { vessels } = this.state;
    return vessels.length !== this.looks.length || vessels.some((each, i) => {
      const [[x, y], [left, top]] = [this.chart.pixelOf(each) ?? [0, 0], this.pixels[i]!];
      return Math.hypot(x - left, y - top) >= 1 || this.looks[i] !== this.look(each, i);
    });
  }

  /** All of a vessel but its place. */
  private look(vessel: Vessel, i: number): string {
    const { key, kind, lost, margin_m, course_deg, heading_deg, speed_mps, length_m, beam_m, domain_m } = vessel;
    return [key, kind, lost, lost && margin_m, course_deg, heading_deg, speed_mps, length_m, beam_m, domain_m, this.watch.gravity(vessel), i < NAMED && labelWords(vessel)].join("|");
  }

  private draw(): void {
    const { vessels } = this.state;
    [this.looks, this.pixels] = [vessels.map((each, i) => this.look(each, i)), vessels.map((each) => this.chart.pixelOf(each) ?? [0, 0])];
    this.marks = [...this.pixels, ...this.state.boats.map(position).flatMap((place) => {
      const pixel = place && this.chart.pixelOf(place);
      return pixel ? [pixel] : [];
    })];
    this.source.clear(true);
    this.source.addFeatures(vessels.flatMap((each, i) => this.vessel(each, i < NAMED)));
  }

  private drawOwn(): void {
    const made = [...this.orders(), ...this.zone()];
    if (!made.length && !this.own.getFeatures().length) return;
    this.own.clear(true);
    this.own.addFeatures(made);
  }

  private vessel(vessel: Vessel, named: boolean): Feature[] {
    const here = point(vessel);
    const grave = this.watch.gravity(vessel);
    const ink = grave === "none" ? palette.ink : palette.bad;
    const made: Feature[] = [];
    const add = (shape: Geometry, style: Style | Style[] | ReturnType<typeof drawn>) => {
      const feature = new Feature(shape);
      feature.setStyle(style);
      made.push(feature);
    };
    if (grave !== "none" && !vessel.lost) add(new Polygon([domain(vessel)]), inQuestion(grave === "danger"));
    if (!vessel.lost && vessel.course_deg !== null && vessel.speed_mps > 0.1) {
      const ahead = point(towards(vessel, vessel.course_deg, vessel.speed_mps * 60 * ahead_min));
      add(new LineString([here, ahead]), grave === "none" ? new Style({ stroke: new Stroke({ color: ink, width: 1.2, lineDash: [8, 5] }) }) : cased(ink, 2.2, [8, 5]));
    }
    if (vessel.lost) add(circular([vessel.longitude_deg, vessel.latitude_deg], vessel.margin_m, 48).transform("EPSG:4326", "EPSG:3857"), cased(ink, 1.2, [6, 5]));
    const turned = vessel.heading_deg ?? vessel.course_deg;
    const style = new Style({
      image: new Icon({ img: symbol(vessel, grave !== "none", turned !== null), rotateWithView: true, scale: grave === "none" ? 0.6 : 0.7, rotation: (turned ?? 0) * RAD }),
      zIndex: grave === "none" ? 4 : 6,
    });
    const far = grave === "none" && this.zoom < NAMES_FROM_ZOOM;
    if (grave === "danger" || vessel.kind === "distress" || (named && !far)) made.push(...this.named(vessel, style, grave !== "none"));
    const near = vessel.size_known && vessel.heading_deg !== null && !isThing(vessel) ? hull(vessel, vessel.heading_deg, vessel) : null;
    add(new Point(here), near ? drawn(() => near, [style], outlined(vessel.lost ? "transparent" : palette.handle, ink, style.getZIndex()!, vessel.lost ? [8, 6] : undefined)) : style);
    return made;
  }

  /** The name of a vessel beside its symbol; where there is no room a line leads to it. What is dangerous is named in any case. */
  private named(vessel: Vessel, style: Style, grave: boolean): Feature[] {
    const [its, text] = [this.chart.pixelOf(vessel), label(vessel, grave, this.chart.charted)];
    const side = its && sideFor(its, labelWords(vessel), [BELOW, ...SIDES], this.marks);
    if (!side && !grave) return [];
    style.setText(text);
    if (side) stand(text, side);
    if (!side?.lead) return [];
    const line = drawnLeader();
    line.setGeometry(leader(this.chart, its!, side));
    return [line];
  }

  /** The course that keeps a boat clear of another vessel, with its sentence. */
  private orders(): Feature[] {
    return this.state.boats.flatMap((boat) => {
      const place = position(boat);
      if (!place || !boat.order) return [];
      const far_m = Math.max(ORDER_M, (boat.speed_mps ?? 0) * ORDER_S);
      const line = new Feature(new LineString([point(place), point(towards(place, boat.order.course_deg, far_m))]));
      const turned = (boat.order.course_deg - this.chart.up_deg) * RAD;
      const isLeft = Math.sin(turned) < 0;
      const words = new Text({
        text: boat.order.words.replace(/, (?!CPA)/g, ",\n"),
        font: `600 13px ${FACE}`,
        textAlign: isLeft ? "right" : "left", // beyond the line, not over it
        offsetX: isLeft ? -14 : 14,
        offsetY: -16 * Math.cos(turned),
        fill: new Fill({ color: palette.steer }),
        stroke: new Stroke({ color: palette.halo, width: 4 }),
      });
      const end = new Style({ geometry: (feature) => new Point((feature.getGeometry() as LineString).getLastCoordinate()), text: words });
      line.setStyle([...cased(palette.steer, 3.4), end]);
      return [line];
    });
  }

  /** The guard zone of this page, around each boat. */
  private zone(): Feature[] {
    const { zone_m } = this.watch;
    if (!zone_m) return [];
    return this.state.boats.flatMap((boat) => {
      const place = position(boat);
      if (!place) return [];
      const ring = new Feature(circular([place.longitude_deg, place.latitude_deg], zone_m, 64).transform("EPSG:4326", "EPSG:3857"));
      ring.setStyle(cased(palette.limit, 1.8, [3, 6]));
      return [ring];
    });
  }
}

/** The ellipse that nobody should be in, along the vessel's course. */
function domain(vessel: Vessel): number[][] {
  const [ahead_m, abeam_m] = vessel.domain_m;
  const course = vessel.course_deg ?? vessel.heading_deg ?? 0;
  return Array.from({ length: 49 }, (_, i) => point(beside(vessel, course, ahead_m * Math.cos((i * Math.PI) / 24), abeam_m * Math.sin((i * Math.PI) / 24))));
}

const inQuestion = (isDanger: boolean): Style =>
  new Style({ fill: new Fill({ color: palette.danger }), stroke: new Stroke({ color: palette.bad, width: isDanger ? 2.2 : 1.2, lineDash: [6, 4] }) });

function label(vessel: Vessel, grave: boolean, plate: boolean): Text {
  return new Text({
    text: labelWords(vessel),
    font: `${grave ? 650 : 500} 12px ${FACE}`,
    textAlign: "left",
    offsetX: 16,
    offsetY: 8,
    fill: new Fill({ color: grave ? palette.bad : palette.soft }),
    ...onPlate(plate, 3.5),
  });
}

/** Name, and what matters of one that comes near; a lost one says how long it was silent. */
export function labelWords(vessel: Vessel): string {
  if (vessel.lost) return `${vessel.name}\nlost, ${secondsWords(vessel.age_s)} ago`;
  const first = worst(vessel);
  if (!first || first.danger === "none" || first.cpa_m === null) return vessel.name;
  return `${vessel.name}\nCPA ${first.cpa_m.toFixed(0)} m ${tcpaWords(first.tcpa_s)}`;
}

export const secondsWords = (s: number): string => (s < 180 ? `${s.toFixed(0)} s` : `${(s / 60).toFixed(0)} min`);

/** When two are nearest. */
export function tcpaWords(tcpa_s: number | null): string {
  if (tcpa_s === null) return "";
  return tcpa_s < 0 ? "past" : `in ${secondsWords(tcpa_s)}`;
}

export const KINDS: Record<string, string> = { A: "AIS class A", B: "AIS class B", fleet: "of the fleet", payload: "seen by a payload", distress: "distress", thing: "stands", person: "a swimmer" };
export const isThing = ({ kind }: Vessel): boolean => kind === "thing" || kind === "person";
const STATUS: Record<number, string> = { 1: "at anchor", 2: "not under command", 3: "restricted", 4: "constrained by draught", 5: "moored", 6: "aground", 7: "fishing", 8: "sailing" };

/** All that is known of a vessel, a line each. */
export function vesselLines(vessel: Vessel, name: (boat: number) => string): string[] {
  const course = vessel.course_deg === null ? "lies still" : `${Math.round(vessel.course_deg)}° at ${speedWords(vessel.speed_mps)}`;
  const size = vessel.size_known ? `${vessel.length_m.toFixed(0)} × ${vessel.beam_m.toFixed(0)} m` : `size unknown, taken as ${vessel.length_m.toFixed(0)} × ${vessel.beam_m.toFixed(0)} m`;
  const sort = [KINDS[vessel.kind] ?? vessel.kind, STATUS[vessel.status]].filter(Boolean).join(", ");
  const seen = secondsWords(vessel.age_s);
  if (isThing(vessel)) return [`${sort}, seen by ${vessel.name}`, `radius ${(vessel.length_m / 2).toFixed(0)} m, ± ${vessel.margin_m.toFixed(0)} m`, `last seen ${seen} ago`];
  const near = vessel.boats.map(({ boat, cpa_m, tcpa_s }) => `${name(boat)}: CPA ${cpa_m === null ? "–" : `${cpa_m.toFixed(0)} m`} ${tcpaWords(tcpa_s)}`);
  return [sort, course, size, `${vessel.lost ? "LOST: last" : "last"} report ${secondsWords(vessel.age_s)} ago, ± ${vessel.margin_m.toFixed(0)} m`, ...near];
}

const symbols = new Map<string, HTMLCanvasElement>();

/** A triangle with its heading line, twice as large as it is shown; red and bold: dangerous; dashed: lost; a circle with a
 * cross: distress; a square: the heading is not known; a dot: it stands; a head above the water: a swimmer. */
function symbol(vessel: Vessel, grave: boolean, turned: boolean): HTMLCanvasElement {
  const kind = vessel.kind === "distress" || isThing(vessel) ? vessel.kind : turned ? "vessel" : "still";
  const key = [kind, grave, vessel.lost, vessel.heading_deg !== null, theme].join("|");
  const known = symbols.get(key);
  if (known) return known;
  const canvas = document.createElement("canvas");
  const size = 4 * HEADING_PX;
  [canvas.width, canvas.height] = [size, size];
  const pen = canvas.getContext("2d")!;
  pen.translate(size / 2, size / 2);
  pen.lineJoin = "round";
  const shape = outline(kind);
  const heading = new Path2D();
  if (kind === "vessel" && vessel.heading_deg !== null && !vessel.lost) {
    heading.moveTo(0, -24);
    heading.lineTo(0, -2 * HEADING_PX + 2);
  }
  const cross = new Path2D();
  if (kind === "distress") {
    for (const side of [-12, 12]) {
      cross.moveTo(-12, side);
      cross.lineTo(12, -side);
    }
  }
  const ink = grave || kind === "distress" ? palette.bad : palette.ink;
  const stroke = (tint: string, width: number) => {
    [pen.strokeStyle, pen.lineWidth] = [tint, width];
    pen.setLineDash(vessel.lost && tint !== palette.halo ? [8, 6] : []);
    pen.stroke(shape);
    pen.setLineDash([]);
    pen.stroke(heading);
    pen.stroke(cross);
  };
  stroke(palette.halo, grave ? 12 : 9);
  if (!vessel.lost) {
    pen.fillStyle = kind === "thing" ? ink : palette.handle;
    pen.fill(shape);
  }
  stroke(ink, grave ? 7 : 4);
  symbols.set(key, canvas);
  return canvas;
}

function outline(kind: string): Path2D {
  const shape = new Path2D();
  if (kind === "distress") shape.arc(0, 0, 19, 0, 2 * Math.PI);
  else if (kind === "thing") shape.arc(0, 0, 8, 0, 2 * Math.PI);
  else if (kind === "person") {
    shape.arc(0, -4, 8, 0, 2 * Math.PI);
    shape.moveTo(-18, 12);
    shape.quadraticCurveTo(-9, 4, 0, 12);
    shape.quadraticCurveTo(9, 20, 18, 12);
  } else if (kind === "still") shape.rect(-11, -11, 22, 22);
  else {
    shape.moveTo(0, -24);
    shape.lineTo(13, 16);
    shape.lineTo(-13, 16);
    shape.closePath();
  }
  return shape;
}
