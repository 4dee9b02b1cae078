// The hull of a boat or vessel on the map: to scale where that is larger than its symbol, with a line ahead where its heading is known.
import type { FeatureLike } from "ol/Feature";
import { GeometryCollection, LineString, Polygon } from "ol/geom";
import { Fill, Stroke, Style } from "ol/style";
import { point } from "./chart";
import { beside } from "./geo";
import { palette } from "./palette";
import type { Place } from "./wire";

const LEAST_PX = 44; // shorter, it is a symbol
const OUTLINE = [[0.5, 0], [0.34, 0.3], [0.08, 0.5], [-0.5, 0.42]] as const; // of its starboard side: ahead and abeam, of length and beam

export interface Hull {
  shape: GeometryCollection;
  long: number; // in units of the map
}

export function hull(place: Place, heading_deg: number, { length_m, beam_m }: { length_m: number; beam_m: number }): Hull {
  const at = (ahead: number, right: number) => point(beside(place, heading_deg, ahead * length_m, right * beam_m));
  const ring = [...OUTLINE, ...OUTLINE.toReversed().map(([ahead, right]) => [ahead, -right] as const)].map((each) => at(...each));
  const line = [at(0.5, 0), at(1, 0)] as const;
  return { shape: new GeometryCollection([new Polygon([[...ring, ring[0]!]]), new LineString([...line])]), long: 2 * Math.hypot(line[1][0]! - line[0][0]!, line[1][1]! - line[0][1]!) };
}

/** How long it is drawn, in pixels; 0: it is a symbol. */
export const long_px = (its: Hull | null | undefined, resolution: number): number => (its && its.long >= LEAST_PX * resolution ? its.long / resolution : 0);

/** The hull to scale where `its` is known and near enough, the symbol otherwise. */
export function drawn(its: () => Hull | null, symbol: Style[], solid: Style[]): (feature: FeatureLike, resolution: number) => Style[] {
  return (_, resolution) => {
    const near = its();
    if (!near || !long_px(near, resolution)) return symbol;
    for (const each of solid) each.setGeometry(near.shape);
    return [...solid, ...symbol.filter((each) => each.getText()).map((each) => new Style({ text: each.getText()!, zIndex: each.getZIndex() }))];
  };
}

export const outlined = (fill: string, ink: string, zIndex: number, lineDash?: number[]): Style[] => [
  new Style({ stroke: new Stroke({ color: palette.halo, width: 6 }), zIndex }),
  new Style({ fill: new Fill({ color: fill }), stroke: new Stroke({ color: ink, width: 2.4, lineDash }), zIndex }),
];
