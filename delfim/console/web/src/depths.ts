// Depths by colour, as the boats have told them, and what of a survey's area is not covered yet. Cells are painted into one small
// picture a tile; the map draws tiles, however many soundings they hold.
import type { FrameState } from "ol/Map";
import { apply } from "ol/transform";
import Layer from "ol/layer/Layer";
import { areasOf, isInside } from "./area";
import type { Chart } from "./chart";
import { point } from "./chart";
import { hide, make, text } from "./dom";
import { distance_m } from "./geo";
import type { State } from "./state";
import type { Survey } from "./survey";
import type { Heard, Mission, Place } from "./wire";

type Told = Extract<Heard, { t: "depths" }>;
type Extent = [west: number, south: number, east: number, north: number]; // degrees

const SIDE = 100;
const RAMP = ["#9bdba6", "#3fb59a", "#23868f", "#2e6490", "#3d3f86", "#3b0f55"]; // shallow to deep, for every eye; without the yellow of alerts
const GAP = [150, 60, 190, 100] as const;
const GAPS_MS = 2000; // between two looks for what is not covered
const CELLS_MOST = 250_000; // of an area
const KEPT = "delfim.depths";

interface Tile {
  extent: Extent;
  cells: Uint16Array; // cm; 0: nothing was told
  picture: HTMLCanvasElement;
}

export class Depths {
  private readonly tiles = new Map<string, Tile>();
  private range: [number, number] = [Infinity, -Infinity]; // cm, of the colours
  private gaps: { extent: Extent; picture: HTMLCanvasElement } | null = null;
  private covered: number | null = null; // part of the area
  private looked = 0;
  private readonly labels = make("span.labels");
  private readonly share = make("small");
  private readonly fill = make("button.plain", "Fill the gaps");
  private readonly canvas = make("canvas");
  private readonly layer: Layer;
  visible = localStorage.getItem(KEPT) !== "off";

  constructor(
    private readonly box: HTMLElement,
    chart: Chart,
    private readonly state: State,
    private readonly survey: Survey,
  ) {
    this.fill.addEventListener("click", () => survey.fill());
    box.append(make("i.ramp"), this.labels, this.share, this.fill);
    this.canvas.className = "depths";
    this.layer = new Layer({ render: (frame) => this.render(frame!) });
    this.layer.setVisible(this.visible);
    chart.add(this.layer, 1);
    state.on(["plan", "selection"], () => this.look());
  }

  toggle(): void {
    this.visible = !this.visible;
    localStorage.setItem(KEPT, this.visible ? "on" : "off");
    this.layer.setVisible(this.visible);
    this.legend();
  }

  /** How many cells have a depth, and what part of the area is covered. */
  get counts(): [number, number | null] {
    return [[...this.tiles.values()].reduce((sum, { cells }) => sum + cells.reduce((n, each) => n + Math.sign(each), 0), 0), this.covered];
  }

  /** Another gateway, or the same one anew: it tells everything. */
  forget(): void {
    this.tiles.clear();
    [this.gaps, this.covered] = [null, null];
    this.range = [Infinity, -Infinity];
    this.legend();
    this.layer.changed();
  }

  take({ tile: [row, column], extent, whole, cells }: Told): void {
    const key = `${row} ${column}`;
    let tile = this.tiles.get(key);
    if (!tile) {
      tile = { extent, cells: new Uint16Array(SIDE * SIDE), picture: make("canvas") };
      [tile.picture.width, tile.picture.height] = [SIDE, SIDE];
      this.tiles.set(key, tile);
    }
    const its = tile.cells;
    if (whole) its.set(new Uint16Array(Uint8Array.from(atob(whole), (each) => each.charCodeAt(0)).buffer));
    const changed = whole ? [...its.keys()] : cells!.map(([cell]) => cell);
    for (const [cell, depth_cm] of cells ?? []) its[cell] = depth_cm;
    if (this.widen(changed.map((cell) => its[cell]!))) for (const each of this.tiles.values()) this.paint(each, each.cells.keys());
    else this.paint(tile, changed);
    this.legend();
    this.look();
    this.layer.changed();
  }

