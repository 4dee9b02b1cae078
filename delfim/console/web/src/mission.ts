// A plan for each boat: the working copy of its mission, with undo. Patterns are functions from a form to waypoints.
import { arc, bearing_deg, carried, distance_m, moved, step, towards } from "./geo";
import type { Step } from "./geo";
import type { Mission, Obstacle, PathPoint, Place, Waypoint } from "./wire";

const UNDO_MOST = 200;
const SPIRAL_STEP_DEG = 20;
const ARC_DEG = 5;
const JOINT_M = 1;
const TRACK_M = 2;
export const WAYPOINTS_MOST = 1000; // of a mission

export const waypoint = (place: Place): Waypoint => ({
  latitude_deg: place.latitude_deg,
  longitude_deg: place.longitude_deg,
  speed_mps: 0,
  acceptance_m: 0,
  hold_s: 0,
  turn: null,
});

export const UNNAMED = "aboard"; // the gateway's name for a mission whose name it does not know

export const empty = (name: string): Mission => ({ name, waypoints: [], fence: [], obstacles: [], home: null });

/** Whether two missions are equal, however their numbers are written. */
export function same(a: Mission, b: Mission): boolean {
  const at = ({ latitude_deg, longitude_deg }: Place) => [latitude_deg.toFixed(8), longitude_deg.toFixed(8)];
  const words = (mission: Mission) =>
    JSON.stringify([
      mission.name,
      mission.waypoints.map((each) => [at(each), each.speed_mps, each.acceptance_m, each.hold_s, each.tries ?? 0, each.actions ?? [], each.turn && [at(each.turn), each.turn.clockwise]]),
      mission.fence.map((each) => at(cornerPlace(each))),
      mission.obstacles.map((each) => [at(each), each.radius_m]),
      mission.home && at(mission.home),
      mission.path ?? [],
      mission.survey ?? null,
      (mission.zones ?? []).map((each) => [each.kind, each.polygon, each.centre, each.radius_m]),
    ]);
  return words(a) === words(b);
}

/** Whether a boat would sail both in the same way: a mission that is read back is rounded, and has no name. */
export function alike(a: Mission, b: Mission): boolean {
  const [one, other] = [figures(spoken(a)), figures(spoken(b))];
  return one.length === other.length && one.every((each, i) => Math.abs(each - other[i]!) < 1.5);
}

/** All numbers of a mission, in units of the rounding on the link. */
function figures({ waypoints, fence, obstacles, home, path: pieces = [], zones = [] }: Mission): number[] {
  const at = ({ latitude_deg, longitude_deg }: Place) => [latitude_deg * 1e7, longitude_deg * 1e7];
  const size = (many: unknown[]) => many.length * 1000;
  return [
    size(waypoints),
    ...waypoints.flatMap((each) => [...at(each), each.speed_mps * 100, each.acceptance_m * 10, each.hold_s * 10, (each.tries ?? 0) * 1000, ...actionFigures(each)]),
    size(pieces),
    ...pieces.flatMap((each) => [...at(each), (each.turn_deg ?? 0) * 10, (each.radius_m ?? 0) * 10, (each.speed_mps ?? 0) * 100]),
    size(fence),
    ...fence.flatMap((each) => at(cornerPlace(each))),
    size(obstacles),
    ...obstacles.flatMap((each) => [...at(each), each.radius_m * 10]),
    size(zones),
    ...zones.flatMap((each) => [...[...each.polygon, ...each.centre].flatMap((corner) => at(cornerPlace(corner))), each.radius_m * 10]),
    ...(home ? at(home) : []),
  ];
}

const actionFigures = ({ actions = [] }: Waypoint): number[] =>
  [actions.length * 1000, ...actions.flatMap(({ command, params }) => [command * 1000, ...params.map((each) => (each === "nan" ? -1e6 : each * 1000))])];

/** A mission and what it was before each change. */
export class Plan {
  private past: Mission[] = [];
  untouched = true; // nobody has planned anything: it is the boat's mission

  constructor(public mission: Mission) {}

  get undoable(): boolean {
    return this.past.length > 0;
  }

