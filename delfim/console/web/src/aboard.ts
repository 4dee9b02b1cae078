// What is kept aboard, or planned, beside the waypoints: fence, obstacles, zones, home.
import Feature from "ol/Feature";
import { type Geometry, LineString, Point } from "ol/geom";
import Polygon, { circular } from "ol/geom/Polygon";
import { Circle as Disc, Fill, Stroke, Style, Text } from "ol/style";
import { point } from "./chart";
import { FACE, cased, palette } from "./palette";
import type { Boat, Place } from "./wire";

export function keptAboard(kept: Pick<Boat, "fence" | "obstacles" | "zones" | "home">, planned = false): Feature[] {
  const made: Feature[] = [];
  const dash = planned ? { lineDash: [6, 5] } : {};
  const line = (way: Geometry) => {
    const edge = new Feature(way);
    edge.setStyle(cased(palette.limit, 2, planned ? [10, 6] : undefined));
    made.push(edge);
  };
  const filled = (area: Geometry) => {
    const out = new Feature(area);
    out.setStyle(new Style({ fill: new Fill({ color: palette.limitback }), stroke: new Stroke({ color: palette.limit, width: 1.8, ...dash }) }));
    made.push(out);
  };
  const ring = (corners: [number, number][]) => [...corners, corners[0]!].map(([latitude_deg, longitude_deg]) => point({ latitude_deg, longitude_deg }));
  const disc = ({ latitude_deg, longitude_deg }: Place, radius_m: number) => circular([longitude_deg, latitude_deg], radius_m, 48).transform("EPSG:4326", "EPSG:3857") as Polygon;
  if (kept.fence.length > 2) line(new LineString(ring(kept.fence)));
  for (const each of kept.obstacles) filled(disc(each, each.radius_m));
  for (const { kind, polygon, centre, radius_m } of kept.zones ?? []) {
    const area = centre.length ? disc({ latitude_deg: centre[0]![0], longitude_deg: centre[0]![1] }, radius_m) : new Polygon([ring(polygon)]);
    if (kind === "keep_out") filled(area);
    else line(new LineString(area.getCoordinates()[0]!));
  }
  if (kept.home) {
    const home = new Feature(new Point(point(kept.home)));
    home.setStyle(
      new Style({
        image: new Disc({ radius: 10, fill: new Fill({ color: palette.handle }), stroke: new Stroke({ color: palette.soft, width: 2 }) }),
        text: new Text({ text: "H", font: `700 12px ${FACE}`, fill: new Fill({ color: palette.ink }), offsetY: 1 }),
      }),
    );
    made.push(home);
  }
  return made;
}