  /** Makes the range of the colours as wide as these depths, in round metres. True if it is another one. */
  private widen(depths_cm: number[]): boolean {
    const before = this.range.join();
    for (const each of depths_cm) {
      if (!each) continue;
      this.range[0] = Math.min(this.range[0], 100 * Math.floor(each / 100));
      this.range[1] = Math.max(this.range[1], 100 * Math.ceil((each + 1) / 100));
    }
    return this.range.join() !== before;
  }

  private paint({ picture, cells }: Tile, which: Iterable<number>): void {
    const pen = picture.getContext("2d", { willReadFrequently: true })!;
    const image = pen.getImageData(0, 0, SIDE, SIDE);
    for (const cell of which) if (cells[cell]) image.data.set([...coloured(this.part(cells[cell]!)), 235], 4 * cell);
    pen.putImageData(image, 0, 0);
  }

  private part(depth_cm: number): number {
    const [least, most] = this.range;
    return (depth_cm - least) / (most - least || 1);
  }

  private render(frame: FrameState): HTMLElement {
    const [[width, height], ratio, pen] = [frame.size as [number, number], frame.pixelRatio, fitted(this.canvas, frame)];
    pen.imageSmoothingEnabled = false;
    const draw = ([west, south, east, north]: Extent, picture: HTMLCanvasElement) => {
      const at = (latitude_deg: number, longitude_deg: number) => apply(frame.coordinateToPixelTransform, point({ latitude_deg, longitude_deg })) as [number, number];
      const [[x, y], right, down] = [at(north, west), at(north, east), at(south, west)]; // the map may be turned
      const [a, b, c, d] = [right[0] - x, right[1] - y, down[0] - x, down[1] - y];
      const [left, top] = [Math.min(x, x + a, x + c, x + a + c), Math.min(y, y + b, y + d, y + b + d)];
      if (left > width || top > height || left + Math.abs(a) + Math.abs(c) < 0 || top + Math.abs(b) + Math.abs(d) < 0) return;
      const [across, high] = [picture.width / ratio, picture.height / ratio];
      pen.setTransform(a / across, b / across, c / high, d / high, x * ratio, y * ratio);
      pen.drawImage(picture, 0, 0);
    };
    if (this.gaps) draw(this.gaps.extent, this.gaps.picture);
    for (const { extent, picture } of this.tiles.values()) draw(extent, picture);
    pen.resetTransform(); // the layers above draw into it
    return this.canvas;
  }

  private legend(): void {
    hide(this.box, !this.visible || !this.tiles.size);
    if (this.box.hidden) return;
    const [least, most] = this.range.map((each) => each / 100) as [number, number];
    this.labels.replaceChildren(...[least, (least + most) / 2, most].map((each) => make("b", `${each} m`)));
    text(this.share, this.covered === null ? "" : `${Math.floor(100 * this.covered)} % covered`);
    hide(this.fill, this.state.replaying || !this.survey.hasLines);
  }

  /** What of the area has no sounding within half a line's spacing: looked for now and then. */
  private look(): void {
    const wait = this.looked + GAPS_MS - performance.now();
    if (this.looked < 0) return;
    this.looked = -1;
    setTimeout(() => {
      this.looked = performance.now();
      this.cover(this.state.plan(this.state.planning).mission);
      this.legend();
      this.layer.changed();
    }, Math.max(wait, 0));
  }