  change(next: Mission): void {
    this.untouched = false;
    this.past.push(this.mission);
    if (this.past.length > UNDO_MOST) this.past.shift();
    this.mission = next;
  }

  undo(): void {
    this.mission = this.past.pop() ?? this.mission;
  }
}

export function length_m(mission: Mission): number {
  return mission.waypoints.slice(1).reduce((sum, _, i) => sum + course_m(mission, i + 1), 0);
}

function course_m(mission: Mission, index: number): number {
  const points = leg(mission, index);
  return points.slice(1).reduce((sum, point, i) => sum + distance_m(points[i]!, point), 0);
}

/** The points of the leg that ends at this waypoint. */
export function leg(mission: Mission, index: number): Place[] {
  const [from, to] = [mission.waypoints[index - 1]!, mission.waypoints[index]!];
  return to.turn ? arc(from, to.turn, to, to.turn.clockwise) : [from, to];
}

/** A mission as the boat takes it: legs that turn become a path (docs/missions.md), which the boat follows in that mode. */
export function spoken(mission: Mission): Mission {
  const points = mission.waypoints;
  if (!points.some(({ turn }) => turn)) return mission;
  const pieces = points.map((to, i): PathPoint => {
    const at = { latitude_deg: to.latitude_deg, longitude_deg: to.longitude_deg, speed_mps: to.speed_mps };
    if (!to.turn || i === 0) return { ...at, turn_deg: 0, radius_m: 0 };
    const [from, { clockwise, ...centre }] = [points[i - 1]!, to.turn];
    const right = (bearing_deg(centre, to) - bearing_deg(centre, from) + 360) % 360;
    return { ...at, ...centre, turn_deg: clockwise ? right : right - 360, radius_m: distance_m(centre, from) };
  });
  return { ...mission, path: pieces };
}

/** The inverse: a path that leads through the waypoints is their legs; any other one stays a path of its own. */
export function understood(told: Mission): Mission {
  const mission = { ...told, fence: told.fence ?? [], obstacles: told.obstacles ?? [] }; // another program may leave them out
  const { path: pieces = [], waypoints } = mission;
  if (pieces.length !== waypoints.length || !pieces.some(({ turn_deg }) => turn_deg)) return mission;
  const ends = pieces.map((_, i) => path({ ...mission, path: pieces.slice(0, i + 1) }).at(-1)!);
  if (ends.some((end, i) => distance_m(end, waypoints[i]!) > JOINT_M)) return mission;
  const turned = waypoints.map((each, i) => {
    const { turn_deg, latitude_deg, longitude_deg } = pieces[i]!;
    return { ...each, turn: turn_deg ? { latitude_deg, longitude_deg, clockwise: turn_deg > 0 } : null };
  });
  return { ...mission, waypoints: turned, path: [] };
}

/** The points of the mission's own path, if it has one. */
export function path(mission: Mission): Place[] {
  const [begin, ...pieces] = mission.path ?? [];
  if (!begin) return [];
  const points: Place[] = [begin];
  for (const piece of pieces) {
    const from = points.at(-1)!;
    if (!piece.turn_deg) points.push(piece);
    else {
      const [first, radius_m] = [bearing_deg(piece, from), distance_m(piece, from)];
      const count = Math.ceil(Math.abs(piece.turn_deg) / ARC_DEG);
      for (let i = 1; i <= count; i++) points.push(towards(piece, first + (piece.turn_deg * i) / count, radius_m));
    }
  }
  return points;
}

const replaced = <T>(list: T[], index: number, item: T): T[] => list.map((each, i) => (i === index ? item : each));
const without = <T>(list: T[], index: number): T[] => list.filter((_, i) => i !== index);

export function insertWaypoint(mission: Mission, index: number, place: Place): Mission {
  const like = mission.waypoints[Math.min(index, mission.waypoints.length - 1)];
  const fresh = { ...waypoint(place), speed_mps: like?.speed_mps ?? 0, acceptance_m: like?.acceptance_m ?? 0 };
  const waypoints = mission.waypoints.toSpliced(index, 0, fresh);
  return { ...mission, waypoints: waypoints.map((each, i) => (i === index + 1 ? { ...each, turn: null } : each)) };
}

