// A narrow strip for each boat: mode, thrust, battery, trouble, port and starboard rpm, the age of the data, the link.
import type { Actions } from "./actions";
import { attribute, hide, make, text } from "./dom";
import type { Drive } from "./drive";
import { Figures } from "./figures";
import { bearing, metres } from "./geo";
import type { Screen } from "./keys";
import { bars, linkWords, linksWords, weakWords } from "./link";
import { measuredWords } from "./measured";
import { OrderRow } from "./orders";
import { over } from "./palette";
import { UNNAMED } from "./mission";
import { isSailing } from "./planning";
import { RpmGraph } from "./rpmgraph";
import type { State } from "./state";
import { age_s, ageWords, freshness, trouble } from "./state";
import { speedWords } from "./units";
import type { Boat } from "./wire";

const CONFIRM_LATE_MS = 3000;
const FULL_AT_MOST = 3; // boats; with more of them only the selected one is shown in full

const UNFOLDED = "delfim.unfolded";

const STILL_MPS = 0.2; // below this speed no time to go is shown

const MODE_WORDS: Record<string, string> = { goto: "go to", grex: "GREX", play: "mission" };
const GROUPS: readonly (keyof Boat["age_s"])[] = ["heard", "position", "attitude", "rpm", "battery"];

export class Strips {
  private readonly chips = new Map<number, Chip>();

  constructor(
    private readonly parent: HTMLElement,
    private readonly state: State,
    private readonly drive: Drive,
    private readonly actions: Actions,
    private readonly chosen: (boat: Boat, at: [number, number]) => void,
    private readonly screen: Pick<Screen, "enterMode">,
  ) {
    this.unfold(localStorage.getItem(UNFOLDED) === "on");
    state.on(["boats"], () => this.draw(true));
    state.on(["selection", "progress", "plan"], () => this.draw(false));
    state.on(["theme"], () => this.chips.forEach((chip) => chip.repaint()));
    state.on(["forgotten"], () => {
      for (const [id, chip] of this.chips) if (!state.byId(id) && this.chips.delete(id)) chip.root.remove();
    });
    setInterval(() => state.nothingArrives && this.draw(false), 250); // ages grow while nothing arrives
  }

  draw(fresh: boolean): void {
    this.parent.classList.toggle("many", this.state.boats.length > FULL_AT_MOST);
    for (const boat of this.state.boats) {
      let chip = this.chips.get(boat.id);
      if (!chip) {
        chip = new Chip(boat, this.actions, this.chosen, this.screen, () => this.unfold(!this.parent.classList.contains("unfolded")));
        this.chips.set(boat.id, chip);
        const next = this.state.boats.find((each) => each.id > boat.id && this.chips.has(each.id));
        this.parent.insertBefore(chip.root, next ? this.chips.get(next.id)!.root : null);
      }
      chip.draw(boat, this.state, this.drive, this.actions, fresh);
    }
  }

  /** The rest of what is known of the boats: graphs, ages, links. */
  private unfold(on: boolean): void {
    this.parent.classList.toggle("unfolded", on);
    localStorage.setItem(UNFOLDED, on ? "on" : "off");
  }
}

class Chip {
  readonly root = make("section.chip");
  private readonly name = make("b");
  private readonly dot = make("i.dot");
  private readonly age = make("span.age");
  private readonly mode = make("span.mode");
  private readonly speed = make("span.speed");
  private readonly battery = make("span.battery");
  private readonly heading = make("span.heading");
  private readonly left = make("span.left");
  private readonly trouble = make("p.trouble");
  private readonly weak = make("p.trouble.weak");
  private readonly bars = make("span.bars", make("i"), make("i"), make("i"), make("i"));
  private readonly measured = make("p.measured");
  private readonly link = make("span.link");
  private readonly links = make("span.links");
  private readonly missionName = make("span");
  private readonly missionAt = make("span");
  private readonly mission = make("span.mission", this.missionName, this.missionAt);
  private readonly badge = make("span.badge");
  private readonly changes = make("button.changes", "Send changes");
  private readonly groups = GROUPS.map((name) => make("i", make("span", name)));
  private readonly graphs: [RpmGraph, RpmGraph] = [new RpmGraph("port"), new RpmGraph("starboard")];
  private readonly figures = new Figures();
  private readonly orders: OrderRow;
  private readonly fold = make("button.fold", "");
  private readonly revolutions = make("div.row.graphs", this.graphs[0].root, this.graphs[1].root);
  private boat: Boat;
  private askedAt = 0;
  private asked: string | null = null;

