// A value that the boats measure, by colour along their tracks: of what this page has heard since it was opened.
import type { FrameState } from "ol/Map";
import Layer from "ol/layer/Layer";
import { apply } from "ol/transform";
import type { Chart } from "./chart";
import { point } from "./chart";
import { coloured, fitted } from "./depths";
import { make } from "./dom";
import { position } from "./fleet";
import { valueWords } from "./measured";
import type { Item } from "./popup";
import type { State } from "./state";

const EVERY_S = 0.9;
const YOUNG_S = 2; // an older value was measured elsewhere
const GAP_S = 15; // where nothing was told for so long nothing is drawn
const POINTS_MOST = 7200; // of a value of a boat: two hours
const SHADES = 24;
const KEPT = "delfim.coloured";

interface Told {
  at_s: number;
  place: number[];
  value: number;
}

export class ValueTrack {
  private readonly kept = new Map<string, Map<number, Told[]>>(); // by value and boat
  private readonly canvas = make("canvas.depths");
  private readonly layer: Layer;
  name = localStorage.getItem(KEPT) ?? "";

  constructor(
    private readonly box: HTMLElement,
    chart: Chart,
    private readonly state: State,
  ) {
    this.layer = new Layer({ render: (frame) => this.render(frame!), visible: false });
    chart.add(this.layer, 5);
    state.on(["boats"], () => this.take());
    state.on(["hello"], () => {
      this.kept.clear();
      this.draw();
    });
  }

  /** What the tracks can be coloured by. */
  items(): Item[] {
    const item = (name: string, title: string): Item => ({ title, tick: this.name === name, do: () => this.show(name) });
    return [item("", "None"), ...[...this.kept.keys()].sort().map((name) => item(name, name))];
  }

  /** How many places have each value. */
  get counts(): Record<string, number> {
    return Object.fromEntries([...this.kept].map(([name, boats]) => [name, [...boats.values()].reduce((sum, each) => sum + each.length, 0)]));
  }

  private show(name: string): void {
    this.name = name;
    localStorage.setItem(KEPT, name);
    this.draw();
  }

  private take(): void {
    let told = false; // a value of what is shown
    for (const boat of this.state.boats) {
      const place = position(boat);
      for (const [name, { value, age_s }] of place ? Object.entries(boat.measured ?? {}) : []) {
        if (age_s > YOUNG_S) continue;
        if (!this.kept.has(name)) this.kept.set(name, new Map());
        const boats = this.kept.get(name)!;
        const [points, at_s] = [boats.get(boat.id) ?? [], this.state.at_s - age_s];
        const last_s = points.at(-1)?.at_s ?? -Infinity;
        if (at_s < last_s - GAP_S) points.length = 0; // a replay went back
        else if (at_s < last_s + EVERY_S) continue;
        points.push({ at_s, place: point(place!), value });
        if (points.length > POINTS_MOST) points.shift();
        boats.set(boat.id, points);
        told ||= name === this.name;
      }
    }
    if (told) this.draw();
  }

  private draw(): void {
    const all = this.kept.get(this.name);
    this.box.hidden = !all;
    this.layer.setVisible(all !== undefined);
    if (!all) return;
    const [least, most] = this.range;
    this.box.replaceChildren(make("i.ramp"), make("span.labels", ...[least, (least + most) / 2, most].map((each) => make("b", valueWords(this.name, each)))));
    this.layer.changed();
  }

  private get range(): [number, number] {
    let [least, most] = [Infinity, -Infinity];
    for (const points of this.kept.get(this.name)?.values() ?? []) for (const { value } of points) [least, most] = [Math.min(least, value), Math.max(most, value)];
    return [least, most];
  }

  private render(frame: FrameState): HTMLElement {
    const pen = fitted(this.canvas, frame);
    const [least, most] = this.range;
    const ways = Array.from({ length: SHADES }, () => new Path2D());
    for (const points of this.kept.get(this.name)?.values() ?? []) {
      points.forEach(({ at_s, place, value }, i) => {
        const before = points[i - 1];
        if (!before || at_s - before.at_s > GAP_S) return;
        const way = ways[Math.round(((value - least) / (most - least || 1)) * (SHADES - 1))]!;
        const at = (each: number[]) => apply(frame.coordinateToPixelTransform, [...each]) as [number, number];
        way.moveTo(...at(before.place));
        way.lineTo(...at(place));
      });
    }
    pen.scale(frame.pixelRatio, frame.pixelRatio);
    pen.lineCap = "round";
    pen.lineWidth = 6;
    ways.forEach((way, i) => {
      pen.strokeStyle = `rgb(${coloured(i / (SHADES - 1)).join()})`;
      pen.stroke(way);
    });
    pen.resetTransform();
    return this.canvas;
  }
}