  private cover(mission: Mission): void {
    [this.gaps, this.covered] = [null, null];
    const areas = areasOf(mission);
    if (!areas.length || !this.tiles.size) return;
    const [spacing = 10, swath = 0, overlap = 0] = mission.survey!.values;
    const reach_m = Math.max(spacing || swath * (1 - overlap / 100), swath) / 2 + 3.6; // and half a cell's diagonal
    const corners = areas.flatMap(([outline]) => outline);
    const [lats, lons] = [corners.map(([lat]) => lat), corners.map(([, lon]) => lon)];
    const extent: Extent = [Math.min(...lons), Math.min(...lats), Math.max(...lons), Math.max(...lats)];
    const [west, south, east, north] = extent;
    const place = (latitude_deg: number, longitude_deg: number): Place => ({ latitude_deg, longitude_deg });
    const [wide_m, high_m] = [distance_m(place(south, west), place(south, east)), distance_m(place(south, west), place(north, west))];
    const cell_m = Math.max(5, Math.sqrt((wide_m * high_m) / CELLS_MOST));
    const [across, down] = [Math.max(1, Math.ceil(wide_m / cell_m)), Math.max(1, Math.ceil(high_m / cell_m))];
    const near = this.near(extent, across, down, reach_m / cell_m);
    if (!near) return;
    const picture = make("canvas");
    [picture.width, picture.height] = [across, down];
    const pen = picture.getContext("2d")!;
    const image = pen.createImageData(across, down);
    let [all, sounded] = [0, 0];
    for (let y = 0; y < down; y++) {
      for (let x = 0; x < across; x++) {
        const here = place(north - ((y + 0.5) / down) * (north - south), west + ((x + 0.5) / across) * (east - west));
        if (!areas.some(([outline, holes]) => isInside(outline, here) && !holes.some((hole) => isInside(hole, here)))) continue;
        all++;
        if (near[y * across + x]) sounded++;
        else image.data.set(GAP, 4 * (y * across + x));
      }
    }
    pen.putImageData(image, 0, 0);
    this.covered = all ? sounded / all : null;
    this.gaps = { extent, picture };
  }

  /** Which cells of a raster have a sounding within so many of them; null: none has. */
  private near([west, south, east, north]: Extent, across: number, down: number, reach: number): Uint8Array | null {
    const found = new Uint8Array(across * down);
    let any = false;
    for (const { extent, cells } of this.tiles.values()) {
      const [w, s, e, n] = extent;
      if (w > east || e < west || s > north || n < south) continue;
      cells.forEach((depth, i) => {
        if (!depth) return;
        const x = ((w + (((i % SIDE) + 0.5) / SIDE) * (e - w) - west) / (east - west)) * across;
        const y = ((north - (n - ((Math.floor(i / SIDE) + 0.5) / SIDE) * (n - s))) / (north - south)) * down;
        for (let v = Math.max(0, Math.floor(y - reach)); v <= Math.min(down - 1, y + reach); v++) {
          for (let u = Math.max(0, Math.floor(x - reach)); u <= Math.min(across - 1, x + reach); u++) {
            if (Math.hypot(u + 0.5 - x, v + 0.5 - y) <= reach) found[v * across + u] = 1;
          }
        }
        any ||= x > 0 && x < across && y > 0 && y < down;
      });
    }
    return any ? found : null;
  }
}

const TABLE: [number, number, number][] = Array.from({ length: 256 }, (_, i) => {
  const at = (i / 255) * (RAMP.length - 1);
  const [from, to] = [channels(RAMP[Math.floor(at)]!), channels(RAMP[Math.min(Math.floor(at) + 1, RAMP.length - 1)]!)];
  return from.map((each, k) => Math.round(each + (to[k]! - each) * (at % 1))) as [number, number, number];
});

/** An empty canvas as large as the map, and its pen. */
export function fitted(canvas: HTMLCanvasElement, { size, pixelRatio }: FrameState): CanvasRenderingContext2D {
  const [width, height] = size!.map((each) => Math.round(each * pixelRatio)) as [number, number];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const pen = canvas.getContext("2d")!;
  pen.resetTransform();
  pen.clearRect(0, 0, width, height);
  return pen;
}

/** A colour of the ramp, of a part from 0 to 1. */
export function coloured(part: number): [number, number, number] {
  return TABLE[Math.max(0, Math.min(255, Math.round(part * 255)))]!;
}

function channels(colour: string): number[] {
  return [1, 3, 5].map((at) => Number.parseInt(colour.slice(at, at + 2), 16));
}
