// The messages between gateway and page. Degrees, metres, metres a second, seconds, thrust in % of the maximum; port first.

export interface Place {
  latitude_deg: number;
  longitude_deg: number;
}

export interface Waypoint extends Place {
  speed_mps: number; // 0: as the vehicle's file says
  acceptance_m: number; // 0: as the vehicle's file says
  hold_s: number;
  line?: number; // of a survey, that the leg to it sails; 0: none
  tries?: number; // of a sample that is taken there, each for hold_s; 0: none is
  actions?: Action[]; // for payloads, once it is behind the boat
  turn: (Place & { clockwise: boolean }) | null; // centre of the arc that leads to this waypoint
}

/** An item of MAVLink that the boat carries for payloads: its number, and four of its own. */
export interface Action {
  command: number;
  params: (number | "nan")[];
}

/** What a boat said of a sample last. */
export interface Station {
  state: "waiting" | "sampled" | "failed";
  words: string;
}

export interface Obstacle extends Place {
  radius_m: number;
}

/** An area to stay in or out of that the page shows and does not edit: a polygon, or a circle. */
export interface Zone {
  kind: "keep_in" | "keep_out";
  name: string;
  polygon: [number, number][];
  centre: [number, number][];
  radius_m: number;
}

/** A piece of the path (docs/missions.md): its beginning, the end of a line, or the centre of an arc. */
export interface PathPoint extends Place {
  turn_deg?: number; // positive to starboard
  radius_m?: number;
  speed_mps?: number;
}

/** What a pattern's waypoints were made of, in the plan on the screen. */
export interface Pattern {
  kind: "lawn" | "circle" | "spiral";
  centre: Place;
  from_deg: number; // where a circle begins
  values: number[]; // of its form
}

export type Ring = [latitude_deg: number, longitude_deg: number][];
export type Area = [outline: Ring, holes: Ring[]];
export type Line = [begin: Ring[0], end: Ring[0]];

export interface Mission {
  name: string;
  waypoints: Waypoint[];
  fence: [number, number][];
  obstacles: Obstacle[];
  zones?: Zone[];
  home: Place | null;
  path?: PathPoint[]; // of its own, beside the waypoints
  patterns?: Pattern[];
  survey?: { areas: Area[]; values: number[]; lines?: Line[]; across?: number }; // what its lines were made of, in the plan on the screen; values of its form; all its lines, those across last
}

export type Pair = [number | null, number | null];
export type Mode = string; // from the list that the boat sends

export interface Energy {
  left_wh: number | null;
  home_wh: number | null;
  plan_wh: number | null; // of the plan, and home from its end
  reserve_wh: number | null;
  range_m: number[]; // how far it gets, by direction, from north clockwise; []: not known
}

/** Over all, and the revolutions a minute of its motors at full command; 0: not known. */
export interface Size {
  length_m: number;
  beam_m: number;
  rpm_max: number;
}

export interface Boat {
  id: number;
  name: string;
  colour: string;
  size?: Size | null; // null: it does not tell
  latitude_deg: number | null;
  longitude_deg: number | null;
  heading_deg: number | null;
  course_deg: number | null;
  speed_mps: number | null;
  mode: Mode | null;
  asked: Mode | null;
  modes: Mode[]; // of this boat
  orders?: Order[]; // that this boat offers
  armed: boolean;
  owner: boolean; // this console commands it, or nobody does
  commander: number; // the console that does; the boat's own number: its hand-set; 0: none
  twins: string[]; // addresses that use this boat's number, if more than one does
  ready: boolean;
  reason: string;
  reason_age_s?: number | null; // since it was said
  failsafe: string;
  forced?: string; // why it entered its mode by itself; "": it was told to
  rpm: Pair;
  thrust_pct: Pair;
  speed_pct: number | null;
  battery_v: number | null;
  battery_pct: number | null;
  roll_deg: number | null;
  pitch_deg: number | null;
  satellites: number | null;
  fix: string | null;
  energy?: Energy | null; // null: it reckons none
  measured?: Record<string, { value: number; age_s: number }>; // by sensors, by their names with units
  reference: {
    heading_deg: number | null;
    course_deg?: number | null;
    speed_mps?: number | null;
    latitude_deg: number | null;
    longitude_deg: number | null;
    cross_track_m: number | null;
    distance_m: number | null;
    leg: number | null;
    line?: number | null; // of a survey, from 1; 0: none
  } | null;
  age_s: Record<"heard" | "position" | "attitude" | "rpm" | "battery", number | null>;
  link: {
    kind: string;
    profile: string;
    rtt_ms: number | null;
    loss_pct: number | null;
    bytes_per_s: number | null;
    signed: boolean;
    all?: { kind: string; place: string; used: boolean; rtt_ms: number | null; loss_pct: number; age_s: number }[]; // links to it, several at once
  };
  mission: { name: string; count: number; current: number | null; state: "same" | "differs" | "unknown" | "none"; digest: string | null };
  lines_done?: number[]; // of the survey aboard
  stations?: Record<number, Station>; // of the mission aboard, by waypoints from 1
  home: Place | null;
  fence: [number, number][];
  obstacles: Obstacle[];
  zones?: Zone[];
  order?: { course_deg: number; words: string } | null; // that keeps it clear of another vessel
  guard?: string | null; // "on", "off", "cannot avoid"; null: it does not say
  ghost: (Place & { radius_m: number }) | null;
  released: boolean;
  driver: number; // the page of this console that drives it by hand; 0: none
}

