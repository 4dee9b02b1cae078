// Patterns of waypoints: lawn-mower, circle, spiral. A plan remembers what each was made of, so that it can be changed as one
// for as long as its waypoints are where the pattern put them.
import { bearing, distance_m } from "./geo";
import { circle, lawnMower, mainHeading_deg, spiral } from "./mission";
import type { Field } from "./form";
import type { Mission, Pattern, Place, Waypoint } from "./wire";

const SAME_M = 0.02; // coordinates may be rounded on their way
const FAR_M = 20_000;

const metres = (title: string, value: number, least: number, step = 5): Field => ({ title, unit: "m", value, step, least, most: FAR_M });
const side = (value: number): Field => ({ title: "Turning to", unit: "", value, step: 1, least: 0, most: 1, zero: "port", show: () => "starboard" });
const along = (value: number): Field => ({ title: "Along", unit: "°", value, step: 5, least: 0, most: 360, around: true, show: bearing });

interface Kind {
  title: string;
  begin: number[]; // values
  fields(values: number[]): Field[];
  made(pattern: Pattern): Waypoint[];
}

export const KINDS: Readonly<Record<Pattern["kind"], Kind>> = {
  lawn: {
    title: "Lawn-mower",
    begin: [100, 60, 15, 0],
    fields: ([length, width, spacing, heading]) => [metres("Length", length!, 10), metres("Width", width!, 0), metres("Spacing", spacing!, 2, 1), along(heading!)],
    made: ({ centre, values: [length, width, spacing, heading] }) => lawnMower(centre, length!, width!, spacing!, heading!),
  },
  circle: {
    title: "Circle",
    begin: [40, 1],
    fields: ([radius, turn]) => [metres("Radius", radius!, 5), side(turn!)],
    made: ({ centre, from_deg, values: [radius, turn] }) => circle(centre, radius!, from_deg, turn === 1),
  },
  spiral: {
    title: "Spiral",
    begin: [40, 10, 1],
    fields: ([radius, spacing, turn]) => [metres("Radius", radius!, 5), metres("Spacing", spacing!, 2, 1), side(turn!)],
    made: ({ centre, from_deg, values: [radius, spacing, turn] }) => spiral(centre, radius!, spacing!, from_deg, turn === 1),
  },
};

/** A new one; a lawn-mower along the mission's longest leg. */
export function newPattern(kind: Pattern["kind"], centre: Place, from_deg: number, mission: Mission): Pattern {
  const values = kind === "lawn" ? [...KINDS.lawn.begin.slice(0, 3), mainHeading_deg(mission)] : KINDS[kind].begin;
  return { kind, centre: { latitude_deg: centre.latitude_deg, longitude_deg: centre.longitude_deg }, from_deg, values };
}

/** The mission with this pattern at the end, or in place of an earlier one; speeds and the like are those of that one's first waypoint. */
export function withPattern(mission: Mission, pattern: Pattern, instead?: Found): Mission {
  const [first, count] = instead ? [instead.first, instead.count] : [mission.waypoints.length, 0];
  const { speed_mps, acceptance_m, hold_s } = (count && mission.waypoints[first]) || { speed_mps: 0, acceptance_m: 0, hold_s: 0 };
  const fresh = KINDS[pattern.kind].made(pattern).map((each) => ({ ...each, speed_mps, acceptance_m, hold_s }));
  const kept = (mission.patterns ?? []).filter((each) => each !== instead?.pattern);
  return { ...mission, waypoints: mission.waypoints.toSpliced(first, count, ...fresh), patterns: [...kept, pattern] };
}

export interface Found {
  pattern: Pattern;
  first: number;
  count: number;
}

/** The pattern that this waypoint belongs to. */
export function patternAt({ waypoints, patterns = [] }: Mission, index: number): Found | null {
  for (const pattern of patterns) {
    const made = KINDS[pattern.kind].made(pattern);
    for (let first = Math.max(0, index - made.length + 1); first <= index && first + made.length <= waypoints.length; first++) {
      if (made.every((each, i) => distance_m(each, waypoints[first + i]!) < SAME_M)) return { pattern, first, count: made.length };
    }
  }
  return null;
}
