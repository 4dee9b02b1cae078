// The base map: the land of the world, so coarse that it goes where a harbour fills the screen. No network is needed, and it is no chart.
import Feature from "ol/Feature";
import Polygon from "ol/geom/Polygon";
import VectorLayer from "ol/layer/Vector";
import { fromLonLat } from "ol/proj";
import VectorSource from "ol/source/Vector";
import { Fill, Style } from "ol/style";
import type { Chart } from "./chart";
import { text } from "./dom";
import { palette } from "./palette";
import type { State } from "./state";

const STEPS = 500; // of a degree: web/land.mjs
const FADES_FROM = 10; // zoom levels: 120 m a pixel off Lisbon, where its errors begin to be seen,
const GONE_AT = 12; // and 30 m, where they would be taken for the shore
const SOURCE = "Land: Natural Earth (public domain), wrong by up to a kilometre: not for navigation";

export class Land {
  polygons = 0;
  private readonly source = new VectorSource<Feature<Polygon>>({ wrapX: false });
  private readonly layer = new VectorLayer({ source: this.source, style: () => this.style });
  private style = new Style();

  constructor(
    private readonly chart: Chart,
    private readonly state: State,
    private readonly words: HTMLElement,
  ) {
    chart.add(this.layer, -1);
    chart.onZoom((zoom) => this.fade(zoom));
    state.on(["theme", "hello"], () => this.paint());
    this.paint();
    void this.load();
  }

  private async load(): Promise<void> {
    const answer = await fetch("land.bin");
    if (!answer.ok) return;
    const features = [...polygons(new Uint8Array(await answer.arrayBuffer()))].map((rings) => new Feature(new Polygon(rings)));
    this.source.addFeatures(features);
    this.polygons = features.length;
    this.tell();
  }

  private paint(): void {
    this.style = new Style({ fill: new Fill({ color: palette.land }) });
    this.layer.changed();
    this.tell();
  }

  private fade(zoom: number): void {
    const opacity = Math.max(0, Math.min(1, (GONE_AT - zoom) / (GONE_AT - FADES_FROM)));
    this.layer.setOpacity(opacity);
    this.layer.setVisible(opacity > 0);
    this.tell();
  }

  /** What is drawn under the mission, and what is not. */
  private tell(): void {
    const chart = "No chart here. How to add one: Screen in the menu";
    text(this.words, this.layer.getVisible() && this.polygons ? SOURCE : this.chart.charted || !this.state.hello ? "" : chart);
  }
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