/** What a boat has of a survey that several sail. */
export interface Share {
  lines: Line[];
  way: Ring;
  time_s: number;
  mission: Mission;
}

export type Gravity = "none" | "near" | "danger";

/** How near a vessel comes to a boat, if both keep course and speed. */
export interface Nearness {
  boat: number;
  cpa_m: number | null;
  tcpa_s: number | null; // negative: they draw apart
  nearness: number | null; // in domains
  danger: Gravity;
  words: string;
}

/** Another vessel, reckoned on to now. */
export interface Vessel extends Place {
  key: string;
  name: string;
  course_deg: number | null;
  speed_mps: number;
  heading_deg: number | null;
  length_m: number;
  beam_m: number;
  size_known: boolean;
  margin_m: number;
  kind: string; // "A", "B", "fleet", "payload", "distress", "thing", "person"
  status: number; // navigational status of ITU-R M.1371
  age_s: number;
  lost: boolean;
  domain_m: [number, number]; // half axes, ahead and abeam
  boats: Nearness[]; // the one that it meets first stands first
}

export interface Background {
  name: string;
  kind: "image" | "tiles" | "dangers"; // dangers: what `delfim charts` makes
  extent: [number, number, number, number];
  minzoom?: number;
  maxzoom?: number;
  made?: number; // of its content: another one is another chart
}

/** An order that a boat offers: its key of the keyboard, and the numbers that it asks for, whose names end with their units. */
export interface Order {
  command: string;
  name: string; // of a part's
  title: string;
  key: string;
  keys: [name: string, least: number, most: number, value: number][];
}

/** Keys of an order, in the boat's own words. */
export type Values = { [key: string]: number | string | Values };

/** Values over the time of a replay: [at_s, value] by name with unit. */
export type Graphs = Record<string, [number, number][]>;

/** A mark on a time line; a note is an operator's. */
export interface Event {
  at_s: number;
  boat: number | null; // null: of all
  severity: number;
  text: string;
  note?: boolean;
}

export interface TimeLine {
  from_s: number;
  to_s: number;
  events?: Event[];
}

/** What is wrong, or was, and was not acknowledged. */
export interface Alert {
  id: number;
  boat: number | null;
  priority: "emergency" | "alarm" | "warning" | "caution";
  text: string;
  at_s: number; // it began
  state: "unacknowledged" | "silenced" | "acknowledged" | "transferred" | "rectified";
  by: string; // who acknowledged it, silenced it, or answers for it
  sounds: boolean;
}

/** One that is over and was acknowledged. */
export interface Ended extends Alert {
  until_s: number;
}

/** Of the log of the watch. */
export interface WatchLine {
  at_s: number;
  boat: number | null;
  name: string;
  who: string;
  what: string; // a priority, "notice", "over", "order", "refused", "acknowledged", "silenced", "page"
  text: string;
}

/** A manoeuvre of a trial. */
export interface TrialStep {
  name: string;
  words: string;
  state: "under way" | "done" | "ended";
  reason: string;
  elapsed_s: number;
  far_m: number;
}

/** A line of what a boat tells of itself: a key of its file, or a check before the start, which is `refused` or not. */
export interface AboardRow {
  key: string;
  value: number | string | boolean | null;
  file: number | string | boolean | null;
  unit: string;
  allowed: string;
  meaning: string;
  words: string;
  refused: string;
}

/** The picture of a boat's camera, or why there is none. */
export interface Shot {
  boat: number;
  camera: string;
  cameras: string[];
  kbps: number;
  why: string;
  age_s?: number; // when it came
  same_s?: number; // since it was another one
  taken_s?: number; // since 1970, by the boat's clock
  jpeg?: string; // base64
  live?: boolean; // it is better seen by WebRTC now
}

/** A page's end of a connection by WebRTC. */
export interface Offer {
  payload: number;
  certificate: string; // hex
  user: string;
  password: string;
}

/** The boat's end, or why there is none. */
export interface Answer {
  boat: number;
  of: string; // user of the offer
  why: string;
  host: string;
  port: number;
  ssrc: number;
  certificate: string;
  user: string;
  password: string;
}