/** Where in the order a point at this place costs the least detour. */
export function bestIndex(mission: Mission, place: Place): number {
  const points = mission.waypoints;
  let [best, least] = [points.length, points.length ? distance_m(points.at(-1)!, place) : 0];
  for (let i = 1; i < points.length; i++) {
    const detour = distance_m(points[i - 1]!, place) + distance_m(place, points[i]!) - distance_m(points[i - 1]!, points[i]!);
    if (detour < least) [best, least] = [i, detour];
  }
  return best;
}

export function moveWaypoint(mission: Mission, index: number, place: Place): Mission {
  const before = mission.waypoints;
  const after = replaced(before, index, { ...before[index]!, latitude_deg: place.latitude_deg, longitude_deg: place.longitude_deg });
  const turned = after.map((each, i) => {
    if (!each.turn || i === 0 || (i !== index && i !== index + 1)) return each;
    return { ...each, turn: { ...carried(each.turn, before[i - 1]!, before[i]!, after[i - 1]!, each), clockwise: each.turn.clockwise } };
  });
  return { ...mission, waypoints: turned };
}

export function deleteWaypoint(mission: Mission, index: number): Mission {
  const waypoints = without(mission.waypoints, index).map((each, i) => (i === index || i === 0 ? { ...each, turn: null } : each));
  return { ...mission, waypoints };
}

/** Exchange a waypoint with its neighbour, -1 or +1 in the order; legs become lines again where they no longer fit. */
export function reorderWaypoint(mission: Mission, index: number, by: -1 | 1): Mission {
  const waypoints = [...mission.waypoints];
  const [first, second] = [Math.min(index, index + by), Math.max(index, index + by)];
  [waypoints[first], waypoints[second]] = [waypoints[second]!, waypoints[first]!];
  return { ...mission, waypoints: waypoints.map((each, i) => (i >= first && i <= second + 1 ? { ...each, turn: null } : each)) };
}

export function setWaypoint(mission: Mission, index: number, changes: Partial<Waypoint>): Mission {
  return { ...mission, waypoints: replaced(mission.waypoints, index, { ...mission.waypoints[index]!, ...changes }) };
}

export function setAll(mission: Mission, changes: Partial<Pick<Waypoint, "speed_mps" | "acceptance_m">>): Mission {
  return { ...mission, waypoints: mission.waypoints.map((each) => ({ ...each, ...changes })) };
}

/** The leg to this waypoint as half a circle. */
export function halfCircle(mission: Mission, index: number, clockwise: boolean): Mission {
  const [from, to] = [mission.waypoints[index - 1]!, mission.waypoints[index]!];
  const half = step(from, to);
  const centre = moved(from, { north_m: half.north_m / 2, east_m: half.east_m / 2 });
  return setWaypoint(mission, index, { turn: { ...centre, clockwise } });
}

export const setObstacle = (mission: Mission, index: number, to: Obstacle): Mission => ({
  ...mission,
  obstacles: index < mission.obstacles.length ? replaced(mission.obstacles, index, to) : [...mission.obstacles, to],
});
export const deleteObstacle = (mission: Mission, index: number): Mission => ({ ...mission, obstacles: without(mission.obstacles, index) });

const corner = (place: Place): [number, number] => [place.latitude_deg, place.longitude_deg];
export const cornerPlace = ([latitude_deg, longitude_deg]: [number, number]): Place => ({ latitude_deg, longitude_deg });

export const moveCorner = (mission: Mission, index: number, place: Place): Mission => ({
  ...mission,
  fence: replaced(mission.fence, index, corner(place)),
});
export const deleteCorner = (mission: Mission, index: number): Mission => ({
  ...mission,
  fence: mission.fence.length > 3 ? without(mission.fence, index) : [],
});

/** Insert a corner between the two neighbours for which the detour is least. */
export function insertCorner(mission: Mission, place: Place, index?: number): Mission {
  const corners = mission.fence.map(cornerPlace);
  let [best, least] = [corners.length, Infinity];
  corners.forEach((each, i) => {
    const next = corners[(i + 1) % corners.length]!;
    const detour = distance_m(each, place) + distance_m(place, next) - distance_m(each, next);
    if (detour < least) [best, least] = [i + 1, detour];
  });
  return { ...mission, fence: mission.fence.toSpliced(index ?? best, 0, corner(place)) };
}