  constructor(boat: Boat, actions: Actions, chosen: (boat: Boat, at: [number, number]) => void, screen: Pick<Screen, "enterMode">, unfold: () => void) {
    this.boat = boat;
    this.orders = new OrderRow(boat, actions, screen);
    this.root.append(
      make("div.row.head", this.dot, this.name, this.battery, this.bars, this.age),
      make("div.row.state", this.mode, this.speed, this.fold),
      this.figures.root,
      make("div.row.going", this.heading, this.left),
      this.trouble,
      this.weak,
      this.orders.root,
      make("div.row.small", this.mission, this.badge),
      make("div.row.small", this.changes),
      this.measured,
      this.revolutions,
      make("div.row.ages", ...this.groups),
      make("div.row.small.last", this.link),
      make("div.row.small.last", this.links),
    );
    this.fold.tabIndex = -1;
    this.fold.addEventListener("click", (event) => {
      event.stopPropagation();
      unfold();
    });
    this.changes.tabIndex = -1;
    this.changes.addEventListener("click", (event) => {
      event.stopPropagation();
      void actions.mission(this.boat.id, "upload");
    });
    this.root.addEventListener("click", (event) => chosen(this.boat, [event.clientX, event.clientY]));
    this.root.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  draw(boat: Boat, state: State, drive: Drive, actions: Actions, fresh: boolean): void {
    this.boat = boat;
    const age = age_s(state, boat);
    attribute(this.root, "data-boat", String(boat.id));
    attribute(this.root, "data-age", freshness(age));
    attribute(this.root, "data-mode", boat.mode ?? "");
    this.root.classList.toggle("selected", boat.id === state.selected);
    this.dot.style.background = boat.colour;
    this.dot.style.color = over(boat.colour);
    text(this.dot, String(boat.id));
    text(this.name, boat.name);
    text(this.age, ageWords(age));
    this.drawMode(boat, actions);
    this.drawSpeed(boat, drive, actions);
    if (boat.id === state.selected) this.figures.draw(boat, drive.hand(boat.id));
    this.orders.draw(boat);
    const unfolded = this.root.parentElement?.classList.contains("unfolded") ?? false;
    attribute(this.fold, "aria-expanded", String(unfolded));
    text(this.fold, unfolded ? "Less" : "More");
    text(this.heading, boat.heading_deg === null ? "" : `hdg ${bearing(boat.heading_deg)}`);
    text(this.left, leftWords(boat));
    text(this.battery, batteryWords(boat));
    this.battery.classList.toggle("bad", boat.battery_pct !== null && boat.battery_pct < 20);
    this.drawTrouble(boat, state);
    const values = measuredWords(boat, Math.max(0, state.frameAge_s - 0.2));
    text(this.measured, values);
    hide(this.measured, !values);
    GROUPS.forEach((group, i) => {
      const its = age_s(state, boat, group);
      attribute(this.groups[i]!, "data-age", boat.age_s[group] === null ? "none" : freshness(its, group));
      attribute(this.groups[i]!, "title", `${group}: ${ageWords(its)}${group === "position" && boat.fix ? ` · ${boat.fix}, ${boat.satellites ?? "?"} satellites` : ""}`);
    });
    hide(this.revolutions, boat.age_s.rpm === null); // motors on pulses tell none
    this.drawMission(boat, state);
    this.drawLink(boat, age);
    if (fresh) {
      const live = freshness(age_s(state, boat, "rpm")) !== "lost";
      this.graphs.forEach((graph, i) => graph.push(state.at_s, live ? boat.rpm[i as 0 | 1] : null));
      const most = 1.45 * Math.max(boat.size?.rpm_max || 345, ...this.graphs.map((graph) => graph.highest));
      const least = Math.min(-0.15 * most, ...this.graphs.map((graph) => 1.1 * graph.lowest));
      this.graphs.forEach((graph) => graph.draw(state.at_s, least, most)); // one scale: their zeros are on one line
    }
  }

  repaint(): void {
    this.graphs.forEach((graph) => graph.repaint());
  }

  private drawMode(boat: Boat, actions: Actions): void {
    const waits = actions.asked(boat);
    if (waits !== this.asked) [this.asked, this.askedAt] = [waits, performance.now()];
    const late = waits !== null && performance.now() - this.askedAt > CONFIRM_LATE_MS;
    const shown = waits ?? boat.mode ?? "unknown";
    text(this.mode, MODE_WORDS[shown] ?? shown);
    attribute(this.mode, "data-state", late ? "late" : waits ? "asked" : boat.mode === "idle" ? "idle" : "on");
  }

  private drawSpeed(boat: Boat, drive: Drive, actions: Actions): void {
    const hand = drive.hand(boat.id);
    const speed = boat.speed_mps === null ? "" : speedWords(boat.speed_mps);
    const [port, starboard] = boat.thrust_pct.map((each) => (each === null ? "–" : Math.round(each)));
    if (hand) text(this.speed, hand.silent ? "thrust 0" : `P ${asked(port!, hand.port_pct)} · S ${asked(starboard!, hand.starboard_pct)} %`);
    else if (boat.mode === "manual") text(this.speed, `P ${port} · S ${starboard} %`);
    else if (boat.mode === "idle" || boat.mode === null) text(this.speed, speed);
    else text(this.speed, boat.link.kind === "log" ? speed : `${actions.speed_pct(boat)} % · ${speed}`);
    this.speed.classList.toggle("bad", hand?.silent ?? false);
  }

  private drawTrouble(boat: Boat, state: State): void {
    const elsewhere = state.drivenElsewhere(boat) ? { words: "driven from another page: M here takes over", grave: false } : null;
    const found = trouble(boat) ?? elsewhere;
    text(this.trouble, found?.words ?? "");
    hide(this.trouble, !found);
    this.trouble.classList.toggle("bad", found?.grave ?? false);
  }

  private drawLink(boat: Boat, age: number): void {
    const [count, weak] = [bars(boat, freshness(age)), weakWords(boat)];
    text(this.link, linkWords(boat));
    text(this.links, linksWords(boat));
    text(this.weak, weak);
    hide(this.weak, !weak || count === 0);
    hide(this.bars, count === null);
    attribute(this.bars, "data-bars", String(count));
    attribute(this.bars, "aria-label", `link: ${count} of 4 bars`);
    attribute(this.bars, "role", "img");
  }

  private drawMission(boat: Boat, state: State): void {
    const progress = state.progress.get(boat.id);
    const compared = state.compared(boat);
    const [name, at] = progress ? ["", `${progress.what} ${Math.round(progress.part * 100)} %`] : missionWords(boat);
    text(this.missionName, name);
    text(this.missionAt, at);
    const { count } = boat.mission;
    const planned = state.plans.get(boat.id)?.mission.waypoints.length ?? 0;
    const words = boat.link.kind === "log" ? "" : !count ? (planned ? "not sent" : "") : compared === "unknown" ? "unread" : compared;
    text(this.badge, words);
    attribute(this.badge, "data-state", words.replace(" ", "-"));
    hide(this.badge, !words);
    hide(this.changes, !(planned && compared === "differs" && isSailing(boat) && !progress && !state.replaying));
  }
}

/** Its name, which may be cut off, and the rest. */
function missionWords({ mode, link, mission: { name, count, current, state } }: Boat): [string, string] {
  if (link.kind === "log" && !count) return ["", ""];
  if (!count) return ["", state === "unknown" ? "mission not read" : "no mission aboard"];
  const waypoints = count === 1 ? "1 waypoint" : `${count} waypoints`;
  return [`${name === UNNAMED ? "mission" : name}: `, mode === "play" && current !== null ? `waypoint ${current + 1} of ${count}` : waypoints];
}

/** The distance to the place that it steers for, and the time to get there at the present speed. */
function leftWords({ mode, reference, speed_mps }: Boat): string {
  const left_m = reference?.distance_m;
  if (left_m == null || mode === "idle" || mode === "manual") return "";
  const [far, left_s] = [left_m < 1000 ? `${left_m.toFixed(0)} m` : metres(left_m), left_m / Math.max(speed_mps ?? 0, STILL_MPS)];
  const long = left_s < 6000 ? `${(left_s / 60).toFixed(0)} min` : `${(left_s / 3600).toFixed(left_s < 36_000 ? 1 : 0)} h`;
  const time = (speed_mps ?? 0) < STILL_MPS ? "" : left_s < 100 ? ` · ${left_s.toFixed(0)} s` : ` · ${long}`;
  return `${far}${time} to go`;
}

/** What is in force, and what was asked for where that is something else. */
const asked = (now: number | string, wanted: number): string => (now === wanted ? `${wanted}` : `${now}→${wanted}`);

function batteryWords({ battery_pct, battery_v }: Boat): string {
  if (battery_pct !== null) return `${Math.round(battery_pct)} %`;
  return battery_v === null ? "" : `${battery_v.toFixed(1)} V`;
}
