// The base map: land and harbours of the world, so coarse that they go where a harbour fills the screen. No network is needed, and it is
// no chart.
import Feature from "ol/Feature";
import Point from "ol/geom/Point";
import Polygon from "ol/geom/Polygon";
import VectorLayer from "ol/layer/Vector";
import { fromLonLat } from "ol/proj";
import VectorSource from "ol/source/Vector";
import { Circle, Fill, Stroke, Style, Text } from "ol/style";
import type { Chart } from "./chart";
import { text } from "./dom";
import { FACE, palette } from "./palette";
import type { State } from "./state";

const SEEN_MS = 500; // before it is loaded: most pages show the sea about a boat by then, where no land is drawn
const STEPS = 500; // of a degree: web/land.mjs
const FADES_FROM = 10; // zoom levels: 120 m a pixel off Lisbon, where its errors begin to be seen,
const GONE_AT = 12; // and 30 m, where they would be taken for the shore
const FIRST_AT = 4; // zoom levels: the greatest harbours are seen; one of a lesser rank of the next ...
const GREATEST = 3; // ... from this one on
const SOURCE = "Land and harbours: Natural Earth (public domain), wrong by up to a kilometre: not for navigation";

export class Land {
  polygons = 0;
  harbours = 0;
  private readonly source = new VectorSource<Feature<Polygon>>({ wrapX: false });
  private readonly layer = new VectorLayer({ source: this.source, style: () => this.style });
  private readonly ports = new VectorSource<Feature<Point>>({ wrapX: false });
  private readonly names = new VectorLayer({
    source: this.ports,
    declutter: true,
    style: (port) => (port.get("rank") - GREATEST <= (this.zoom - FIRST_AT) * 1.5 ? this.named(port.get("name")) : undefined),
  });
  private style = new Style();
  private dot = new Circle({ radius: 2.5 });
  private zoom = 0;
  private due = 0;

  constructor(
    private readonly chart: Chart,
    private readonly state: State,
    private readonly words: HTMLElement,
  ) {
    chart.add(this.layer, -1);
    chart.add(this.names, 1);
    chart.onZoom((zoom) => this.fade(zoom));
    state.on(["theme", "hello"], () => this.paint());
    this.paint();
  }

  /** Once, when it has been in sight for a moment. */
  private load(): void {
    if (this.due || !this.layer.getVisible()) return;
    this.due = window.setTimeout(() => {
      if (this.layer.getVisible()) void this.fetched();
      else this.due = 0;
    }, SEEN_MS);
  }

  private async fetched(): Promise<void> {
    const answer = await fetch("land.bin");
    if (!answer.ok) return;
    const features = [...polygons(new Uint8Array(await answer.arrayBuffer()))].map((rings) => new Feature(new Polygon(rings)));
    this.source.addFeatures(features);
    this.polygons = features.length;
    const harbours = await fetch("harbours.tsv");
    if (harbours.ok) this.ports.addFeatures((await harbours.text()).trim().split("\n").map(port));
    this.harbours = this.ports.getFeatures().length;
    this.tell();
  }

  private paint(): void {
    this.style = new Style({ fill: new Fill({ color: palette.land }) });
    this.dot = new Circle({ radius: 2.5, fill: new Fill({ color: palette.soft }) });
    this.layer.changed();
    this.names.changed();
    this.tell();
  }

  private fade(zoom: number): void {
    const opacity = Math.max(0, Math.min(1, (GONE_AT - zoom) / (GONE_AT - FADES_FROM)));
    this.zoom = zoom;
    for (const layer of [this.layer, this.names]) {
      layer.setOpacity(opacity);
      layer.setVisible(opacity > 0);
    }
    this.load();
    this.tell();
  }

  private named(name: string): Style {
    const text = new Text({
      text: name,
      font: `500 11px ${FACE}`,
      offsetX: 6,
      textAlign: "start",
      fill: new Fill({ color: palette.soft }),
      stroke: new Stroke({ color: palette.halo, width: 3 }),
    });
    return new Style({ image: this.dot, text });
  }

  /** What is drawn under the mission, and what is not. */
  private tell(): void {
    const chart = "No chart here. How to add one: Screen in the menu";
    text(this.words, this.layer.getVisible() && this.polygons ? SOURCE : this.chart.charted || !this.state.hello ? "" : chart);
  }
}

/** A row of web/harbours.tsv: rank, degrees east and north, name. */
function port(row: string): Feature<Point> {
  const [rank, longitude, latitude, name] = row.split("\t");
  const feature = new Feature(new Point(fromLonLat([Number(longitude), Number(latitude)])));
  feature.setProperties({ rank: Number(rank), name });
  return feature;
}

/** The rings of each polygon, in the map's metres. */
function* polygons(bytes: Uint8Array): Generator<number[][][]> {
  let [at, x, y] = [0, 0, 0];
  const next = (): number => {
    let [value, place, byte] = [0, 1, 128];
    for (; byte > 127; place *= 128) value += ((byte = bytes[at++]!) & 127) * place;
    return value % 2 ? -(value + 1) / 2 : value / 2;
  };
  while (at < bytes.length) {
    const ring = () => Array.from({ length: next() }, () => fromLonLat([(x += next()) / STEPS, (y += next()) / STEPS]));
    yield Array.from({ length: next() }, ring).map((each) => [...each, each[0]!]);
  }
}
