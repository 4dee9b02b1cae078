// Official charts as `delfim charts` makes them: depths in blues, what is forbidden in red, each danger with its reason.
import type { FeatureLike } from "ol/Feature";
import GeoJSON from "ol/format/GeoJSON";
import VectorImageLayer from "ol/layer/VectorImage";
import VectorSource from "ol/source/Vector";
import { Circle, Fill, Stroke, Style } from "ol/style";
import { palette } from "./palette";

const TAP_PX = 14;
const STEPS_M = [0, 2, 5, 10]; // from which depth on water has the next blue

export class DangerLayer extends VectorImageLayer<VectorSource> {
  constructor(url: string) {
    const source = new VectorSource({ url, format: new GeoJSON({ featureProjection: "EPSG:3857" }), wrapX: false }) as VectorSource;
    super({ source, zIndex: 0, style: drawn, imageRatio: 1.5, className: "dangers" }); // a canvas of its own: on a shared one it covers what lies above
  }

  /** Why a place is forbidden, in words; null: it is not. The nearest danger is the reason, and a point that is hit before an area. */
  why(at: number[], resolution: number, within_m = 1): string | null {
    const source = this.getSource()!;
    const forbidden = source.getClosestFeatureToCoordinate(at, (each) => each.get("kind") === "no-go")?.getGeometry()?.getClosestPoint(at);
    const forbids = forbidden !== undefined && Math.hypot(forbidden[0]! - at[0]!, forbidden[1]! - at[1]!) < within_m;
    const isPoint = (each: FeatureLike) => each.get("kind") === "danger" && each.getGeometry()!.getType() === "Point";
    const near = source.getClosestFeatureToCoordinate(at, isPoint);
    const [x, y] = near?.getGeometry()?.getClosestPoint(at) ?? [Infinity, Infinity];
    const hit = Math.hypot(x! - at[0]!, y! - at[1]!) < TAP_PX * resolution;
    const reason = hit ? near : forbids ? source.getClosestFeatureToCoordinate(at, (each) => each.get("kind") === "danger") : null;
    return reason ? String(reason.get("why")) : null;
  }
}

function drawn(each: FeatureLike): Style {
  const kind = each.get("kind") as string;
  if (kind === "depth") {
    const least_m = (each.get("least_m") as number | null) ?? 0;
    const blue = STEPS_M.filter((step) => least_m >= step).length;
    return new Style({ zIndex: 0, fill: new Fill({ color: least_m < 0 ? palette.land : palette.depths[Math.max(blue - 1, 0)]! }) });
  }
  if (kind === "no-go") return new Style({ zIndex: 2, fill: new Fill({ color: palette.forbidden }), stroke: new Stroke({ color: palette.limit, width: 1.5 }) });
  const stands = String(each.get("why")).startsWith("land");
  return new Style({
    zIndex: stands ? 3 : 4, // red is water
    ...(stands ? { fill: new Fill({ color: palette.land }) } : {}),
    stroke: new Stroke({ color: palette.soft, width: 1 }),
    image: new Circle({ radius: 3, fill: new Fill({ color: palette.limit }), stroke: new Stroke({ color: palette.halo, width: 1 }) }),
  });
}
