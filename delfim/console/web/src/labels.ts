// Where names stand on the map: beside what they name, or, where others stand there already, aside with a thin line to it.
import Feature from "ol/Feature";
import { LineString } from "ol/geom";
import type { Text } from "ol/style";
import type { Chart, Pixel } from "./chart";
import { cased, palette } from "./palette";

const LETTER_PX = 8;
const LINE_PX = 18;
const MARK_PX = 12; // radius of a waypoint's disc
const LEAD_PX = 26; // from a symbol to where its line begins

export interface Side {
  x: number;
  y: number;
  align: "left" | "right" | "center";
  lead?: boolean;
}

/** Places beside a symbol, the nearest first. */
export const SIDES: readonly [Side, ...Side[]] = [
  { x: 24, y: 0, align: "left" },
  { x: -24, y: 0, align: "right" },
  { x: 0, y: 36, align: "center" },
  { x: 0, y: -36, align: "center" },
  ...[1, 1.7, 2.4].flatMap((far): Side[] =>
    [-1, 1].flatMap((up): Side[] => [
      { x: 56 * far, y: 40 * far * up, align: "left", lead: true },
      { x: -56 * far, y: 40 * far * up, align: "right", lead: true },
    ]),
  ),
];

/** A place for a name near this pixel that covers none of the marks, and covers none itself once it is taken; null: there is none. */
export function sideFor(its: Pixel, words: string, sides: readonly Side[], marks: Pixel[]): Side | null {
  const wide = LETTER_PX * Math.max(...words.split("\n").map((each) => each.length));
  const left = ({ x, align }: Side) => its[0] + x - (align === "left" ? 0 : align === "right" ? wide : wide / 2);
  const free = (side: Side) =>
    !marks.some(([i, j]) => Math.abs(j - its[1] - side.y) < LINE_PX / 2 + MARK_PX && i > left(side) - MARK_PX && i < left(side) + wide + MARK_PX);
  const found = sides.find(free) ?? null;
  if (found) for (let x = 0; x <= wide; x += LINE_PX) marks.push([left(found) + x, its[1] + found.y]);
  return found;
}

export function stand(text: Text, { x, y, align }: Side): void {
  text.setOffsetX(x);
  text.setOffsetY(y);
  text.setTextAlign(align);
}

/** The line from a symbol to its name. */
export function leader(chart: Chart, its: Pixel, { x, y }: Side): LineString {
  const part = LEAD_PX / Math.hypot(x, y);
  return new LineString([chart.coordinateAt([its[0] + part * x, its[1] + part * y]), chart.coordinateAt([its[0] + x, its[1] + y])]);
}

export function drawnLeader(): Feature<LineString> {
  const feature = new Feature<LineString>();
  feature.setStyle(() => cased(palette.soft, 1));
  return feature;
}
