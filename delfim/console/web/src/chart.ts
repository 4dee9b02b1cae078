// The map itself: background, graticule, view, scale, and what a pointer does on it.
import OlMap from "ol/Map";
import type MapBrowserEvent from "ol/MapBrowserEvent";
import View from "ol/View";
import ScaleLine from "ol/control/ScaleLine";
import { boundingExtent, buffer, containsExtent, createEmpty, extend, getWidth, intersects, isEmpty } from "ol/extent";
import type { Extent } from "ol/extent";
import DragPan from "ol/interaction/DragPan";
import MouseWheelZoom from "ol/interaction/MouseWheelZoom";
import PinchZoom from "ol/interaction/PinchZoom";
import type BaseLayer from "ol/layer/Base";
import Graticule from "ol/layer/Graticule";
import ImageLayer from "ol/layer/Image";
import TileLayer from "ol/layer/Tile";
import VectorImageLayer from "ol/layer/VectorImage";
import { fromLonLat, toLonLat, transformExtent } from "ol/proj";
import ImageStatic from "ol/source/ImageStatic";
import type VectorSource from "ol/source/Vector";
import XYZ from "ol/source/XYZ";
import { Fill, Stroke, Text } from "ol/style";
import { DangerLayer } from "./dangers";
import { FACE, palette } from "./palette";
import type { Background, Place } from "./wire";

const LONG_PRESS_MS = 550;
const MOVE_PX = 6;
const ALONE = 80; // of the view, about one place
const MINUTE = 1 / 60;
const SECOND = 1 / 3600;
const INTERVALS_DEG = [30, 10, 5, 2, 1, 30 * MINUTE, 10 * MINUTE, 5 * MINUTE, 2 * MINUTE, MINUTE, 30 * SECOND, 12 * SECOND, 6 * SECOND, 3 * SECOND, 1.2 * SECOND, 0.6 * SECOND];

const DEG = 180 / Math.PI;
const KEPT = "delfim.view";

export type Pixel = [number, number];

export const point = (place: Place): number[] => fromLonLat([place.longitude_deg, place.latitude_deg]);

export function placeOf(coordinate: number[]): Place {
  const [longitude_deg, latitude_deg] = toLonLat(coordinate);
  return { latitude_deg: latitude_deg!, longitude_deg: longitude_deg! };
}

export interface Pointing {
  click(place: Place, pixel: Pixel, touch: boolean): void;
  press(place: Place, pixel: Pixel): void;
  hover(place: Place, pixel: Pixel): void;
}

export class Chart {
  readonly map: OlMap;
  private readonly view = new View({ ...lastView(), maxZoom: 24, constrainRotation: false });
  private charts = new Map<string, BaseLayer>();
  private extents = new Map<string, Extent>();
  private graticule: Graticule | null = null;
  private pressed = false;
  private moved = (): void => {};

  constructor(target: HTMLElement, scale: HTMLElement, pointing: Pointing) {
    this.map = new OlMap({
      target,
      view: this.view,
      controls: [new ScaleLine({ minWidth: 90, target: scale })],
      interactions: [new DragPan(), new MouseWheelZoom({ timeout: 40 }), new PinchZoom()],
      moveTolerance: MOVE_PX,
    });
    const pixel = (event: MapBrowserEvent): Pixel => event.pixel as Pixel;
    this.map.on("click", (event) => {
      if (this.pressed) this.pressed = false;
      else pointing.click(placeOf(event.coordinate), pixel(event), (event.originalEvent as PointerEvent).pointerType === "touch");
    });
    this.map.on("pointermove", (event) => !event.dragging && pointing.hover(placeOf(event.coordinate), pixel(event)));
    this.map.on("moveend", () => localStorage.setItem(KEPT, JSON.stringify({ center: this.view.getCenter(), zoom: this.view.getZoom() })));
    this.longPress(target, pointing);
  }

  paint(): void {
    if (this.graticule) this.map.removeLayer(this.graticule);
    const ink = (words: "start" | "end", base: CanvasTextBaseline) =>
      new Text({
        font: `500 12px ${FACE}`,
        fill: new Fill({ color: palette.soft }),
        stroke: new Stroke({ color: palette.halo, width: 3 }),
        textAlign: words,
        textBaseline: base,
      });
    this.graticule = new Graticule({
      zIndex: 1,
      strokeStyle: new Stroke({ color: palette.line, width: 1 }),
      showLabels: true,
      wrapX: false,
      intervals: INTERVALS_DEG,
      targetSize: 140,
      lonLabelFormatter: (deg: number) => degrees(deg, "EW"),
      latLabelFormatter: (deg: number) => degrees(deg, "NS"),
      lonLabelPosition: 0.995,
      latLabelPosition: 0.99,
      lonLabelStyle: ink("start", "top"),
      latLabelStyle: ink("end", "bottom"),
    });
    this.map.addLayer(this.graticule);
    for (const layer of this.charts.values()) {
      if (layer instanceof DangerLayer) layer.changed(); // it has colours for the night
      else layer.setOpacity(palette.chart);
    }
    this.showGraticule();
  }

