// The way that a boat goes home, while its menu is open and while it goes: as the boat tells it, or the track that was heard, back to the end that the boat tells.
// And how far its energy takes it.
import Feature from "ol/Feature";
import { LineString, Point, Polygon } from "ol/geom";
import VectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import { Circle as Disc, Fill, Stroke, Style, Text } from "ol/style";
import type { Chart } from "./chart";
import { point } from "./chart";
import { position } from "./fleet";
import { distance_m, duration, metres, towards } from "./geo";
import type { Net } from "./net";
import { FACE, cased, inked, palette } from "./palette";
import type { State } from "./state";
import type { Boat, Heard, Place } from "./wire";

const AGAIN_MS = 3000; // an answer may be lost

interface Way {
  points: Place[]; // the end first; what is behind a boat that goes home is dropped
  whole: boolean;
  speed_mps: number | undefined; // as the boat goes there
}

export class WayHome {
  private menu: number | null = null; // the boat whose menu is open
  private readonly ways = new Map<number, Way>();
  private readonly asked = new Map<number, number>(); // when
  private readonly lines = new VectorSource({ useSpatialIndex: false });

  constructor(
    chart: Chart,
    private readonly state: State,
    private readonly net: Net,
  ) {
    chart.add(new VectorLayer({ source: this.lines, updateWhileAnimating: true, updateWhileInteracting: true }), 5);
    state.on(["boats", "theme"], () => this.draw());
  }

  /** The boat whose menu is open now. */
  show(boat: number | null): void {
    this.menu = boat;
    if (boat !== null) this.ways.delete(boat); // the boat went on since
    this.asked.clear();
    this.draw();
  }

  take({ boat, points, whole, speed_mps }: Extract<Heard, { t: "way_home" }>): void {
    if (points.length) this.ways.set(boat, { points: points.map(([latitude_deg, longitude_deg]) => ({ latitude_deg, longitude_deg })), whole, speed_mps });
    else this.ways.delete(boat); // it is asked again
    this.draw();
  }

  /** What stands at the end of the way that is drawn. */
  words(id: number): string {
    const [boat, way] = [this.state.byId(id), this.ways.get(id)];
    const here = boat && position(boat);
    if (!here || !way?.points.length) return "";
    const points = [here, ...way.points.toReversed()];
    const far_m = points.slice(1).reduce((sum, each, i) => sum + distance_m(points[i]!, each), 0);
    const long = metres(far_m) + (way.speed_mps ? `, ${duration(far_m / way.speed_mps)}` : "");
    const energy = boat.energy;
    const takes = energy?.left_wh != null && energy.home_wh != null ? `, ${energy.home_wh.toFixed(0)} of ${energy.left_wh.toFixed(0)} Wh` : "";
    return way.whole ? `home: ${long}${takes}` : `home is further than these ${long}: the track was not heard from its beginning`;
  }

  private draw(): void {
    if (this.lines.getFeatures().length) this.lines.clear(); // an empty one would have the map drawn, too
    for (const boat of this.state.boats) {
      const goes = boat.mode === "home";
      if (!this.state.replaying && (goes || boat.id === this.menu)) this.reach(boat);
      if (this.state.replaying || !(goes || boat.asked === "home" || boat.id === this.menu)) this.ways.delete(boat.id);
      else if (!this.ways.has(boat.id)) this.ask(boat.id);
      else this.add(boat, this.ways.get(boat.id)!, goes);
    }
  }

  /** How far a boat gets over ground, its reserve kept; "": not known. */
  reaches(boat: Boat | undefined): string {
    const range_m = boat?.energy?.range_m ?? [];
    return range_m.some((each) => each > 0) ? `reach: ${metres(Math.min(...range_m))} to ${metres(Math.max(...range_m))}` : "";
  }

  /** The same as a shape: longer with the water than against it. */
  private reach(boat: Boat): void {
    const [here, range_m, words] = [position(boat), boat.energy?.range_m ?? [], this.reaches(boat)];
    if (!here || !words) return;
    const ring = range_m.map((far_m, i) => point(towards(here, (360 * i) / range_m.length, far_m)));
    const shape = new Feature(new Polygon([[...ring, ring[0]!]]));
    const text = new Text({ text: words, placement: "line", font: `600 12px ${FACE}`, fill: new Fill({ color: palette.steer }), stroke: new Stroke({ color: palette.halo, width: 4 }) });
    shape.setStyle(new Style({ fill: new Fill({ color: inked(palette.steer, 0.06) }), stroke: new Stroke({ color: palette.steer, width: 1.4, lineDash: [2, 5] }), text }));
    this.lines.addFeature(shape);
  }

  private ask(id: number): void {
    if (performance.now() - (this.asked.get(id) ?? -Infinity) < AGAIN_MS) return;
    this.asked.set(id, performance.now());
    void this.net.ask({ t: "home", boat: id });
  }

  private add(boat: Boat, { points }: Way, goes: boolean): void {
    const here = position(boat);
    if (!here || !points.length) return;
    while (goes && points.length > 1 && distance_m(points.at(-2)!, here) < distance_m(points.at(-1)!, here)) points.pop();
    const way = new Feature(new LineString([...points, here].map(point)));
    way.setStyle(cased(palette.steer, 2.2, [12, 7]));
    const end = new Feature(new Point(point(points[0]!)));
    const ink = (color: string, width: number) => new Stroke({ color, width });
    const text = new Text({ text: this.words(boat.id), font: `600 13px ${FACE}`, offsetY: 20, fill: new Fill({ color: palette.steer }), stroke: ink(palette.halo, 4) });
    end.setStyle(new Style({ image: new Disc({ radius: 7, fill: new Fill({ color: palette.handle }), stroke: ink(palette.steer, 2.2) }), text }));
    this.lines.addFeatures([way, end]);
  }
}
