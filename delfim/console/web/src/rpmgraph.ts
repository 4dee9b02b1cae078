// One thruster's speed over the last minute, with a gap where it is unknown.
import { make, text } from "./dom";
import { palette } from "./palette";

const SPAN_S = 60;
const POINTS_MOST = 700;

export class RpmGraph {
  readonly root = make("figure.graph");
  private readonly value = make("figcaption");
  private readonly canvas = make("canvas");
  private points: [at_s: number, rpm: number | null][] = [];
  private shown = [0, -75, 500]; // at_s, least, most
  private wide = 0; // pixels; 0: nobody sees it
  highest = 0;
  lowest = 0;

  constructor(private readonly side: "port" | "starboard") {
    this.root.classList.add(side);
    this.root.append(this.canvas, this.value);
    new ResizeObserver(([entry]) => {
      const { width, height } = entry!.contentRect;
      this.wide = width * devicePixelRatio;
      if (!width) return; // it is folded away
      [this.canvas.width, this.canvas.height] = [Math.round(width * devicePixelRatio), Math.round(height * devicePixelRatio)];
      this.repaint();
    }).observe(this.root);
  }

  push(at_s: number, rpm: number | null): void {
    const last_s = this.points.at(-1)?.[0] ?? -Infinity;
    if (at_s <= last_s) {
      if (at_s > last_s - 1) return;
      this.points = []; // a replay went back
    }
    this.points.push([at_s, rpm]);
    const old = this.points.findIndex(([each]) => each >= at_s - SPAN_S);
    this.points.splice(0, Math.max(old, this.points.length - POINTS_MOST, 0));
    const known = this.points.map(([, each]) => each ?? 0);
    [this.lowest, this.highest] = [Math.min(0, ...known), Math.max(0, ...known)];
    text(this.value, `${this.side === "port" ? "P" : "S"} ${rpm === null ? "–" : Math.round(rpm)}`);
    this.root.classList.toggle("unknown", rpm === null);
  }

  draw(at_s: number, least: number, most: number): void {
    const [was_s, ...was] = this.shown as [number, number, number];
    const moved = ((at_s - was_s) / SPAN_S) * this.wide;
    if (moved >= 0 && moved < 1 && was.join() === [least, most].join()) return; // less than a pixel
    this.shown = [at_s, least, most];
    this.repaint();
  }

  repaint(): void {
    if (!this.wide) return;
    const [{ width, height }, [at_s, least, most], pen] = [this.canvas, this.shown as [number, number, number], this.canvas.getContext("2d")!];
    const [margin, wide] = [3 * devicePixelRatio, 1.6 * devicePixelRatio];
    const x = (each_s: number) => width * (1 + (each_s - at_s) / SPAN_S);
    const y = (rpm: number) => margin + ((most - rpm) / (most - least)) * (height - 2 * margin);
    const zero = Math.round(y(0));
    pen.clearRect(0, 0, width, height);
    pen.fillStyle = palette.soft;
    pen.fillRect(0, zero, width, devicePixelRatio);
    const [line, area] = [new Path2D(), new Path2D()];
    this.points.forEach(([each_s, rpm], i) => {
      const [before_s, before] = this.points[i - 1] ?? [0, null];
      if (rpm === null || before === null) return;
      line.moveTo(x(before_s), y(before));
      line.lineTo(x(each_s), y(rpm));
      area.moveTo(x(before_s), zero);
      for (const [across, down] of [[x(before_s), y(before)], [x(each_s), y(rpm)], [x(each_s), zero]] as const) area.lineTo(across, down);
    });
    pen.fillStyle = `${palette.soft}33`;
    pen.fill(area);
    [pen.strokeStyle, pen.lineWidth, pen.lineCap] = [palette.ink, wide, "round"];
    pen.stroke(line);
  }
}