  add(layer: BaseLayer, order: number): void {
    layer.setZIndex(order);
    this.map.addLayer(layer);
  }

  /** One picture of all that a source holds, moved and scaled while the view moves. It is larger than the map: of nothing none is drawn. */
  addPicture(source: VectorSource, imageRatio: number, order: number): void {
    const layer = new VectorImageLayer({ source, imageRatio, visible: false });
    source.on("change", () => layer.setVisible(!source.isEmpty()));
    this.add(layer, order);
  }

  setBackgrounds(backgrounds: Background[]): void {
    const before = this.charts;
    this.charts = new Map(backgrounds.map((each) => [each.name, background(each)]));
    for (const layer of before.values()) this.map.removeLayer(layer);
    this.extents = new Map(backgrounds.map((each) => [each.name, transformExtent(each.extent, "EPSG:4326", "EPSG:3857")]));
    for (const [name, layer] of this.charts) {
      layer.setVisible(before.get(name)?.getVisible() ?? true);
      this.map.addLayer(layer);
    }
    this.paint();
  }

  shown(name: string): boolean {
    return this.charts.get(name)?.getVisible() ?? false;
  }

  toggle(name: string): void {
    this.charts.get(name)?.setVisible(!this.shown(name));
    this.showGraticule();
  }

  /** Whether any chart is drawn. */
  get charted(): boolean {
    return [...this.charts.values()].some((layer) => layer.getVisible());
  }

  /** Why the official charts that are shown forbid a place, in words; null: they do not. */
  why(place: Place, within_m = 1): string | null {
    const shown = [...this.charts.values()].filter((layer): layer is DangerLayer => layer instanceof DangerLayer && layer.getVisible());
    return shown.map((layer) => layer.why(point(place), this.view.getResolution() ?? 1, within_m)).find((each) => each) ?? null;
  }

  /** Calls back with the zoom whenever that changes. */
  onZoom(changed: (zoom: number) => void): void {
    this.view.on("change:resolution", () => changed(this.view.getZoom() ?? 0));
    changed(this.view.getZoom() ?? 0);
  }

  pixelOf(place: Place): Pixel | null {
    return this.map.getPixelFromCoordinate(point(place)) as Pixel | null;
  }

  coordinateAt(pixel: Pixel): number[] {
    return this.map.getCoordinateFromPixel(pixel);
  }

  zoom(by: number): void {
    this.view.animate({ zoom: (this.view.getZoom() ?? 3) + by, duration: 150 });
  }

  pan([right, down]: Pixel): void {
    const [step, [x, y], turned] = [this.view.getResolution() ?? 1, this.view.getCenter() ?? [0, 0], this.view.getRotation()];
    this.moved();
    this.view.setCenter([x! + step * (right * Math.cos(turned) + down * Math.sin(turned)), y! + step * (right * Math.sin(turned) - down * Math.cos(turned))]);
    this.map.renderSync();
  }

  /** Calls back when a hand moves the map. */
  onMoved(moved: () => void): void {
    this.moved = moved;
    this.map.on("pointerdrag", () => void moved()); // an answer of false would keep the drag from the map
  }

  /** The direction that is up on the screen. */
  get up_deg(): number {
    return -this.view.getRotation() * DEG;
  }

  set up_deg(deg: number) {
    this.view.setRotation(-deg / DEG);
  }

  /** What is in the middle of the part that nothing covers. */
  middle(): [Place, Pixel] {
    const centre = this.view.getCenter() ?? [0, 0];
    return [placeOf(centre), this.map.getPixelFromCoordinate(centre) as Pixel];
  }

  setPadding(padding: number[]): void {
    this.view.padding = padding;
  }

  /** Show all these places, and a margin around them; of one place alone more, so that there is room to draw. */
  fit(places: Place[], duration = 0): void {
    const extent: Extent = places.length ? boundingExtent(places.map(point)) : this.chartExtent();
    if (isEmpty(extent)) return;
    this.view.cancelAnimations();
    const wide = Math.max(extent[2]! - extent[0]!, extent[3]! - extent[1]!);
    const margin = wide ? Math.max(20, 0.08 * wide) : ALONE;
    this.view.fit(buffer(extent, margin), { duration, maxZoom: 21 });
  }