/** A square around a place, to begin a fence with. */
export const squareFence = (mission: Mission, centre: Place, side_m: number): Mission => ({
  ...mission,
  fence: [45, 135, 225, 315].map((deg) => corner(towards(centre, deg, (side_m / 2) * Math.SQRT2))),
});

/** Parallel tracks over a rectangle whose middle is `centre`; the tracks run along `heading_deg`. */
export function lawnMower(centre: Place, length: number, width: number, spacing: number, heading_deg: number): Waypoint[] {
  const tracks = Math.max(1, Math.floor(width / spacing + 1e-9) + 1);
  const first = (-(tracks - 1) * spacing) / 2;
  return Array.from({ length: tracks }, (_, i) => {
    const side = towards(centre, heading_deg + 90, first + i * spacing);
    const ends = [towards(side, heading_deg, -length / 2), towards(side, heading_deg, length / 2)];
    return i % 2 ? ends.reverse() : ends;
  })
    .flat()
    .map(waypoint);
}

/** Once around, as two half circles; it begins and ends on the side of `from`. */
export function circle(centre: Place, radius: number, from_deg: number, clockwise: boolean): Waypoint[] {
  const [near, far] = [waypoint(towards(centre, from_deg, radius)), waypoint(towards(centre, from_deg + 180, radius))];
  const turn = { ...centre, clockwise };
  return [near, { ...far, turn }, { ...near, turn }];
}

/** From the middle outwards, `spacing` apart, until `radius` is reached. */
export function spiral(centre: Place, radius: number, spacing: number, from_deg: number, clockwise: boolean): Waypoint[] {
  const turn = clockwise ? SPIRAL_STEP_DEG : -SPIRAL_STEP_DEG;
  const points = [waypoint(centre)];
  for (let i = 1; (spacing * i * SPIRAL_STEP_DEG) / 360 <= radius; i++) {
    const out = (spacing * i * SPIRAL_STEP_DEG) / 360;
    if (out >= spacing / 2) points.push(waypoint(towards(centre, from_deg + i * turn, out)));
  }
  return points;
}

/** A track as waypoints, as few as keep it within a few metres, and WAYPOINTS_MOST at most. Douglas and Peucker's. */
export function retraced(track: Place[], within_m = TRACK_M): Waypoint[] {
  const steps = track.map((each) => step(track[0]!, each));
  const kept = new Set([0, track.length - 1]);
  const stack: [number, number][] = [[0, track.length - 1]];
  for (let part = stack.pop(); part; part = stack.pop()) {
    const [from, to] = part;
    let [worst, most_m] = [0, within_m];
    for (let i = from + 1; i < to; i++) {
      const off_m = aside_m(steps[i]!, steps[from]!, steps[to]!);
      if (off_m > most_m) [worst, most_m] = [i, off_m];
    }
    if (worst) stack.push([from, worst], [worst, to]);
    kept.add(worst);
  }
  const few = track.filter((_, i) => kept.has(i)).filter((each, i, all) => !i || distance_m(all[i - 1]!, each) > TRACK_M / 2);
  return few.length > WAYPOINTS_MOST ? retraced(track, 2 * within_m) : few.map(waypoint);
}

/** How far a point is from the line between two others. */
function aside_m(point: Step, from: Step, to: Step): number {
  const [north, east] = [to.north_m - from.north_m, to.east_m - from.east_m];
  const [up, right] = [point.north_m - from.north_m, point.east_m - from.east_m];
  const along = Math.max(0, Math.min(1, (up * north + right * east) / (north * north + east * east || 1)));
  return Math.hypot(up - along * north, right - along * east);
}

/** The heading of a mission's longest leg, to begin a pattern with. */
export function mainHeading_deg(mission: Mission): number {
  let [heading, longest] = [0, 0];
  mission.waypoints.slice(1).forEach((to, i) => {
    const from = mission.waypoints[i]!;
    if (distance_m(from, to) > longest) [heading, longest] = [bearing_deg(from, to), distance_m(from, to)];
  });
  return Math.round(heading / 5) * 5;
}