export type Heard =
  | { t: "hello"; version: string; built?: string; wakes?: boolean; me: number; page: number; heard_on?: string[]; adopts?: number | null; charts?: string; backgrounds: Background[]; boats: Boat[]; replay: TimeLine | null }
  | { t: "charts"; backgrounds: Background[] }
  | { t: "boats"; at_s: number; boats: Boat[] }
  | { t: "vessels"; at_s: number; vessels: Vessel[]; heard_s: number | null }
  | { t: "track"; boat: number; start?: boolean; points: [number, number, number][] }
  | { t: "whole_track"; boat: number; points: [number, number, number][] }
  | { t: "way_home"; boat: number; points: [number, number][]; whole: boolean; speed_mps?: number }
  | { t: "graphs"; boat: number; graphs: Graphs }
  | { t: "forgotten"; boat: number }
  | { t: "text"; boat: number | null; severity: number; text: string; at_s: number; alarm?: string }
  | { t: "alerts"; alerts: Alert[] }
  | { t: "bridge"; n: number; you: number; holder: number; granted: number; grant: number; offered: number; pages: { page: number; name: string; role: string; carries: boolean }[] }
  | { t: "ended"; alerts: Ended[]; all?: boolean }
  | { t: "log"; lines: WatchLine[]; all?: boolean }
  | { t: "answer"; seq: number; ok: boolean; reason: string; stage?: string }
  | { t: "mission"; boat: number; where: "here" | "aboard"; mission: Mission }
  | { t: "missions"; names: string[] }
  | { t: "survey"; boat: number; lines: Line[]; across: number; way: Ring; heading_deg: number; spacing_m: number; line_m: number; way_m: number; time_s: number; covered: [number, number]; room_m: number; rough: number; mission: Mission; done: Line[]; counts: string; known: Line[]; known_across: number; shares: (Share | null)[]; energy_wh: number | null }
  | ({ t: "picture" } & Shot)
  | ({ t: "live" } & Answer)
  | { t: "adoption"; boat: number | null; is_running: boolean; circle: (Place & { radius_m: number }) | null; steps: TrialStep[]; part: number; lines: string[]; question: string; end: string; file: string; is_written: boolean; report: boolean }
  | { t: "depths"; tile: [row: number, column: number]; extent: [number, number, number, number]; whole?: string; cells?: [cell: number, depth_cm: number][] }
  | { t: "aboard"; boat: number; of: "settings" | "checks" | "change"; rows: AboardRow[] }
  | { t: "no_depths" }
  | { t: "progress"; boat: number; what: string; part: number }
  | { t: "crossed"; boat: number; place: [number, number] | null } // where the chart forbids a plan first
  | { t: "dryrun"; boat: number; time_s: number; distance_m: number; track: [number, number][] };

export type MissionDeed = "put" | "upload" | "download" | "check" | "dryrun" | "save" | "load" | "list" | "compare";

/** The command of the boats changes hands. */
export interface Hand {
  t: "handover";
  do: "take" | "offer" | "accept" | "leave";
  page?: number;
}

export type Said =
  | Hand
  | { t: "command"; boat: number | "all"; command: string; [key: string]: Values[string] }
  | { t: "mission"; boat: number; do: MissionDeed; mission?: Mission; name?: string }
  | { t: "profile"; boat: number; profile: string }
  | { t: "survey"; boat: number; areas: Area[]; heading_deg: number | null; start: string; side: string; inside: boolean; fence: Ring; obstacles: Obstacle[]; closed: Ring[]; name: string; lines?: Line[]; across?: number; sailed?: boolean; at?: Ring[0] | null; others?: (Ring[0] | null)[]; [key: `${string}_m` | `${string}_mps` | `${string}_pct`]: number }
  | { t: "depths"; do: "forget" }
  | { t: "see"; boat: number; camera: string; live?: Offer & { shown: boolean } }
  | { t: "snapshot"; boat: number; jpeg?: string; taken_s?: number }
  | { t: "adopt"; boat: number; do: "begin" | "afresh" | "berth" | "yes" | "no" | "end" | "close"; radius_m?: number }
  | { t: "itself"; boat: number; do: "settings" | "checks" | "change"; key?: string; value?: AboardRow["value"] }
  | { t: "logs"; boat: number; do: "state" | "all" | "end" | "chart" | "unsent"; chart?: string }
  | { t: "forget"; boat: number }
  | { t: "home"; boat: number }
  | { t: "afford"; boat: number }
  | { t: "acknowledge" | "quiet"; ids: number[] }
  | { t: "note"; boat: number; text: string; at_s: number }
  | { t: "replay"; at_s?: number; rate?: number };

// Sent without a number: nobody waits for an answer.
export type Streamed =
  | { t: "here"; n: number; grant: number }
  | { t: "input"; boat: number; n: number; port_pct: number; starboard_pct: number }
  | { t: "release"; boat: number; why: string };