  /** Show all these places beside a box on the right of the window, or below it where there is no room beside it. */
  fitBeside(places: Place[], box: DOMRect, left_px: number): void {
    if (!places.length) return;
    const [beside, padding] = [box.left - left_px > 300, this.view.padding];
    this.view.padding = beside ? [50, innerWidth - box.left + 30, 70, left_px + 30] : [box.bottom + 20, 30, 120, 30];
    this.fit(places);
    this.view.padding = padding; // the view goes on from where it is
  }

  /** Bring a place into the middle when it is not well in sight. */
  follow(place: Place, duration = 250): void {
    const pixel = this.pixelOf(place);
    const [width, height] = this.map.getSize() ?? [0, 0];
    const inner = pixel && pixel[0] > 0.3 * width! && pixel[0] < 0.85 * width! && pixel[1] > 0.15 * height! && pixel[1] < 0.85 * height!;
    if (!inner && duration) this.view.animate({ center: point(place), duration });
    else if (!inner) this.view.setCenter(point(place));
  }

  /** A touch that has become something else: a drag of a handle is no long press. */
  private longPress(target: HTMLElement, pointing: Pointing): void {
    let timer = 0;
    let start: Pixel = [0, 0];
    const local = (event: PointerEvent): Pixel => this.map.getEventPixel(event) as Pixel;
    target.addEventListener("pointerdown", (event) => {
      this.pressed = false;
      clearTimeout(timer);
      if (event.pointerType === "mouse" || !event.isPrimary) return;
      start = local(event);
      timer = window.setTimeout(() => {
        this.pressed = true;
        pointing.press(placeOf(this.map.getCoordinateFromPixel(start)), start);
      }, LONG_PRESS_MS);
    });
    const moved = (event: PointerEvent) => {
      const now = local(event);
      if (Math.hypot(now[0] - start[0], now[1] - start[1]) > MOVE_PX) clearTimeout(timer);
    };
    window.addEventListener("pointermove", moved, { passive: true });
    for (const end of ["pointerup", "pointercancel"]) window.addEventListener(end, () => clearTimeout(timer));
    target.addEventListener("contextmenu", (event) => {
      event.preventDefault();
      if (event.pointerType !== "touch") {
        const at = this.map.getEventPixel(event) as Pixel;
        pointing.press(placeOf(this.map.getCoordinateFromPixel(at)), at);
      }
    });
  }

  private chartExtent(): Extent {
    const all = createEmpty();
    for (const [name, layer] of this.charts) if (layer.getVisible()) extend(all, this.extents.get(name) ?? createEmpty());
    return all;
  }

  /** Shows the charts, unless what is in sight is a part of one. */
  findCharts(): void {
    const [all, seen] = [this.chartExtent(), this.view.calculateExtent(this.map.getSize())];
    if (!containsExtent(all, seen) && !(intersects(all, seen) && getWidth(seen) < getWidth(all))) this.fit([]);
  }

  private showGraticule(): void {
    document.documentElement.classList.toggle("charted", this.charted); // words lie on plates there
    const official = [...this.charts.values()].some((layer) => layer instanceof DangerLayer && layer.getVisible());
    document.documentElement.classList.toggle("official", official);
    this.graticule?.setVisible(!this.charted);
  }
}

/** Where the map was when the page was left: before a boat is heard there is nothing else to show. */
function lastView(): { center: number[]; zoom: number } {
  const { center, zoom } = JSON.parse(localStorage.getItem(KEPT) ?? "{}") as { center?: number[]; zoom?: number };
  return { center: center ?? fromLonLat([-9.2146, 38.6901]), zoom: zoom ?? 3 };
}

function background(chart: Background): BaseLayer {
  const extent = transformExtent(chart.extent, "EPSG:4326", "EPSG:3857");
  const name = encodeURIComponent(chart.name);
  if (chart.kind === "dangers") return new DangerLayer(`background/${name}?${chart.made}`);
  if (chart.kind === "tiles") {
    const source = new XYZ({ url: `tiles/${name}/{z}/{x}/{y}`, minZoom: chart.minzoom ?? 0, maxZoom: chart.maxzoom ?? 18, wrapX: false });
    return new TileLayer({ source, extent, zIndex: 0 });
  }
  const source = new ImageStatic({ url: `background/${name}`, imageExtent: chart.extent, projection: "EPSG:4326" });
  return new ImageLayer({ source, extent, zIndex: 0 });
}

/** Degrees and decimal minutes, no longer than they need to be. */
function degrees(deg: number, letters: string): string {
  const tenths = Math.round(Math.abs(deg) * 6000);
  const [whole, minutes] = [Math.floor(tenths / 6000), (tenths % 6000) / 100];
  const words = Number.isInteger(minutes) ? String(minutes).padStart(2, "0") : minutes.toFixed(2).padStart(5, "0");
  return `${whole}° ${words}′ ${letters[deg < 0 ? 1 : 0]}`;
}
