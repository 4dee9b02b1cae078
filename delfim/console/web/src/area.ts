// The areas of a survey as parts of a plan: outlines and holes, with the same changes as a fence has.
import { distance_m, towards } from "./geo";
import { cornerPlace } from "./mission";
import type { Area, Line, Mission, Place, Ring } from "./wire";

/** A ring of a plan's areas; `hole` counts from 0, -1 is the outline. */
export interface RingOf {
  area: number;
  hole: number;
  corners: Ring;
}

export const corner = (place: Place): [number, number] => [place.latitude_deg, place.longitude_deg];

export const areasOf = (mission: Mission): Area[] => mission.survey?.areas ?? [];

/** The lines of the survey that the plan sails, or sails the rest of. Those of a mission that was read from a boat are its legs with a number. */
export const linesOf = ({ survey, waypoints }: Mission): Line[] => survey?.lines ?? linesSailed(waypoints);

function linesSailed(waypoints: Mission["waypoints"]): Line[] {
  const lines = new Map<number, Line>(); // one that ends at a hole has two legs
  waypoints.forEach((to, i) => i && to.line && lines.set(to.line, [lines.get(to.line)?.[0] ?? corner(waypoints[i - 1]!), corner(to)]));
  return [...lines.values()];
}

/** Whether hundreds of numbers would hide its lines. */
export const isSurvey = (mission: Mission): boolean => linesOf(mission).length > 0;

export const named = (mission: Mission): string => (isSurvey(mission) ? "survey" : "mission");

/** What a plan has, in words. */
export function counted(mission: Mission): string {
  const lines = new Set(mission.waypoints.flatMap(({ line }) => line || [])).size; // one that ends at a hole has two legs
  const [count, word] = isSurvey(mission) && lines ? [lines, "line"] : [mission.waypoints.length, "waypoint"];
  return `${count} ${word}${count === 1 ? "" : "s"}`;
}

/** All rings in their order, by which handles name them. */
export function ringsOf(mission: Mission): RingOf[] {
  return areasOf(mission).flatMap(([outline, holes], area) => [{ area, hole: -1, corners: outline }, ...holes.map((corners, hole) => ({ area, hole, corners }))]);
}

export function withAreas(mission: Mission, areas: Area[]): Mission {
  const { survey, ...rest } = mission;
  return areas.length ? { ...rest, survey: { values: [], ...survey, areas } } : rest;
}

/** The plan with another ring in place of this one; one of fewer than three corners is gone, with its holes if it is an outline. */
function withRing(mission: Mission, ring: number, corners: Ring): Mission {
  const { area, hole } = ringsOf(mission)[ring]!;
  const areas = areasOf(mission).flatMap((each, i): Area[] => {
    if (i !== area) return [each];
    const [outline, holes] = each;
    if (hole < 0) return corners.length < 3 ? [] : [[corners, holes]];
    return [[outline, corners.length < 3 ? holes.toSpliced(hole, 1) : holes.with(hole, corners)]];
  });
  return withAreas(mission, areas);
}

export const moveRingCorner = (mission: Mission, ring: number, index: number, to: Place): Mission =>
  withRing(mission, ring, ringsOf(mission)[ring]!.corners.with(index, corner(to)));
export const insertRingCorner = (mission: Mission, ring: number, index: number, to: Place): Mission =>
  withRing(mission, ring, ringsOf(mission)[ring]!.corners.toSpliced(index, 0, corner(to)));
export const deleteRingCorner = (mission: Mission, ring: number, index: number): Mission =>
  withRing(mission, ring, ringsOf(mission)[ring]!.corners.toSpliced(index, 1));
export const deleteRing = (mission: Mission, ring: number): Mission => withRing(mission, ring, []);

/** A square to begin with. */
export const square = (centre: Place, side_m: number): Ring => [45, 135, 225, 315].map((deg) => corner(towards(centre, deg, (side_m / 2) * Math.SQRT2)));

/** A hole in the area that has its middle, or else in the nearest one. */
export function withHole(mission: Mission, hole: Ring, middle: Place): Mission {
  const areas = areasOf(mission);
  const near_m = (ring: Ring) => Math.min(...ring.map((each) => distance_m(cornerPlace(each), middle)));
  const inside = areas.findIndex(([outline]) => isInside(outline, middle));
  const best = inside >= 0 ? inside : areas.reduce((least, [outline], i) => (near_m(outline) < near_m(areas[least]![0]) ? i : least), 0);
  return withAreas(mission, areas.map(([outline, holes], i) => [outline, i === best ? [...holes, hole] : holes]));
}

/** Whether a place lies in a ring: an even number of its sides is to the east of it, or an odd one. */
export function isInside(ring: Ring, { latitude_deg, longitude_deg }: Place): boolean {
  let inside = false;
  ring.forEach(([lat, lon], i) => {
    const [toLat, toLon] = ring[(i + 1) % ring.length]!;
    if (lat > latitude_deg !== toLat > latitude_deg && longitude_deg < lon + ((latitude_deg - lat) * (toLon - lon)) / (toLat - lat)) inside = !inside;
  });
  return inside;
}
