// A plane tangent to the Earth at some place, for distances and patterns of a few kilometres; and words for numbers.
import type { Place } from "./wire";

const A_M = 6378137.0; // WGS 84
const E2 = 6.69437999014e-3;
const RAD = Math.PI / 180;

export interface Step {
  north_m: number;
  east_m: number;
}

/** Metres for a degree of latitude and of longitude at this latitude. */
function scale(latitude_deg: number): [number, number] {
  const sine = Math.sin(latitude_deg * RAD);
  const w = Math.sqrt(1 - E2 * sine * sine);
  return [((A_M * (1 - E2)) / w ** 3) * RAD, (A_M / w) * Math.cos(latitude_deg * RAD) * RAD];
}

export function step(from: Place, to: Place): Step {
  const [lat, lon] = scale((from.latitude_deg + to.latitude_deg) / 2);
  return { north_m: (to.latitude_deg - from.latitude_deg) * lat, east_m: (to.longitude_deg - from.longitude_deg) * lon };
}

export function moved(from: Place, { north_m, east_m }: Step): Place {
  const [lat] = scale(from.latitude_deg);
  const latitude_deg = from.latitude_deg + north_m / lat;
  const [, lon] = scale((from.latitude_deg + latitude_deg) / 2);
  return { latitude_deg, longitude_deg: from.longitude_deg + east_m / lon };
}

export function towards(from: Place, bearing_deg: number, distance_m: number): Place {
  return moved(from, { north_m: Math.cos(bearing_deg * RAD) * distance_m, east_m: Math.sin(bearing_deg * RAD) * distance_m });
}

/** So far ahead and to starboard of a place, as one sees it there on this heading. */
export function beside(from: Place, heading_deg: number, ahead_m: number, right_m: number): Place {
  const [north, east] = [Math.cos(heading_deg * RAD), Math.sin(heading_deg * RAD)];
  return moved(from, { north_m: ahead_m * north - right_m * east, east_m: ahead_m * east + right_m * north });
}

export function distance_m(from: Place, to: Place): number {
  const { north_m, east_m } = step(from, to);
  return Math.hypot(north_m, east_m);
}

export function bearing_deg(from: Place, to: Place): number {
  const { north_m, east_m } = step(from, to);
  return (Math.atan2(east_m, north_m) / RAD + 360) % 360;
}

/** Points of the arc around a centre from one place to another. */
export function arc(from: Place, centre: Place, to: Place, clockwise: boolean, every_deg = 5): Place[] {
  const radius_m = distance_m(centre, from);
  const first = bearing_deg(centre, from);
  let turn = (bearing_deg(centre, to) - first + 360) % 360;
  if (!clockwise) turn -= 360;
  const count = Math.max(2, Math.ceil(Math.abs(turn) / every_deg));
  return Array.from({ length: count + 1 }, (_, i) => towards(centre, first + (turn * i) / count, radius_m));
}

/** Where `place` lies when the leg a-b, with everything beside it, is moved, turned and stretched onto the leg c-d. */
export function carried(place: Place, a: Place, b: Place, c: Place, d: Place): Place {
  const leg = step(a, b);
  const beside = step(a, place);
  const length2 = leg.north_m ** 2 + leg.east_m ** 2 || 1;
  const along = (beside.north_m * leg.north_m + beside.east_m * leg.east_m) / length2;
  const right = (beside.east_m * leg.north_m - beside.north_m * leg.east_m) / length2;
  const next = step(c, d);
  return moved(c, { north_m: along * next.north_m - right * next.east_m, east_m: along * next.east_m + right * next.north_m });
}

export function metres(m: number): string {
  if (m >= 10_000) return `${(m / 1000).toFixed(1)} km`;
  if (m >= 1000) return `${(m / 1000).toFixed(2)} km`;
  return m >= 100 ? `${m.toFixed(0)} m` : `${m.toFixed(1)} m`;
}

export function bearing(deg: number): string {
  return `${String(Math.round(deg) % 360).padStart(3, "0")}°`;
}

export function duration(s: number): string {
  if (Math.round(s) < 60) return `${Math.round(s)} s`;
  const minutes = Math.floor(Math.round(s) / 60);
  const rest = String(Math.round(s) % 60).padStart(2, "0");
  if (minutes < 60) return `${minutes} min ${rest} s`;
  return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min`;
}

/** Degrees and decimal minutes, as on a chart. */
export function position({ latitude_deg, longitude_deg }: Place): string {
  const part = (deg: number, width: number, letters: string) => {
    const size = Math.abs(deg);
    const whole = Math.floor(size);
    const minutes = ((size - whole) * 60).toFixed(3).padStart(6, "0");
    return `${String(whole).padStart(width, "0")}° ${minutes}′ ${letters[deg < 0 ? 1 : 0]}`;
  };
  return `${part(latitude_deg, 2, "NS")}  ${part(longitude_deg, 3, "EW")}`;
}

/** Degrees as people write them: 38.69, -9.215, 38°41.234′N, N 38 41 14. `letters` are those of its two directions. */
export function degreesIn(words: string, letters: string): number | null {
  const found = new RegExp(`^\\s*([-+]?)([${letters}]?)((?:[^\\d.,${letters}]*\\d+(?:[.,]\\d*)?){1,3})[^\\d${letters}]*([${letters}]?)\\s*$`, "i").exec(words);
  const [, sign, before, figures, after] = found ?? [];
  const parts = (figures ?? "").match(/\d+(?:[.,]\d*)?/g)?.map((each) => Number(each.replace(",", "."))) ?? [];
  const letter = (before || after || "").toUpperCase();
  if (!parts.length || (before && after) || (sign === "-" && letter) || parts.slice(1).some((each) => each >= 60)) return null;
  const size = parts.reduce((sum, each, i) => sum + each / 60 ** i, 0);
  return sign === "-" || letter === letters[1] ? -size : size;
}
